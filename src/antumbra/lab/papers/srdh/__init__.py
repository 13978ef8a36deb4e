"""SRDH as published [Feltman et al. 2012]. Its builders and traversal orders are in `papers.published_methods`.

- `srdh_workloads`: scenes under several lightings
- `srdh_measurements`: measures box tests, RTSAH, build times and trace times
- `srdh_trees`: depths of frequent occluders, memory, and the drawings of trees (Figure 3, Section 5)
- `srdh_published`: the published results
- `srdh_tables`: prints the tables with the published results, compares the two, and draws Figures 2 and 4
"""
