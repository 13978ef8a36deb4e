"""SRDH as published [Feltman et al. 2012]. Its builders and traversal orders are in `papers.published_methods`.

- `srdh_measurements`: box tests, RTSAH, build times and trace times
- `srdh_tables`: prints the tables and draws Figures 2 and 4, beside the published figures
"""
