"""CHC+RT [Mattausch et al. 2015].

- `chcrt_published`: names of the tables, and the published results
- `walkthroughs`: the walkthroughs, their rays, and the methods that trace them
- `walkthrough_timing`: times walkthroughs, in memory and out of core
- `chcrt_tables`: measures and prints the tables
- `chcrt_figures`: draws the figures
"""
