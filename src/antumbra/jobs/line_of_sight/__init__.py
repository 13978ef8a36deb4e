"""Lines of sight: which points see each other, what stands between them, and what observers see of a scene.

- `sightlines`: `line_of_sight`, for pairs of points
- `visibility_matrix`: `visibility_matrix`, for all points and all points
- `viewshed`: `viewshed`, for observers and sensors
"""
