"""Jobs on scenes: sun hours, skylines, shadows, bakes, lines of sight, view factors, data sets, and what they share.

- `sun/`: sun hours and sky view
- `skyline/`: the elevation of the horizon by azimuth
- `shadow/`: shadows on the ground as polygons
- `bake/`: visibility and light baked into glTF files
- `line_of_sight/`: sightlines, visibility matrices and viewsheds
- `view_factors/`: view factors between surfaces
- `dataset/`: rendered data sets
- `sensors`: sample points with normals and areas
- `sensor_files`: sensors from text and point files
- `raster_grid`: horizontal rasters of square cells
- `ground_areas`: sensors in polygons on the ground, outside buildings
- `surface_groups`: faces grouped in surfaces, objects or buildings; azimuth and tilt
- `surface_columns`: surfaces in tables, and tables with a row per surface or building
- `result_table`: results with units, and their writers
- `false_colours`: false-colour pictures and models
- `map_page`: pages for reports; `map_sheet`: those of tables; `map_scale`: their colours and legends
- `qgis_style`: styles of QGIS beside rasters and layers
- `bit_matrices`: packed bit matrices, in memory and in files
- `executors`: local, sharded and dry runs of a job's units
- `work_parts`: resumable parts, merged shards, and pictures rendered in bands
- `scene_records`: JSON records and digests
- `job_kernels`: all example calls whose kernels are recorded
"""
