"""CityJSON 1.0 to 2.0, and CityJSONSeq.

- `cityjson_source`: `read_cityjson`, from a file to triangles
- `cityjson_file`: JSON, versions, vertices, templates, and the choice of levels of detail
- `city_polygons`: boundaries with their semantic surfaces, and their triangulation
- `attribute_writer`: `write_attributes`, a copy of a file with added attributes
"""
