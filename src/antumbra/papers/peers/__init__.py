"""Embree beside the default plan: soft shadows on the same rays (``antumbra bench peers``).

- `ray_contest`: the same rays for all contenders; times them in turns, and compares their answers
- `embree`: the library inside the wheel embreex, through its C interface
- `peer_measurements`: our plans and the modes of Embree as contenders; measures and plots them

The scripts in `benchmarks/` measure more peers and more queries with these modules.
"""
