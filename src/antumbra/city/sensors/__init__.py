"""Sensors: the sample points of studies, where they come from, and checks of them.

- `sensors`: sample points with normals and areas
- `sensor_files`: sensors from text and point files
- `vector_points`: points of vector files, moved to the CRS of a scene
- `curved_earth`: scenes and sensors on a curved earth; `curvature_options`: its options
- `raster_grid`: horizontal rasters of square cells
- `surface_grid`: points in square cells on faces
- `ground_areas`: sensors in polygons on the ground, outside buildings
- `surface_groups`: faces grouped in surfaces, facades, objects or buildings; types, azimuth and tilt
- `planar_parts`: coplanar faces joined along their edges
- `point_attributes`: columns of the users' own points
- `point_checks`: notes on points beside the scene, below the ground or behind a surface
"""
