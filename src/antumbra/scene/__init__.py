"""Scene data: triangles over time, with cameras, lights and materials. Nothing here reads scene files or traces rays.

- `scene_data`: `SceneData` and `MemoryData`, city objects, and grouped loader notes
- `mesh`: indexed triangles, and `Source`, the geometry interface of a scene
- `instances`: copies of meshes, and a scene of them
- `instance_bounds`: the exact bounds of copies
- `instance_data`: `InstanceData`, and when copies stay instances
- `palette_scene`: a scene with palette colours, as generators return and format writers take it
- `triangles`: the triangles at one moment, and `Hit`
- `triangle_setup`: interpolation, recentring and rounding to float32 triangles
- `moved_geometry`: new vertices and transforms of objects between queries
- `scene_bounds`: bounds, the recentred frame, the detail box, and the up axis
- `camera`: cameras, their rays, and automatic framing
- `lights`: point, area and distant lights, and ambient occlusion
- `light_lists`: many lights sampled as one
- `sky`: skies and environment maps
- `default_picture`: the framed geometry and the lights of a scene's default picture
- `materials`: materials, textures and colours
- `appearance`: textures, vertex colours and shading normals per face corner
- `alpha_masks`: cut-out faces
- `raster`: the cells of a horizontal raster
- `terrain`: the triangulated surface of a raster of heights
- `crowns`: trees as closed crowns that let light pass
- `units`: the length unit of a scene
- `crs`: coordinate reference systems, their units, and reprojection
- `map_point`: the scale, convergence and curvature of a map at a point
"""
