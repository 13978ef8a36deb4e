"""CityJSON 1.0 to 2.0, and CityJSONSeq.

- `cityjson_source`: `read_cityjson`, from a file to triangles
- `cityjson_file`: JSON, versions, vertices and templates
- `city_geometries`: the choice of levels of detail, and of one geometry among repeated ones
- `city_polygons`: boundaries with their semantic surfaces, and their triangulation
- `surface_types`: types of surfaces without semantics
- `attribute_writer`: `write_attributes`, a copy of a file with added attributes
"""
