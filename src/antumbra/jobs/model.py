"""Models of results: GLB files whose vertices have the false colours of sensors (`COLOR_0`), unlit."""

from typing import NamedTuple

import numpy as np

from ..engine.scene import AnyScene
from ..formats.gltf.gltf_file import (
    ARRAY_BUFFER,
    ELEMENT_ARRAY_BUFFER,
    FLOAT,
    UNSIGNED_INT,
    buffer_views,
    glb_bytes,
    up_axis_transform,
)
from ..scene.camera import axes
from ..scene.materials import srgb_to_linear
from .picture import shown_scale, shown_values
from .sensors import corners_of

LINES, TRIANGLES = 1, 4  # modes of glTF
_UNLIT = "KHR_materials_unlit"
_GREY = 0.35  # linear: surfaces without a value
_LIFT = 0.02  # of its width: how far a patch lies off its surface


class Part(NamedTuple):
    """A coloured mesh, or lines."""

    name: str
    vertices: np.ndarray  # (v, 3) float32
    colours: np.ndarray  # (v, 3) float32, linear
    faces: np.ndarray  # (f, 3) uint32; of lines (f, 2)
    mode: int = TRIANGLES


def coloured_model(table, name: str) -> bytes:
    """A GLB file of a column of a `table.Table`: coloured faces or vertices, else a square for each sensor.

    Coordinates are relative to the scene's `origin`, because glTF has float32; the asset's `extras` give it.
    """
    sensors, scene = table.sensors, table.scene
    values, known = shown_values(table, name)
    scale = shown_scale(table[name], known)
    shown = srgb_to_linear(scale.colours(np.nan_to_num(values), known) / 255.0)
    shown[~known] = _GREY
    corners = corners_of(scene) - scene.origin
    colours = np.full((len(corners), 3, 3), _GREY)
    if sensors.kind == "face":
        colours[sensors.faces] = shown[:, None]
    elif sensors.kind == "vertex":
        used = sensors.corners[:, 0] >= 0
        colours[used] = shown[sensors.corners[used]]
    soup = np.arange(3 * len(corners), dtype=np.uint32).reshape(-1, 3)
    parts = [Part(scene.name, corners.reshape(-1, 3), colours.reshape(-1, 3), soup)]
    if sensors.kind not in ("face", "vertex"):
        parts.append(_squares(sensors, shown, scene))
    told = {"column": name, "unit": table.columns[name].unit, "origin": scene.origin.tolist(), **table.about}
    told["scale"] = [float(scale.ticks[0]), float(scale.ticks[-1])]
    return glb(parts, scene.up, told)


def _squares(sensors, colours: np.ndarray, scene: AnyScene) -> Part:
    """A square for each sensor, as large as its area, a little off its surface; level if it has no normal."""
    n = len(sensors)
    width = np.sqrt(sensors.areas) if sensors.areas is not None else np.full(n, 1.0)
    normals = sensors.normals if sensors.normals is not None else np.broadcast_to(axes(scene.up)[1], (n, 3))
    side = np.where(np.abs(normals[:, :1]) < 0.7, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    u = np.cross(side, normals)
    u *= (width / np.linalg.norm(u, axis=1) / 2.0)[:, None]
    v = np.cross(normals, u)
    middle = sensors.points - scene.origin + _LIFT * width[:, None] * normals
    vertices = np.stack([middle - u - v, middle + u - v, middle + u + v, middle - u + v], 1)
    faces = 4 * np.arange(n, dtype=np.uint32)[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]], np.uint32)
    return Part("sensors", vertices.reshape(-1, 3), colours.repeat(4, 0), faces.reshape(-1, 3))


def glb(parts: list[Part], up: str, extras: dict) -> bytes:
    """A binary glTF 2.0 file of coloured meshes, one node each, without light."""
    blocks, accessors, meshes = list[np.ndarray](), list[dict](), list[dict]()
    for part in parts:
        vertices, colours = (np.ascontiguousarray(a, "<f4") for a in (part.vertices, part.colours))
        first, floats = len(accessors), {"componentType": FLOAT, "type": "VEC3", "count": len(vertices)}
        box = {"min": vertices.min(0).tolist(), "max": vertices.max(0).tolist()}
        accessors += [{"bufferView": first, **floats, **box}, {"bufferView": first + 1, **floats}]
        kind = {"componentType": UNSIGNED_INT, "type": "SCALAR", "count": part.faces.size}
        accessors.append({"bufferView": first + 2, **kind})
        blocks += [vertices, colours, np.ascontiguousarray(part.faces, "<u4")]
        use = {
            "attributes": {"POSITION": first, "COLOR_0": first + 1},
            "indices": first + 2,
            "material": 0,
            "mode": part.mode,
        }
        meshes.append({"name": part.name, "primitives": [use]})
    root = {
        "asset": {"version": "2.0", "generator": "antumbra", "extras": extras},
        "scene": 0,
        "scenes": [{"nodes": list(range(len(parts)))}],
        "nodes": [{"name": part.name, "mesh": k, **up_axis_transform(up)} for k, part in enumerate(parts)],
        "meshes": meshes,
        "materials": [{"doubleSided": True, "extensions": {_UNLIT: {}}}],
        "accessors": accessors,
        **buffer_views(blocks, [ARRAY_BUFFER, ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER] * len(parts)),
        "extensionsUsed": [_UNLIT],
    }
    return glb_bytes(root, blocks)
