"""Embree beside the default plan: soft shadows on the same rays (``antumbra bench peers``).

- contest: times contenders in turns, and compares their answers; contenders: ours, and the modes of Embree
- measure, command: the measurements, and ``antumbra bench peers``
- embree, embree_rays, denormals: the library inside the wheel embreex, through its C interface
- ray_sets, queries: the same rays for all contenders

The scripts in `benchmarks/` measure more peers and more queries with these modules.
"""
