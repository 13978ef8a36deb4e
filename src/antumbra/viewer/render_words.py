"""The `antumbra render` command of what a page shows: its camera, time and lights as arguments."""

from collections.abc import Iterable

from ..scene.camera import Camera
from ..scene.lights import DirectionalLight, DiskLight, Light, PointLight, QuadLight, SphereLight
from ..scene.sky import Sky
from .viewer_model import Model


def render_command(model: Model, camera: Camera) -> str:
    """The command that renders this camera of the model's scene in these lights, apart from what `left_out` names."""
    words = [f"antumbra render {model.source}", f"--size {camera.width}x{camera.height}"]
    words.append(f"--camera={_place(camera.position)}:{_place(camera.target)}:{_number(camera.vfov)}")
    if model.scene.animated:
        words.append(f"--time {_number(model.time)}")
    if not model.has_default_lights:
        lamps = model.active_lights
        words += [word for lamp in lamps if (word := light_word(lamp.light)) is not None]
        if not any(isinstance(lamp.light, Sky) for lamp in lamps):
            words.append("--sky none")
    return " ".join(words)


def left_out(model: Model) -> list[str]:
    """What the command leaves out: lights without a form, and colours, since lights of the command line are white."""
    lamps = [] if model.has_default_lights else model.active_lights
    missing = [lamp.name for lamp in lamps if light_word(lamp.light) is None]
    return missing + [f"the colour of {lamp.name}" for lamp in lamps if not _is_white(lamp.light)]


def light_word(light: Light) -> str | None:
    """A light as an option, without its colour; None if none describes it."""
    if isinstance(light, Sky):
        plain = light.image is None and light.intensity == 1.0 and light.turn == 0.0
        return "--sky daylight" if plain else None
    form = _form(light)
    return None if form is None else f"--light={form}@{_number(light.intensity)}"


def _form(light: Light) -> str | None:
    match light:
        case DirectionalLight():
            return f"sun:{_point(light.direction)}:{_number(light.angular_diameter)}"
        case PointLight():
            return f"point:{_place(light.position)}"
        case SphereLight():
            return f"sphere:{_place(light.center)}:{_number(light.radius)}"
        case DiskLight():
            return f"disk:{_place(light.center)}:{_point(light.normal)}:{_number(light.radius)}"
        case QuadLight():
            return f"quad:{_place(light.corner + (light.u + light.v) / 2.0)}:{_point(light.u)}:{_point(light.v)}"
    return None


def _is_white(light: Light) -> bool:
    return all(c == 1.0 for c in light.colour)


def _place(values: Iterable[float]) -> str:
    """A point; small scenes may lie thousands of kilometres from the origin of their coordinates."""
    return _point(values, 13)


def _point(values: Iterable[float], digits: int = 9) -> str:
    """Three numbers; those that are only rounding errors beside the others become 0."""
    numbers = [float(value) for value in values]
    least = 1e-12 * max(map(abs, numbers))
    return ",".join(_number(number if abs(number) > least else 0.0, digits) for number in numbers)


def _number(value: float, digits: int = 9) -> str:
    return f"{value + 0.0:.{digits}g}"
