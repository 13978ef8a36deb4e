"""Export procedural scenes as GLB, OBJ and PLY with base colours.

The GLB files have lights (KHR_lights_punctual) and linear float colours. Those of `trimesh` have no lights and 8-bit
colours, so it is not used here.
"""

import math
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..files import atomic_output, checked_output
from ..formats.gltf.gltf_writer import GltfWriter
from ..picture.image_files import linear_to_srgb

if TYPE_CHECKING:
    from ..generate.procedural_scenes import ProceduralScene

SUFFIXES = (".glb", ".obj", ".ply")

_LIGHTS = "KHR_lights_punctual"


def check_output(path: str | PathLike[str]) -> Path:
    """`path` if a scene can be written there; otherwise an InputError that says what to do."""
    output: Path = checked_output(path, SUFFIXES)
    if output.suffix.lower() == ".obj":
        checked_output(_library(output), (".mtl",))
    return output


def _library(path: Path) -> Path:
    """The material file of an OBJ file."""
    return path.with_suffix(".mtl")


def write_scene(scene: "ProceduralScene", name: str, path: str | PathLike[str]) -> list[Path]:
    """Write a generated scene to a .glb, .obj (and .mtl) or .ply file; return the files written.

    Parameters
    ----------
    scene : from `antumbra.generate.procedural_scenes.generate`
    name : str
        Name of the mesh.
    path : str or path-like

    Notes
    -----
    GLB holds exact linear colours, the camera, and a point light at the centre of the scene's quad light (glTF has no
    area lights). OBJ and PLY hold triangles and colours, with 8 bits in PLY. Coordinates are float32 in GLB and PLY.
    """
    path = check_output(path)
    if path.suffix.lower() == ".obj":
        return _write_obj(scene, name, path)
    data = _glb(scene, name) if path.suffix.lower() == ".glb" else _ply(scene)
    with atomic_output(path) as temporary:
        temporary.write_bytes(data)
    return [path]


def _glb(scene: "ProceduralScene", name: str) -> bytes:
    """A binary glTF 2.0 file."""
    writer = GltfWriter()
    material = writer.add("materials", {"pbrMetallicRoughness": {"metallicFactor": 0.0}, "doubleSided": True})
    vertices, colours, indices = _coloured_vertices(scene)
    primitive = writer.primitive(vertices, indices, colours, material=material)
    writer.add_root({"name": name, "mesh": writer.add("meshes", {"name": name, "primitives": [primitive]})})
    writer.add("cameras", _lens(scene.camera))
    writer.add_root(_camera_node(scene.camera))
    writer.uses(_LIGHTS)
    writer.json["extensions"] = {_LIGHTS: {"lights": [_point_light(scene.light)]}}
    writer.add_root(_light_node(scene.light))
    return writer.glb()


def _coloured_vertices(
    scene: "ProceduralScene",
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.uint32]]:
    """Positions and linear colours, (v, 3) float32 each, and indices, (f, 3) uint32. Vertices are split by colour."""
    n = len(scene.palette)
    key = np.asarray(scene.faces, np.int64) * n + np.asarray(scene.colour, np.int64)[:, None]
    used, indices = np.unique(key, return_inverse=True)
    vertices, palette = np.asarray(scene.vertices, "<f4"), np.asarray(scene.palette, "<f4")
    return vertices[used // n], palette[used % n], indices.reshape(key.shape).astype("<u4")


def _camera_node(camera: dict[str, Any]) -> dict[str, Any]:
    """The node of a camera. A glTF camera looks along its node's -Z, with +Y up."""
    position, target, up = (np.asarray(camera.get(k, (0, 1, 0)), float) for k in ("position", "target", "up"))
    back = (position - target) / np.linalg.norm(position - target)
    right = np.cross(up, back) / np.linalg.norm(np.cross(up, back))
    columns = np.c_[np.stack([right, np.cross(back, right), back, position]), (0, 0, 0, 1)]
    return {"name": "camera", "camera": 0, "matrix": columns.ravel().tolist()}


def _lens(camera: dict[str, Any]) -> dict[str, Any]:
    return {"type": "perspective", "perspective": {"yfov": math.radians(camera.get("vfov", 60.0)), "znear": 0.01}}


def _light_node(light: dict[str, Any]) -> dict[str, Any]:
    corner, u, v = (np.asarray(light[k], float) for k in ("corner", "u", "v"))
    middle = corner + (u + v) / 2.0
    return {"name": "light", "translation": middle.tolist(), "extensions": {_LIGHTS: {"light": 0}}}


def _point_light(light: dict[str, Any]) -> dict[str, Any]:
    colour = [float(c) for c in light.get("colour", (1.0, 1.0, 1.0))]
    return {"type": "point", "color": colour, "intensity": float(light.get("intensity", 1.0))}


def _ply(scene: "ProceduralScene") -> bytes:
    rgb = np.round(255.0 * linear_to_srgb(np.asarray(scene.palette, float))).astype(np.uint8)
    vertices = np.ascontiguousarray(scene.vertices, "<f4")
    faces = np.empty(len(scene.faces), [("n", "u1"), ("corners", "<i4", 3), ("rgb", "u1", 3)])
    faces["n"], faces["corners"], faces["rgb"] = 3, scene.faces, rgb[scene.colour]
    head = [
        "ply\nformat binary_little_endian 1.0",
        f"element vertex {len(vertices)}",
        *(f"property float {axis}" for axis in "xyz"),
        f"element face {len(faces)}\nproperty list uchar int vertex_indices",
        *(f"property uchar {channel}" for channel in ("red", "green", "blue")),
        "end_header\n",
    ]
    return "\n".join(head).encode() + vertices.tobytes() + faces.tobytes()


def _write_obj(scene: "ProceduralScene", name: str, path: Path) -> list[Path]:
    """Write an OBJ file, and its colours to an .mtl file next to it."""
    library = _library(path)
    lines = [f"mtllib {library.name}", f"o {name}"]
    lines += [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in np.asarray(scene.vertices).tolist()]
    colour = np.asarray(scene.colour)
    order = np.argsort(colour, kind="stable")
    groups = np.split(np.asarray(scene.faces)[order] + 1, np.flatnonzero(np.diff(colour[order])) + 1)
    names = np.unique(colour).tolist()
    for k, faces in zip(names, groups):
        lines.append(f"usemtl colour{k}")
        lines += [f"f {a} {b} {c}" for a, b, c in faces.tolist()]
    paints = ["newmtl colour{}\nKd {:.6g} {:.6g} {:.6g}\n".format(k, *np.asarray(scene.palette)[k]) for k in names]
    with atomic_output(library) as paint_file, atomic_output(path) as file:
        paint_file.write_text("\n".join(paints), encoding="utf-8")
        file.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return [path, library]
