"""Scene data: triangles over time, with cameras, lights and materials. Nothing here reads scene files or traces rays.

- `scene_data`: `MemoryData`, `SceneData`, and the city objects of a scene
- `mesh`: indexed triangles, and the interface of a scene to its geometry
- `triangles`: the triangles at one moment, and hits on them
- `triangle_setup`: from the pieces of a scene to float32 triangles
- `scene_bounds`: bounds, the recentred frame, and the extent of the detail
- `camera`: cameras, their rays, and the default camera
- `lights`: point, area and distant lights, and ambient occlusion
- `light_lists`: many lights sampled as one
- `sky`: skies and environment maps
- `default_picture`: what the default picture of a scene shows, and its lights
- `materials`: materials, textures and colours
- `appearance`: textures, vertex colours and shading normals per face corner
- `alpha_masks`: cut-out faces
- `crs`: coordinate reference systems
"""
