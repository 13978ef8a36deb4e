"""Traced pictures of a page, from coarse to fine, while its camera rests."""

from collections.abc import Callable
from dataclasses import replace
from time import perf_counter
from typing import NamedTuple

import numpy as np

from ..picture.frame import Frame
from ..picture.image_files import to_srgb8
from ..picture.render_options import RenderOptions
from ..scene.camera import Camera
from ..scene.light_lists import N_SETS
from ..scene.lights import Light
from ..scene.sky import Sky
from .heat import work_picture
from .model import SEEN, STEPS, Model

Check = Callable[..., None]
"""Called often during long work; it raises an exception to end the work. Arguments are ignored."""

MOST_PIXELS = 1_600_000
"""Of a picture. Pages with more pixels show it enlarged."""

_UNLIT = np.array([24, 26, 32], np.uint8)  # where no surface is seen


class Step(NamedTuple):
    """How fine a picture is."""

    coarse: int  # pixels of the page along the side of one of the picture
    spp: int  # shadow rays for each pixel and light
    adaptive: bool = False  # sixteen sub-pixels at edges, and more rays in penumbrae

    def options(self, time: float) -> RenderOptions:
        """The options of the picture of a time: coarse pictures are smoothed."""
        refined = self.spp if self.adaptive else None
        return RenderOptions(spp=self.spp, time=time, filter=None if self.adaptive else True, adaptive=refined)

    def __str__(self) -> str:
        size = "full size" if self.coarse == 1 else f"1/{self.coarse} of the size"
        return f"{size}, {self.spp} rays a light" + (", edges refined" if self.adaptive else "")


STEPS_OF_PICTURES = Step(8, 1), Step(4, 2), Step(2, 4), Step(1, 4), Step(1, 16), Step(1, 64, True)
"""From the first picture after a move to the last one; each takes two to five times as long as the one before."""

STEPS_OF_WORK = Step(8, 1), Step(4, 1), Step(1, 1)
"""Of pictures of the work of a plan, which counts the rays as they are."""


class Traced(NamedTuple):
    """A picture of the page."""

    image: np.ndarray  # (h, w, 3) uint8 sRGB
    step: Step
    seconds: float
    rays: int
    note: str = ""  # what is shown, if it is no plain picture
    legend: np.ndarray | None = None  # (H, W, 3) uint8 sRGB: the colours and their numbers


def steps_of(model: Model) -> tuple[Step, ...]:
    """The pictures that a page gets, one after the other."""
    return STEPS_OF_WORK if model.looks.show == STEPS else STEPS_OF_PICTURES


def traced(model: Model, camera: Camera, step: Step, check: Check = lambda *_: None) -> Traced:
    """Trace one picture.

    camera : its size is that of the page in pixels
    check : called about ten times a second

    Raises
    ------
    InputError
        If the plan of the work is unknown, or has no tree.
    """
    start, camera = perf_counter(), shrunk(camera, step.coarse)
    if model.looks.show == STEPS:
        work = work_picture(model, camera, [at_quality(lamp.light, step.spp) for lamp in model.shining], step.spp)
        return Traced(work.image, step, perf_counter() - start, work.rays, work.each, work.legend)
    if model.looks.show.startswith(SEEN):
        name = model.looks.show.removeprefix(SEEN)
        frame = _frame(model, camera, [in_full(model.lamp(name).light, step.spp)], step, check)
        image, note = _grey(frame.visibility[0], frame.mask), f"white: all of {name} is seen"
    else:
        frame = _frame(model, camera, [at_quality(lamp.light, step.spp) for lamp in model.shining], step, check)
        model.learn(frame)
        image, note = to_srgb8(frame.image, model.exposure), ""
    return Traced(image, step, perf_counter() - start, frame.rays, note)


def _frame(model: Model, camera: Camera, lights: list[Light], step: Step, check: Check) -> Frame:
    return model.renderer.render(camera, lights, options=step.options(model.time), progress=check)


def at_quality(light: Light, spp: int) -> Light:
    """The light with as many rays as others: a sky of fewer distant lights for coarse pictures."""
    if not isinstance(light, Sky) or not light.interleave:
        return light
    return replace(light, count=min(N_SETS * spp, light.count)).named(light.name)


def in_full(light: Light, spp: int) -> Light:
    """The light such that each pixel tests all of it: a sky of few distant lights."""
    if not isinstance(light, Sky):
        return light
    return replace(light, interleave=False, count=min(N_SETS + 4 * spp, light.count)).named(light.name)


def shrunk(camera: Camera, coarse: int) -> Camera:
    """The camera for a picture of the page whose pixels are so many pixels of the page wide, or more."""
    side = max(float(coarse), (camera.width * camera.height / MOST_PIXELS) ** 0.5)
    return camera.resized(*(max(1, round(n / side)) for n in (camera.width, camera.height)))


def _grey(share: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """(h, w, 3) uint8: shares from black to white, where a surface is seen."""
    grey = np.round(255.0 * share).astype(np.uint8)[..., None]
    return np.where(seen[..., None], grey, _UNLIT)
