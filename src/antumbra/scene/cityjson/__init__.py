"""CityJSON 1.0 to 2.0, and CityJSONSeq.

- read: `read_cityjson`, from a file to triangles; write: a copy of a file with attributes
- document: JSON, versions, vertices and templates
- lods: the choice of geometries; semantics: boundaries to polygons and their surfaces
- geometry: polygons to triangles
- colours: colours of surfaces and objects
- model: `CityModel`, which object and surface each face belongs to
"""
