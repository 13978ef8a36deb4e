"""Parse the texts of command-line arguments: numbers, sizes, frames, cameras and lights.

All arguments are checked before a scene is loaded.
"""

import math
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.errors import InputError
from ..base.extras import METHODS, import_extra, try_plugins
from ..scene.materials import srgb_to_linear

if TYPE_CHECKING:
    from ..engine.scene import AnyScene
    from ..scene.camera import Camera
    from ..scene.lights import AmbientOcclusion, Light
    from ..techniques.srdh.representative_rays import SrdhRays


# --- Parsing of arguments ---------------------------------------------------------------------------------------------


_COUNT = re.compile(r"(\d+(?:\.\d+)?)([kKmM]?)")
_BYTES = re.compile(r"(\d+(?:\.\d+)?)([kKmMgGtT]?)(?:i?[bB])?")
_SIZE = re.compile(r"(\d+)(?:[xX](\d+))?")
_FRAMES = re.compile(r"(\d{1,9}):(\d{1,9})(?::(\d{1,9}))?")
_INDEX = re.compile(r"\s*-?\d{1,9}\s*")
_WHOLE = re.compile(r"[0-9]{1,9}")
_MAX_SIZE = 32768

LIGHT_FORMS = {
    "point": "point:X,Y,Z",
    "quad": "quad:CX,CY,CZ:UX,UY,UZ:VX,VY,VZ",
    "disk": "disk:CX,CY,CZ:NX,NY,NZ:RADIUS",
    "sphere": "sphere:CX,CY,CZ:RADIUS",
    "sun": "sun:DX,DY,DZ[:ANGULAR_DIAMETER]",
}
"""Kind of light -> its syntax."""


class LightForm(NamedTuple):
    """A kind of light that another package adds."""

    syntax: str  # such as "window:CX,CY,CZ:WIDTH[:HEIGHT]"
    make: Callable[..., "Light"]  # make(*fields, intensity=...): the fields as text, the intensity only if it is given


_added_lights: dict[str, LightForm] = {}


def register_light(kind: str, form: LightForm) -> None:
    """Add a kind of light to the syntax of lights, in the function of a plugin (docs/methods.md).

    Raises
    ------
    InputError
        If the kind is taken, or its syntax does not begin with it.
    """
    if kind in LIGHT_FORMS or kind in _added_lights or form.syntax.partition(":")[0] != kind:
        raise InputError(f"{kind!r} cannot be a kind of light: it is taken, or {form.syntax!r} does not begin with it")
    _added_lights[kind] = form


CAMERA_KINDS = {"ortho": "orthographic", "top": "top", "panorama": "panoramic"}
"""Word for a camera kind -> its name in `Scene.default_camera`."""

CAMERA_FORMS = "ortho[:POSITION:TARGET:HEIGHT]", "top", "panorama[:POSITION:TARGET]"
"""Syntax of these cameras."""


class CameraSpec(NamedTuple):
    """A camera given as position:target[:vfov], or as a kind with or without a position."""

    position: NDArray[np.float64] | None  # (3,); None: the default camera of its kind
    target: NDArray[np.float64] | None  # (3,)
    vfov: float = 60.0
    kind: str = "perspective"  # one of `scene.default_picture.KINDS`
    extent: float | None = None  # height of the view of an orthographic camera with a position


class FrameSequence(NamedTuple):
    """Frames of an animation. Frame k shows the time k / fps."""

    numbers: range
    fps: float

    def time(self, number: int) -> float:
        """The time of a frame, in seconds."""
        return number / self.fps


def parse_count(text: str, what: str) -> int:
    """Parse a whole number with an optional suffix k (thousand) or M (million): 100k, 2.5M."""
    match = _COUNT.fullmatch(text.strip())
    value = float(match[1]) * {"": 1, "k": 1_000, "m": 1_000_000}[match[2].lower()] if match else math.nan
    if not value.is_integer() or value >= 1 << 53:
        raise InputError(f"{what} is {text!r}; it must be a whole number such as 5000, 100k or 2.5M")
    return int(value)


def parse_bytes(text: str, what: str) -> int:
    """Parse a number of bytes with an optional binary suffix k, M, G or T: 512M, 4G."""
    match = _BYTES.fullmatch(text.strip()) if len(text) < 40 else None
    value = float(match[1]) * 1024 ** ["", "k", "m", "g", "t"].index(match[2].lower()) if match else math.nan
    if not value < 1 << 60:
        raise InputError(f"{what} is {text!r}; it must be a number of bytes such as 512M or 4G")
    return int(value)


def parse_size(text: str, what: str = "--size") -> tuple[int, int]:
    """Parse the width and height of a picture: ``1920x1080``, or ``512`` for a square."""
    match = _SIZE.fullmatch(text.strip())
    size = (int(match[1]), int(match[2] or match[1])) if match and len(text) < 20 else (0, 0)
    if not all(1 <= n <= _MAX_SIZE for n in size):
        raise InputError(f"{what} is {text!r}; write WIDTHxHEIGHT such as 1024x768, each from 1 to {_MAX_SIZE}")
    return size


def check_plot(path: Path, option: str = "--plot") -> None:
    """Raise an InputError unless a plot can be drawn and written to this file."""
    from ..base.files import checked_output

    checked_output(path, (".png",))
    import_extra("matplotlib", option, "plot")


def parse_frames(text: str, time: float | None = None, fps: float | None = None) -> FrameSequence:
    """Parse ``FIRST:LAST[:STEP]``, LAST included, together with ``--time`` and ``--fps``."""
    match = _FRAMES.fullmatch(text.strip())
    first, last, step = (int(n or 1) for n in match.groups()) if match else (0, -1, 0)
    if not (first <= last and step):
        raise InputError(
            f"--frames is {text!r}; write FIRST:LAST or FIRST:LAST:STEP such as 0:240, with FIRST <= LAST and STEP >= 1"
        )
    if time is not None:
        raise InputError("--time is for a single picture; leave it out: frame k of --frames shows the time k / fps")
    fps = 24.0 if fps is None else fps
    if not 1e-6 <= fps <= 1e6:
        raise InputError(f"--fps is {fps:g}; it must be a positive number of frames per second, such as 24")
    return FrameSequence(range(first, last + 1, step), fps)


def parse_srdh_rays(text: str) -> "SrdhRays":
    """Parse `SrdhRays` from comma-separated words.

    The words are a number of pixels along each side of the picture, or ``all``; ``bounce``; ``last-frame``.
    """
    chosen: dict[str, Any] = {}
    with _named(f"--srdh-rays {text}"):
        for part in (p.strip() for p in text.split(",")):
            name = {"bounce": "bounce", "last-frame": "last_frame"}.get(part, "size")
            if name == "size" and part != "all" and not _WHOLE.fullmatch(part):
                raise InputError(
                    f"{part!r} is unknown; write 16, 32 or all, optionally followed by ,bounce or ,last-frame"
                )
            if name in chosen:
                raise InputError(f"{part!r} repeats an earlier word of its kind; leave one of them out")
            chosen[name] = True if name != "size" else None if part == "all" else int(part)

        from ..techniques.srdh.representative_rays import SrdhRays

        return SrdhRays(**chosen)


def parse_camera(text: str) -> int | CameraSpec:
    """Parse the index of a camera, ``px,py,pz:tx,ty,tz[:vfov]``, or one of `CAMERA_KINDS`."""
    if _INDEX.fullmatch(text):
        return int(text.strip())  # int() keeps some of the blanks that a pattern skips
    parts = text.split(":")
    with _named(f"--camera {text}"):
        if parts[0].strip() in CAMERA_KINDS:
            return _other_camera(parts[0].strip(), parts[1:])
        if not 2 <= len(parts) <= 3:
            forms = "  ".join(CAMERA_FORMS)
            raise InputError(f"write an index, POSITION:TARGET[:VFOV] such as 0,1.7,8:0,1,0:60, or one of {forms}")
        position, target = _vector(parts[0], "position"), _vector(parts[1], "target")
        return CameraSpec(position, target, parse_number(parts[2], "vfov") if parts[2:] else 60.0)


def _other_camera(word: str, fields: list[str]) -> CameraSpec:
    """A camera that is not perspective: its kind, optionally followed by its position and target."""
    kind, count = CAMERA_KINDS[word], 0 if word == "top" else 3 if word == "ortho" else 2
    if len(fields) not in (0, count):
        form = next(form for form in CAMERA_FORMS if form.startswith(word))
        raise InputError(f"write {form}: the kind alone, or with all fields")
    if not fields:
        return CameraSpec(None, None, kind=kind)
    position, target = _vector(fields[0], "position"), _vector(fields[1], "target")
    extent = parse_number(fields[2], "height") if fields[2:] else None
    return CameraSpec(position, target, kind=kind, extent=extent)


def make_camera(
    spec: int | CameraSpec | None, scene: "AnyScene", time: float, size: tuple[int, int], moving: bool = False
) -> "Camera":
    """The camera for a result of `parse_camera`.

    None stands for the scene's first camera or, without one, for a camera that shows the scene.

    moving : whether the camera is for an animation; a default camera then shows all of its frames
    """
    fitted_to = None if moving else time
    from ..scene.camera import Camera

    if spec is None and not scene.cameras:
        return scene.default_camera(*size, time=fitted_to)
    if not isinstance(spec, CameraSpec):
        return scene.camera(spec or 0, time).resized(*size)
    if spec.position is None:
        if spec.kind == "panoramic" and scene.cameras:
            return scene.camera(0, time).resized(*size).panoramic()
        return scene.default_camera(*size, spec.kind, time=fitted_to)
    up, instead = ((0, 0, 1), (0, 1, 0)) if scene.up == "z" else ((0, 1, 0), (0, 0, -1))
    assert spec.target is not None  # given with the position
    from ..engine.measured_scenes import check_degrees

    check_degrees(scene, np.stack([spec.position, spec.target]), "the ends of --camera")
    view = spec.target - spec.position
    with np.errstate(over="ignore", invalid="ignore"):  # `Camera` rejects positions that are too far away
        steep = np.linalg.norm(np.cross(view, up)) <= 1e-6 * np.linalg.norm(view)
    if steep and spec.kind == "panoramic":
        raise InputError(
            "--camera panorama: the target is straight above or below; it must set the heading of the centre"
        )
    if steep:  # the usual up vector is parallel to the view
        up = instead
    return Camera(spec.position, spec.target, up, spec.vfov, *size, projection=spec.kind, extent=spec.extent)


def parse_point(text: str, option: str) -> NDArray[np.float64]:
    """Parse a point ``X,Y,Z``."""
    return _vector(text, option)


def parse_bounds(text: str) -> tuple[float, ...]:
    """Parse ``X0,N0,X1,N1``: the lowest and the highest easting and northing."""
    with _named(f"--bounds {text}"):
        numbers = tuple(parse_number(each, "a coordinate") for each in text.split(","))
        if len(numbers) != 4 or not (numbers[0] <= numbers[2] and numbers[1] <= numbers[3]):
            raise InputError("write X0,N0,X1,N1, west and south before east and north")
        return numbers


def parse_interval(text: str, option: str) -> tuple[float, float]:
    """Parse two numbers ``FROM:TO``."""
    first, colon, last = text.partition(":")
    with _named(f"{option} {text}"):
        if not colon:
            raise InputError("write FROM:TO, such as 350:10")
        return parse_number(first, "the first number"), parse_number(last, "the second number")


def parse_light(text: str) -> "int | Light":
    """Parse a light ``KIND:...[@INTENSITY]``, or the index of one of the scene's own lights."""
    if _INDEX.fullmatch(text):
        return int(text.strip())  # int() keeps some of the blanks that a pattern skips
    body, at, strength = text.partition("@")
    kind, *fields = body.split(":")
    with _named(f"--light {text}"):
        forms = _forms_with(kind)
        if kind not in forms:
            raise InputError(f"unknown kind {kind!r}; write one of {'  '.join(forms.values())}")
        form = forms[kind]
        if not form.count(":") - form.count("[:") <= len(fields) <= form.count(":"):
            raise InputError(f"write {form}, optionally followed by @INTENSITY")
        return _light(kind, fields, {"intensity": parse_number(strength, "intensity")} if at else {})


def parse_ambient(text: str) -> "AmbientOcclusion":
    """Parse ambient occlusion: ``RADIUS[@INTENSITY]``. The radius inf means no limit."""
    from ..scene.lights import AmbientOcclusion

    radius, at, strength = text.partition("@")
    with _named(f"--ao {text}"):
        intensity = parse_number(strength, "intensity") if at else 1.0
        return AmbientOcclusion(
            None if radius.strip().lower() == "inf" else parse_number(radius, "radius"), intensity=intensity
        )


def make_lights(specs: "Sequence[int | Light]", scene: "AnyScene", time: float) -> "list[Light]":
    """The lights for results of `parse_light`.

    An empty list stands for the scene's default lights: its own, or daylight, or a lamp in a closed room.
    """
    if specs:
        return [scene.light(a, time) if isinstance(a, int) else a for a in specs]
    return scene.default_lights(time)


def parse_sky(text: str) -> "str | Path | NDArray[np.float64]":
    """Parse a sky: "daylight", "none", the path of an environment map, or a colour as (3,) linear radiance."""
    from ..scene.sky import ENVIRONMENT_SUFFIXES

    if (word := text.strip().lower()) in ("daylight", "none"):
        return word
    if text.lower().endswith(ENVIRONMENT_SUFFIXES):
        return Path(text)
    with _named(f"--sky {text}"):
        return srgb_to_linear(parse_colour(text, f"a {' or '.join(ENVIRONMENT_SUFFIXES)} file, daylight or none"))


def parse_background(text: str) -> "str | NDArray[np.float64]":
    """Parse a background: "transparent", or a colour as (3,) sRGB in [0, 1]."""
    if text.strip().lower() == "transparent":
        return "transparent"
    with _named(f"--background {text}"):
        return parse_colour(text, "transparent")


def parse_colour(text: str, instead: str) -> NDArray[np.float64]:
    """(3,) float64 sRGB in [0, 1] of a CSS colour; `instead`: alternatives for the error message."""
    from PIL import ImageColor

    try:
        return np.array(ImageColor.getrgb(text)[:3]) / 255.0
    except ValueError:
        raise InputError(f"write a colour such as white, #fa0 or #ffaa00, or {instead}") from None


def make_picture_lights(
    specs: "Sequence[int | Light]", sky: "str | Path | NDArray[np.float64] | None", scene: "AnyScene", time: float
) -> "list[Light]":
    """The lights of a picture, from results of `parse_light` and `parse_sky`.

    Without either, they are the scene's default lights.
    """
    from ..scene.sky import Sky

    lights = make_lights(specs, scene, time)
    if sky is None:
        return lights
    others = [light for light in lights if not isinstance(light, Sky)]
    if isinstance(sky, str) and sky == "none":
        return others
    image = None if isinstance(sky, str) else sky
    return [*(others if specs or scene.lights else []), Sky(image, up=scene.up)]


def _forms_with(kind: str) -> dict[str, str]:
    """Kind of light -> its syntax, with those of other packages if `kind` is none of ours."""
    if kind not in LIGHT_FORMS:
        try_plugins(METHODS)
    return LIGHT_FORMS | {name: form.syntax for name, form in _added_lights.items()}


def _light(kind: str, fields: list[str], more: dict[str, Any]) -> "Light":
    from ..scene import lights

    if kind in _added_lights:
        return _added_lights[kind].make(*fields, **more)
    if kind == "point":
        return lights.PointLight(_vector(fields[0], "position"), **more)
    if kind == "quad":
        centre, u, v = (_vector(f, name) for f, name in zip(fields, ("centre", "u", "v")))
        return lights.QuadLight(centre - (u + v) / 2.0, u, v, **more)
    if kind == "disk":
        centre, normal = _vector(fields[0], "centre"), _vector(fields[1], "normal")
        return lights.DiskLight(centre, normal, parse_number(fields[2], "radius"), **more)
    if kind == "sphere":
        return lights.SphereLight(_vector(fields[0], "centre"), parse_number(fields[1], "radius"), **more)
    width = [parse_number(f, "angular diameter") for f in fields[1:]]
    return lights.DirectionalLight(_vector(fields[0], "direction"), *width, **more)


@contextmanager
def _named(what: str) -> Iterator[None]:
    """Prefix the message of an InputError with `what`."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{what}: {error}") from None


def _vector(text: str, name: str) -> NDArray[np.float64]:
    return np.array(_numbers(text, 3, name, "three finite numbers separated by commas"))


def parse_number(text: str, name: str) -> float:
    """Parse a finite number."""
    return _numbers(text, 1, name, "a finite number")[0]


def _numbers(text: str, n: int, name: str, requirement: str) -> list[float]:
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if len(values) != n or not all(map(math.isfinite, values)):
        raise InputError(f"{name} is {text!r}; it must be {requirement}")
    return values
