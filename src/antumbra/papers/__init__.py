"""What exists to reproduce the papers, or to be compared with them; nothing in the rest of the package imports it.

Each folder is a paper: `multi_frusta`, `pre_bvh_culling`, `srdh`, `ray_hierarchy`, `chc_rt`. It holds the variants as
published (`methods` registers them), `measure`, what the paper published (`published`), `plot`, and `command`, which is
``antumbra bench <paper>``. Its README says which line of code does which section, table and figure.
"""
