"""JSON records of scenes, lights and cameras, and the digests by which jobs recognise their stored results.

The same settings give the same bytes. Threads, memory, plan and shards change no result, so they are not recorded.
"""

import hashlib
import json
import math
from dataclasses import fields

import numpy as np

from ..engine.paged_scene import PagedScene
from ..engine.scene import AnyScene
from ..scene.camera import Camera
from ..scene.lights import Light
from ..scene.mesh import ObjectInfo

# --- A digest of a scene, by which jobs know that kept results belong to it -------------------------------------------


_STORE_HEADER = 4096  # bytes of a store, which hold the checksum of the checksums of all chunks


def scene_digest(scene: AnyScene, time: float, threads: int | None = None) -> str:
    """SHA-256 of the scene's triangles at a time, with colours, cut-outs and objects; of a store, of its first page."""
    digest = hashlib.sha256()
    if isinstance(scene, PagedScene):
        with scene.store.path.open("rb") as stream:
            digest.update(stream.read(_STORE_HEADER))
        return digest.hexdigest()
    triangles = scene.triangles(time, threads)
    arrays = triangles.vertices, triangles.origin, triangles.colour, scene.object_of_face
    for array in *arrays, *(triangles.cutouts or ()):
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()


# --- What a data set records: its settings, its frames, and digests. Everything is in the types of JSON ---------------
#
# The same settings give the same bytes. Threads, memory, plan and shards change none, so they are no settings.


FORMAT = 1
"""Version of the manifest's schema, which docs/jobs/dataset.md describes."""


def scene_record(scene: AnyScene, time: float, threads: int | None) -> dict:
    """The scene: its name, size and frame, and a digest of all that the frames depend on."""
    return {
        "name": scene.name,
        "sha256": scene_digest(scene, time, threads),
        "triangles": scene.n_triangles,
        "up": scene.up,
        "time": time,
        "bounds": scene.bounds.tolist(),
        "origin": scene.origin.tolist(),
        **({"crs": scene.crs} if scene.crs else {}),
    }


def object_records(scene: AnyScene) -> list[dict]:
    """The objects of the scene. The index in this list is what the layer ``IndexOB`` holds."""
    names = [m.name for m in scene.meshes]
    return [_object(each, names[each.mesh] if names else None) for each in scene.objects]


def _object(given: ObjectInfo, mesh: str | None) -> dict:
    """An object; of a city object, also its type and the object that it is a part of."""
    more = {name: value for name in ("type", "parent") if (value := getattr(given, name))}
    return {"name": given.name, "mesh": mesh, "instance": given.instance, **more}


def light_record(light: Light) -> dict:
    """A light as names and values."""
    return {"type": type(light).__name__, **{f.name: _plain(getattr(light, f.name)) for f in fields(light)}}


def camera_record(camera: Camera) -> dict:
    """A camera as its arguments and as matrices.

    ``intrinsics`` (3, 3) and ``world_to_camera`` (4, 4), both by rows, are those of OpenCV: x to the right, y down, z
    along the view; pixel centres are at half numbers. Both take world coordinates to pixels. Cameras that are not
    perspective have ``projection`` and ``extent`` instead of ``intrinsics``.
    """
    names = "position", "target", "up", "vfov", "width", "height"
    if camera.listed:
        lens: dict = {"projection": camera.projection, "extent": camera.extent}
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


def digest_of(settings: dict) -> str:
    """SHA-256 of settings."""
    return hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()


def differences(old: dict, new: dict, of: str = "") -> list[str]:
    """In words, the settings that differ: "spp 4, not 8" where both are short, else the name ("scene sha256")."""
    told = []
    for key in sorted(old.keys() | new.keys()):
        a, b, name = old.get(key), new.get(key), of + key
        if isinstance(a, dict) and isinstance(b, dict):
            told += differences(a, b, name + " ")
        elif a != b:
            short = all(isinstance(v, (str, int, float)) and len(str(v)) < 30 for v in (a, b))
            told.append(f"{name} {a}, not {b}" if short else name)
    return told


def _plain(value):
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, float) and not math.isfinite(value):
        return None  # no limit
    return list(value) if isinstance(value, tuple) else value
