"""Small scenes and a view for example calls, whose kernels are recorded (`engine.precompilation`)."""

import numpy as np

from ..formats.library_meshes import data_of_arrays
from ..scene.camera import Camera
from ..scene.instance_data import InstanceData
from ..scene.instances import InstancedMeshes
from ..scene.light_lists import PointLights
from ..scene.lights import AmbientOcclusion, Light, PointLight, SphereLight
from ..scene.materials import MASK, Material, PbrParameters, Texture, TextureMap
from ..scene.mesh import StaticMeshes, VertexAttributes, make_mesh, textured_mesh
from ..scene.scene_data import MemoryData
from ..scene.terrain import GridPoints, HeightGrid, TerrainSurfaces

UP = np.array([[0.0, 1.0, 0.0]])
"""(1, 3): a point above the small scene, and a normal there."""


def small_scene(dressed: bool = False) -> MemoryData:
    """Hills of about 10,000 triangles, enough for builders to take every code path of large scenes.

    dressed : whether they have a texture, vertex colours and normals
    """
    x, z = np.meshgrid(np.linspace(-1, 1, 73), np.linspace(-1, 1, 73))
    a = (np.arange(72)[:, None] * 73 + np.arange(72)).ravel()
    faces = np.concatenate([np.stack([a, a + 73, a + 1], 1), np.stack([a + 1, a + 73, a + 74], 1)])
    vertices = np.stack([x, np.sin(5 * x) * np.cos(4 * z) / 4, z], -1).reshape(-1, 3)
    if not dressed:
        return data_of_arrays(vertices, faces)
    white, up = np.full((2, 2, 3), 255, np.uint8), np.broadcast_to(UP[0], vertices.shape)
    return data_of_arrays(
        vertices, faces, vertex_colours=np.ones(vertices.shape), uv=vertices[:, ::2], texture=white, normals=up
    )


def small_scene_of_metal() -> MemoryData:
    """The small scene of rough metal with a normal map."""
    hills = small_scene().triangles().vertices.reshape(-1, 3)
    bump = TextureMap(Texture("metal", np.full((2, 2, 4), 100, np.uint8), holds_data=True))
    material = Material(pbr=PbrParameters(metallic=1.0, roughness=0.5, normal_map=bump))
    mesh = make_mesh("metal", hills, None, None, "metal")
    look = VertexAttributes(uv=hills[:, ::2])
    return MemoryData(StaticMeshes([textured_mesh(mesh, None, len(hills), material, "metal", look)], "small"))


def small_scene_with_cutouts() -> MemoryData:
    """The small scene below a perforated sheet of paper."""
    corners = np.array([[[-1, 1, -1], [1, 1, -1], [1, 1, 1]], [[-1, 1, -1], [1, 1, 1], [-1, 1, 1]]], np.float32)
    pixels = np.full((8, 8, 4), 255, np.uint8)
    pixels[..., 3] = 255 * np.eye(8)
    material = Material(texture=Texture("paper", pixels, has_alpha=True), alpha_mode=MASK)
    sheet = make_mesh("paper", corners.reshape(-1, 3), None, None, "paper")
    paper = textured_mesh(sheet, None, 6, material, "paper", VertexAttributes(corners[..., ::2].reshape(-1, 2)))
    hills = make_mesh("hills", small_scene().triangles().vertices.reshape(-1, 3), None, None, "hills")
    return MemoryData(StaticMeshes([hills, paper], "small"))


def small_instances() -> InstanceData:
    """Two copies of the small scene."""
    hills = make_mesh("hills", small_scene().triangles(0.0, 2).vertices.reshape(-1, 3), None, None, "hills")
    matrices = np.eye(4)[None, :3].repeat(2, 0)
    matrices[1, 0, 3] = 2.0
    return InstanceData(InstancedMeshes([hills], [matrices], "small"), threads=2)


def small_terrain() -> MemoryData:
    """A raster of 3 x 3 heights."""
    grid = GridPoints(0.5, -0.5, 1.0, 1.0, 3, 3)
    return MemoryData(
        TerrainSurfaces([HeightGrid("small", grid, None, np.zeros((3, 3)))], "small"), name="small", up="z"
    )


def small_view(quality: bool = False, sky: bool = True) -> tuple[Camera, list[Light]]:
    """(camera, lights) for the small scene; `quality`: lights with penumbrae, `sky`: add ambient occlusion."""
    above = np.array([0, 2, 0])
    light = SphereLight(above, 0.1) if quality else PointLight(above)
    lights: list[Light] = [light, PointLights(above[None], interleave=quality)]
    if sky:
        lights.append(AmbientOcclusion(1.0))
    return Camera((0, 2, 3), (0, 0, 0), width=8, height=8), lights
