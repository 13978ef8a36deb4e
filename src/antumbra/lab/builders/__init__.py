"""Builders that `auto` never chooses: references for quality, and for the papers.

- `sweep_sah`: the builder `sweep-sah`
- `tl_lbvh`: the builder `tl-lbvh`, by treelet restructuring
"""
