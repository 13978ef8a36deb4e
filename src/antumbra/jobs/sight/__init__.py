"""Lines of sight: which points see each other, what stands between them, and what observers see of a scene.

- ends: points as ends of sightlines
- pairs: `line_of_sight`, for pairs of points; readpairs reads them from files, lines makes tables and models of them
- matrix: `visibility_matrix`, all points to all points; tiles traces it, bitrows packs it, sparse writes it as CSR
- viewshed: `viewshed`, counts of observers; limits: how far and where they look; earth: a curved earth
"""
