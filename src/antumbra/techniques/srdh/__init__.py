"""Shadow ray distribution heuristic [Feltman et al. 2012]: the rays that its builder samples.

- `representative_rays`: selection of the rays, and their intersections

The builder is `bvh.srdh`.
"""
