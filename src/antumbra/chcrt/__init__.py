"""CHC+RT: hierarchical occlusion culling for rays of any kind [Mattausch et al. 2015], in core and out of core."""
