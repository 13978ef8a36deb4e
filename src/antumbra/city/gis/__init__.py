"""Geographic data: rasters of heights, building footprints, and maps.

- `raster_files`, `vrt_files`: checked access to GDAL's rasters, and virtual rasters
- `vector_files`: checked access to vector files and tables
- `height_files`: rasters of heights in files
- `height_arrays`: heights from arrays and from the DataArrays of xarray
- `height_tiles`: tiles of one grid as a single surface
- `footprint_table`: footprints with heights, from files that geopandas reads
- `footprint_bases`: the lowest terrain under footprints
- `footprint_solids`: footprints as closed solids, with roofs, walls and floors
- `vegetation_table`: plants with heights and radii, from point and polygon layers and CSV files
- `vector_table`: what footprints and vegetation share: layers of files, and columns of numbers and ids
- `gis_scenes`: `from_raster`, `from_footprints`
- `gis_data`: scene data of rasters and footprints
"""
