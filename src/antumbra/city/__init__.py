"""Studies of cities and landscapes. The core, which is everything outside `city` and `lab`, imports nothing from here.

- `sun/`: sun hours and sky view
- `pv/`: shading of photovoltaic modules
- `skyline/`: the elevation of the horizon by azimuth
- `shadow/`: shadows on the ground as polygons
- `sight/`: sightlines, visibility matrices and viewsheds
- `view_factors/`: view factors between surfaces
- `changes/`: scenes with objects added and removed, and studies before and after
- `vegetation/`: plants as closed crowns that let a share of the light pass
- `sensors/`: sample points with normals and areas
- `sheets/`: pages for reports: maps, tables, method and sources
- `tables/`: results with units, their files, maps and pictures
- `gis/`: rasters of heights, footprints and maps
- `cityjson/`: CityJSON and CityJSONSeq
- `sensor_study`: the base of commands of studies with a row for each sensor

The command of a study stands beside it.
"""
