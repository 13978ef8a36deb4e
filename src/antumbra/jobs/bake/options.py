"""The arguments of a bake, checked."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...checks import choice, flag, is_number, number, quoted, text, whole_number
from ...engine.plan import DEFAULT_PLAN, parse_plan
from ...engine.scene import Scene
from ...errors import InputError
from ...extras import import_extra
from ...files import checked_output
from ...kernels.parallel import thread_count
from ...picture.image_files import automatic_exposure, checked_exposure
from ...query.light_samples import sample_sets
from ...scene.default_picture import sun
from ...scene.light_lists import without_interleave
from ...scene.lights import AmbientOcclusion, DirectionalLight, Light, check_lights
from .measure import QUANTITIES, Asked

MAX_TEXTURE = 16384
_OWN_NAMES = {"ao": "_AO", "shadow": "_SHADOW", "sun": "_SUN", "light": "_LIGHT", "bent-normal": "_BENT_NORMAL"}
_SKY = ("ao", "bent-normal")  # what asks the sky, and no lights


class Options(NamedTuple):
    """Checked arguments of `bake`."""

    asked: Asked
    attribute: str
    multiply: bool
    texture: int | None
    uv: int | None
    bits: int
    exr: bool
    denoise: bool
    exposure: float | None
    keep_hidden: bool


def own_lights(scene: Scene, what: str, time: float) -> list[Light]:
    """The default lights of a scene; of what a sun lights, its first sun, or that of default pictures."""
    lights = [without_interleave(light) for light in scene.default_lights(time)]
    if what != "sun":
        return lights
    return [next((light for light in lights if isinstance(light, DirectionalLight)), sun(scene.up))]


def exposure_of(values: np.ndarray, options: Options) -> float:
    """The factor on light, from the values that were measured ((n, c), NaN where nothing is seen)."""
    if options.exposure is not None:
        return options.exposure
    if options.asked.what != "light":
        return 1.0
    return automatic_exposure(values[None], np.isfinite(values[None, :, 0]))


def check_output(path) -> Path:
    """`path`, if a bake can be written there; otherwise an InputError that names the cure."""
    return checked_output(path, (".glb",))


def check(
    what, *, lights, radius, spp, attribute, multiply, texture, uv, bits, exr, denoise, exposure, keep_hidden, time,
    plan, sampler, threads,
) -> Options:  # fmt: skip
    """The arguments of `bake`, checked as far as no scene is needed. Raises InputError."""
    choice(what, "what", QUANTITIES)
    thread_count(threads)
    time = number(time, "time (seconds)", -np.inf, np.inf, "[]")
    flags = {"multiply": multiply, "exr": exr, "denoise": denoise, "keep_hidden": keep_hidden}
    multiply, exr, denoise, keep_hidden = (flag(value, name) for name, value in flags.items())
    if attribute is not None:
        text(attribute, "attribute")
    parse_plan(DEFAULT_PLAN if plan is None else plan)
    sample_sets(whole_number(spp, "spp", 1, 1024), sampler)
    lights = _checked_lights(what, lights, radius)
    if not is_number(bits) or bits not in (8, 16):
        raise InputError(f"bits is {quoted(bits)}; a PNG has 8 or 16")
    if texture is not None:
        whole_number(texture, "texture", 16, MAX_TEXTURE)
        if attribute is not None or multiply:
            raise InputError("attribute and multiply belong to values at vertices; leave them or texture out")
        if uv is None:
            import_extra("xatlas", "an atlas (--texture without --uv)", "bake")
    elif uv is not None or exr or denoise or bits != 8:
        raise InputError("uv, bits, exr and denoise belong to a texture; give its size as texture")
    if uv is not None:
        whole_number(uv, "uv", 0, 7)
    if denoise and what not in ("ao", "shadow"):
        raise InputError(f"denoise is for ao and shadow, and not for {what}; leave it out and raise spp")
    attribute = attribute or ("_BENT_NORMAL" if what == "bent-normal" else "COLOR_0")
    if attribute != "COLOR_0" and not (attribute.startswith("_") and attribute.isascii() and attribute[1:]):
        raise InputError(f"attribute is {attribute!r}; write COLOR_0, or a name of your own such as {_OWN_NAMES[what]}")
    if multiply and attribute != "COLOR_0":
        raise InputError("multiply is for COLOR_0; leave it or attribute out")
    if exposure is not None:
        exposure = checked_exposure(exposure)
    asked = Asked(what, lights, spp, sampler, plan, time, threads)
    return Options(asked, attribute, multiply, texture, uv, bits, exr, denoise, exposure, keep_hidden)


def _checked_lights(what: str, lights, radius) -> list[Light]:
    if what in _SKY:
        if lights is not None:
            raise InputError(f"{what} asks the sky; leave lights out")
        return [AmbientOcclusion(None if radius is None else number(radius, "radius", 0.0, np.inf, "(]"))]
    if radius is not None:
        raise InputError(f"radius is for ao and bent-normal, and not for {what}; leave it out")
    lights = [] if lights is None else check_lights(lights, "y")  # no `Sky` among them, see below
    if any(light.domain == "list" for light in lights):
        raise InputError("a bake takes lights one by one; PointLights is a list of them")
    if what == "sun" and lights and not (len(lights) == 1 and isinstance(lights[0], DirectionalLight)):
        raise InputError("sun takes one DirectionalLight; for several lights bake light")
    if what == "shadow" and any(light.domain == "hemisphere" for light in lights):
        raise InputError("a sky casts no shadow of its own; bake ao, or light")
    return lights
