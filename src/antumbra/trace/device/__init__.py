"""Tracing on devices: the kernels, which run on every card, and the stages that make their answers exact.

- `device_rays`: rays and shadow segments as kernels read them, one by index
- `device_tree`: the tree on a device, and its refit
- `tree_build`, `ploc_build`: trees that a device builds, and `build_kernels`, `ploc_kernels`
- `device_launches`: launches, and memory that is kept for the next ones
- `device_receivers`: receivers that are uploaded once
- `device_traversal`: the walk of one ray, which decides in float32 and lists what it cannot decide
- `shaft_parts`, `device_shafts`, `shaft_traversal`: multi-frusta tracing, by warps of shafts
- `part_trees`, `tree_list_kernels`, `tree_list_tracer`: screen tiles, through the trees that each tile lists
- `nearest_list_kernels`, `nearest_list_tracer`: the nearest hits of rays of such tiles
- `device_kernels`: the kernels, and the list of them that tests and builds read
- `pixel_kernels`, `device_surfaces`: the surfaces that a camera sees, and receivers on them, which stay there
- `raster_kernels`, `device_rasteriser`: the same surfaces of new triangles, without a tree
- `settling`: the exact decisions on the CPU
- `device_stages`: the stages of tracing a chunk of rays, and their order
- `device_tracer`: trees, ray lists and shadow queries, by these stages
"""
