"""Results of studies, and their files, maps and pictures.

- `result_table`: results with units, and their writers
- `surface_columns`: surfaces in tables, and tables with a row per surface or building
- `polygon_files`: outlines of cells, and files of polygons
- `bit_matrices`: packed bit matrices, in memory and in files
- `false_colours`: false-colour pictures and models; `interpolated_values`: values between sensors
- `map_sheet`: map sheets of tables; `table_pages`: their tables; `map_scale`: their colours and legends
- `qgis_style`: styles of QGIS beside rasters and layers
"""
