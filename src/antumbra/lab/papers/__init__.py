"""Code that reproduces the papers and compares methods with them. The rest of the package does not import it.

- `published_methods`: registers the methods as published
- `benchmark_views`: scenes with a camera and lights, and digests of answers
- `bench_commands`: the commands of ``antumbra bench``
- `bench_runner`: alternating runs, tables beside published figures, plots
- `multi_frusta`, `pre_bvh_culling`, `srdh`, `ray_hierarchy`, `chc_rt`: one paper each
- `scenes`: procedural scenes for these benchmarks

The README of each paper maps its sections, tables and figures to code.
"""
