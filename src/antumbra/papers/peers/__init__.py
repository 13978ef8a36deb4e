"""Compares the default plan with Embree: soft shadows on the same rays (``antumbra bench peers``).

- `ray_contest`: shares rays among contenders, times them alternately, and compares their answers
- `embree`: Embree from the embreex wheel, through its C interface
- `peer_measurements`: measures and plots our plans and the modes of Embree

The scripts in `benchmarks/` use these modules for more peers and queries.
"""
