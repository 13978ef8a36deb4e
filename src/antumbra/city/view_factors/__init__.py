"""View factors: the share of the diffuse radiation of one surface that reaches another.

- `hemisphere_rays`: rays from points on surfaces in cosine-weighted directions
- `view_factor_matrix`: `ViewFactors`, a sparse matrix with errors, reciprocity and files
- `view_factors`: `view_factors`, which traces the rays and counts where they arrive
"""
