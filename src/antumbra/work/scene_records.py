"""JSON records of scenes, lights and cameras, and the digests by which stored results are recognised.

Equal settings give equal bytes. Threads, memory, plan and shards do not affect results, so they are not recorded.
"""

import hashlib
import json
import math
from dataclasses import fields
from typing import Any, TypeAlias

import numpy as np

from ..engine.scene import AnyScene
from ..scene.camera import Camera
from ..scene.lights import Light
from ..scene.mesh import ObjectInfo
from ..scene.units import METRE

# --- Scene digest -----------------------------------------------------------------------------------------------------


def scene_digest(scene: AnyScene, time: float, threads: int | None = None) -> str:
    """SHA-256 of the scene's triangles at a time, with colours, alpha masks and objects.

    Of a store, it is that of the first page; of instances, that of the meshes and transforms; of a
    raster, that of its heights.
    """
    digest = hashlib.sha256()
    for part in scene.data.content(time, threads):
        digest.update(part)
    return digest.hexdigest()


# --- Records, in JSON types -------------------------------------------------------------------------------------------


FORMAT = 2
"""Version of the manifest's schema, which docs/jobs/dataset.md describes."""

Record: TypeAlias = dict[str, Any]
"""An object of JSON."""


def scene_record(scene: AnyScene, time: float, threads: int | None) -> Record:
    """A scene's name, size and coordinate frame, and a digest of everything that affects the frames."""
    return {
        "name": scene.name,
        "sha256": scene_digest(scene, time, threads),
        "triangles": scene.n_triangles,
        "up": scene.up,
        "time": time,
        "bounds": scene.bounds.tolist(),
        "origin": scene.origin.tolist(),
        **({"crs": scene.crs} if scene.crs else {}),
        **({} if scene.unit == METRE else {"unit": scene.unit.name}),
    }


def object_records(scene: AnyScene) -> list[Record]:
    """The objects of the scene. The layer ``IndexOB`` contains indices into this list."""
    names = [m.name for m in scene.meshes]
    return [_object(each, names[each.mesh] if names else None) for each in scene.objects]


def _object(info: ObjectInfo, mesh: str | None) -> Record:
    """An object; a city object also has its type and parent."""
    more = {name: value for name in ("type", "parent") if (value := getattr(info, name))}
    return {"name": info.name, "mesh": mesh, "instance": info.instance, **more}


def light_record(light: Light) -> Record:
    """A light's type and fields."""
    return {"type": type(light).__name__, **{f.name: _plain(getattr(light, f.name)) for f in fields(light)}}


def camera_record(camera: Camera) -> Record:
    """A camera's arguments and matrices.

    ``intrinsics`` (3, 3) and ``world_to_camera`` (4, 4), both row-major, follow OpenCV: x to the right, y down, z along
    the view; pixel centres are at half-integers. Together they map world coordinates to pixels. Cameras that are not
    perspective have ``projection`` and ``extent`` instead of ``intrinsics``.
    """
    names = "position", "target", "up", "vfov", "width", "height"
    if camera.listed:
        lens: Record = {"projection": camera.projection, "extent": camera.extent}
        rotation = camera.frame
    else:
        rays = camera.rays(np.zeros(3))
        pixel = float(np.linalg.norm(rays.dx))
        right, down = rays.dx / pixel, rays.dy / np.linalg.norm(rays.dy)
        rotation = np.stack([right, down, np.cross(right, down)])
        middle = camera.width / 2.0, camera.height / 2.0
        lens = {"intrinsics": [[1.0 / pixel, 0.0, middle[0]], [0.0, 1.0 / pixel, middle[1]], [0.0, 0.0, 1.0]]}
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, -rotation @ camera.position
    values = {name: _plain(getattr(camera, name)) for name in names}
    return {**values, **lens, "world_to_camera": matrix.tolist()}


def digest_of(settings: Record) -> str:
    """SHA-256 of settings."""
    return hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()


def differences(old: Record, new: Record, of: str = "") -> list[str]:
    """Describe the settings that differ: "spp 4, not 8" if both values are short, else the name ("scene sha256")."""
    lines = []
    for key in sorted(old.keys() | new.keys()):
        a, b, name = old.get(key), new.get(key), of + key
        if isinstance(a, dict) and isinstance(b, dict):
            lines += differences(a, b, name + " ")
        elif a != b:
            short = all(isinstance(v, (str, int, float)) and len(str(v)) < 30 for v in (a, b))
            lines.append(f"{name} {a}, not {b}" if short else name)
    return lines


def _plain(value: Any) -> Any:
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, float) and not math.isfinite(value):
        return None  # unlimited
    return list(value) if isinstance(value, tuple) else value
