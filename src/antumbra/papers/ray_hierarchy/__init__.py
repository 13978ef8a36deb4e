"""Ray hierarchies as published [Olsson and Assarsson 2011].

- cones, cone_triangle: nodes of the hierarchy, and their tests against triangles
- variants: the tracers ``cones:...``
- measure, views, published, plot, command: ``antumbra bench ray-hierarchy``
"""
