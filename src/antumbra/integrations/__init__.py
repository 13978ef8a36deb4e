"""Drop-in faces for other libraries: their calls and conventions, answered exactly. None of them is required.

- `trimesh`: `trimesh_ray`, an intersector for ``mesh.ray``, and `trimesh_nearest`, distances for ``mesh.nearest``
- `open3d`: `RaycastingScene`, with the calls and results of Open3D's
- `pvlib`: `pvlib_shading`, the shading of modules as a pandas table
- `pyvista`: ``mesh.antumbra``, an accessor whose results become arrays of cells or points
- `ladybug`: `intersection_matrix` of ladybug_radiance, without Radiance

Each module serves one library, and only `pyvista` imports the library that it serves.
"""
