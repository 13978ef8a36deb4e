"""SRDH as published [Feltman et al. 2012]. Its builders and traversal orders are in `papers.published_methods`.

- `srdh_measurements`: measures box tests, RTSAH, build times and trace times
- `srdh_tables`: prints the tables with the published results, and draws Figures 2 and 4
"""
