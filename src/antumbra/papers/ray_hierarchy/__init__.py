"""Ray hierarchies as published [Olsson and Assarsson 2011].

- `cone_hierarchy`: nodes as cones with a common apex, tests of triangles against them, and the tracers ``cones:...``
- `ray_hierarchy_measurements`: views, published results and measurements
- `ray_hierarchy_tables`: prints the tables, and draws Figures 6 and 7
"""
