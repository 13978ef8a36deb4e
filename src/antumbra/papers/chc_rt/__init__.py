"""CHC+RT [Mattausch et al. 2015].

- `chcrt_published`: names of its tables, and the published figures
- `walkthroughs`: the walkthroughs that are measured, their rays, and the methods that trace them
- `walkthrough_timing`: times of walkthroughs, in memory and out of core
- `chcrt_tables`: measures and prints the tables
- `chcrt_figures`: draws the figures
"""
