"""Code that reproduces the papers and compares methods with them. The rest of the package does not import it.

The folders `multi_frusta`, `pre_bvh_culling`, `srdh`, `ray_hierarchy` and `chc_rt` are one paper each. A README maps
the paper's sections, tables and figures to code. A folder has most of these modules:

- the methods as published, which `methods` registers
- measure: the measurements
- published: figures from the paper
- plot: diagrams
- command: ``antumbra bench <paper>``

`scenes` has procedural scenes for these benchmarks. `peers` compares the default plan with Embree.
"""
