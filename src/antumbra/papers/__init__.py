"""Code that reproduces the papers and compares methods with them. The rest of the package does not import it.

- `published_methods`: registers the methods as published
- `benchmark_views`: scenes with a camera and lights, and digests of answers
- `bench_options`: options that commands of ``antumbra bench`` share
- `structure_benches`: ``antumbra bench srdh``, ``pre-bvh-culling`` and ``chc-rt``
- `tracer_benches`: ``antumbra bench multi-frusta`` and ``ray-hierarchy``
- `multi_frusta`, `pre_bvh_culling`, `srdh`, `ray_hierarchy`, `chc_rt`: one paper each
- `scenes`: procedural scenes for these benchmarks

The README of each paper maps its sections, tables and figures to code.
"""
