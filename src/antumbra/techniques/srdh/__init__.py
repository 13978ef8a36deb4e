"""SRDH: the BVH and the orders of children, built for a sample of shadow rays [Feltman et al. 2012].

- `srdh_builder`: the builder `srdh`, and `order_by_rays`, the order of children of a finished tree
- `ray_split`: ray sets with their hits, and the split of least cost for them
- `representative_rays`: `SrdhRays`, and the sample of a frame's rays
"""
