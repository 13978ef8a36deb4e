"""Ray hierarchies as published [Olsson and Assarsson 2011].

- `cone_hierarchy`: nodes as cones with a common apex, tests of triangles against them, and the tracers ``cones:...``
- `ray_hierarchy_published`: what the report published
- `ray_hierarchy_views`: the pictures, seen by BART's cameras
- `ray_hierarchy_measurements`: measurements, and comparisons with the report
- `ray_hierarchy_tables`: prints the tables
- `ray_hierarchy_plot`: draws the comparison with the report, and Figures 6 and 7
"""
