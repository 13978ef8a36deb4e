"""Lines of sight: which points see each other, what stands between them, and what observers see of a scene.

- ends: points as ends of sightlines; readends reads them from files
- pairs: `line_of_sight`, for pairs of points; lines draws them as models
- matrix: `visibility_matrix`, all points to all points; tiles traces it, bitrows packs it, sparse writes it as CSR
- viewshed: `viewshed`, counts of observers; limits: how far and where they look; earth: a curved earth
"""
