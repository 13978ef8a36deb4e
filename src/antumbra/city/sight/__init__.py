"""Lines of sight: which points see each other, what blocks the view, and what observers see of a scene.

- `sightlines`: `line_of_sight`, for pairs of points
- `visibility_matrix`: `visibility_matrix`, for all pairs of two sets of points
- `mutual_horizons`: pairs of points that are hidden by a horizon
- `viewshed_options`: options of a viewshed, with limits of distance and direction
- `viewshed`: `viewshed`, for observers and sensors
- `observers`: the eyes, names and limits of observers
- `least_heights`: the least visible height of each cell of a raster of heights
- `line_points`: `points_along`, observers along lines
- `targets`: `visible_share` of a facade, a polygon, points or turbines
- `turbines`: `Turbine`, and how much of rotors is seen
"""
