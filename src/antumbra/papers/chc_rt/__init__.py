"""CHC+RT [Mattausch et al. 2015].

- variants: the tracers of its aggressive mode
- rays, views: the rays and the walkthroughs that are measured
- measure, stores, sizes, ablation: the measurements, in memory and out of core
- culled, coverage, pictures: the pictures of its figures
- kinds, session, tables, plot, published, command: ``antumbra bench chc-rt``
"""
