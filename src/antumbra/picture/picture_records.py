"""Pictures as JSON records: cameras, lights, and the settings of a frame, for image files and ``--json``."""

import hashlib
import math
from dataclasses import fields
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..scene.camera import Camera
    from ..scene.lights import Light
    from .render_options import RenderOptions


def light_fields(light: Any) -> dict[str, Any]:
    """A light as names and values: a list of lights by its length, a sky by a digest of its map."""
    from ..scene.sky import Sky

    kind = {"type": type(light).__name__, **({"name": light.name} if light.name else {})}
    if isinstance(light, Sky):
        digest = hashlib.sha256(light.map.tobytes()).hexdigest()[:16]
        values = {name: getattr(light, name) for name in ("intensity", "colour", "up", "turn", "count")}
        return {**kind, "map": digest, **values}
    if light.domain == "list":
        return {**kind, "count": len(light.points), "interleave": light.interleave}
    return {**kind, **{f.name: getattr(light, f.name) for f in fields(light)}}


def camera_fields(camera: "Camera") -> dict[str, Any]:
    """A camera as names and values."""
    other = ("projection", "extent") if camera.listed else ()
    return {name: getattr(camera, name) for name in ("position", "target", "up", "vfov", "width", "height", *other)}


def picture_record(camera: "Camera", lights: "Sequence[Light]", options: "RenderOptions") -> dict[str, Any]:
    """The settings that determine a picture of a scene: version, camera, lights, and the fields of its options."""
    from ..base.option_fields import deciding_fields
    from ..version import VERSION

    return {
        "version": VERSION,
        "camera": camera_fields(camera),
        "lights": [light_fields(light) for light in lights],
        **deciding_fields(options),
    }


def plain(value: Any) -> Any:
    """A value as JSON types: arrays and tuples become lists, infinity and NaN become None."""
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value if isinstance(value, (str, int, float, bool, type(None))) else str(value)
