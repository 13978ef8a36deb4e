"""The jobs that people come for: sun hours, baked light, lines of sight, data sets; and what these jobs share.

- sensors: points with normals and areas, at which a job asks; readsensors reads them; raster: cells of rasters
- areas: sensors on the ground of gardens and other polygons; inside: which points lie inside buildings
- table: the results, with units; formats, picture and model write them; view: the camera of pictures
- rowfile: matrices of bits in files
- engines: who does the units of a job; merging: units that others did; parts: units that are kept until the end;
  bands: a picture as such parts; scenedigest: the scene that they belong to
- sun, bake, sight, dataset: one folder a job
"""
