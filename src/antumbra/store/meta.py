"""The metadata of a store: the scene without its triangles, as JSON. Floats survive it bit for bit."""

import json
from dataclasses import fields
from typing import NamedTuple

import numpy as np

from ..scene import lights as lights_module
from ..scene.camera import Camera
from ..scene.directional_lights import DirectionalLights
from ..scene.lights import Light
from ..scene.point_lights import PointLights

_CAMERA = ("position", "target", "up", "vfov", "width", "height", "projection", "extent")


class Meta(NamedTuple):
    """The scene of a store, without its triangles."""

    name: str  # name of the scene
    up: str  # "y" or "z"
    n_triangles: int
    bounds: np.ndarray  # (2, 3) float64, world space
    origin: np.ndarray  # (3,) float64: origin of the recentred frame, in world space
    box: np.ndarray  # (2, 3) float32: exact bounds of all vertices in the recentred frame
    cameras: list[Camera]
    lights: list[Light]
    notes: tuple[str, ...]  # notes of the loaders that read the sources
    built: dict  # how the store was built: names and values
    crs: str | None = None  # of the world coordinates


def as_json(meta: Meta) -> bytes:
    """The metadata as JSON."""
    told = meta._asdict()
    if meta.crs is None:
        del told["crs"]  # so that earlier versions read the store
    told["bounds"], told["origin"], told["box"] = (_plain(a) for a in (meta.bounds, meta.origin, meta.box))
    told["cameras"] = [{name: _plain(getattr(c, name)) for name in _CAMERA} for c in meta.cameras]
    told["lights"] = [_light_fields(light) for light in meta.lights]
    return json.dumps(told).encode()


def from_json(data: bytes) -> Meta:
    """The metadata from JSON that `as_json` wrote."""
    told = json.loads(data)
    told["bounds"], told["origin"] = np.array(told["bounds"]), np.array(told["origin"])
    told["box"] = np.array(told["box"], np.float32)
    told["cameras"] = [Camera(**values) for values in told["cameras"]]
    told["lights"] = [_light(values) for values in told["lights"]]
    told["notes"] = tuple(told["notes"])
    return Meta(**told)


def _plain(value):
    return value.tolist() if isinstance(value, np.ndarray) else value


def _light_fields(light: Light) -> dict:
    named = {"name": light.name} if light.name else {}
    return {"type": type(light).__name__} | named | {f.name: _plain(getattr(light, f.name)) for f in fields(light)}


def _light(values: dict) -> Light:
    kind, name, values["colour"] = values.pop("type"), values.pop("name", ""), tuple(values["colour"])
    kinds = {kind.__name__: kind for kind in (PointLights, DirectionalLights)}
    light = (kinds.get(kind) or getattr(lights_module, kind))(**values)
    for key, value in values.items():  # overwrite: normalising a direction again could change its last bit
        object.__setattr__(light, key, np.array(value) if isinstance(getattr(light, key), np.ndarray) else value)
    return light.named(name)
