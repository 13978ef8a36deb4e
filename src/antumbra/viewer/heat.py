"""The work of a plan in colours: the boxes that the rays of each pixel test."""

from typing import NamedTuple

import numpy as np

from ..picture.frame_request import TimeSample
from ..picture.heat_maps import draw_bar, linear_scale
from ..picture.traversal_steps import explain
from ..scene.camera import Camera
from ..scene.lights import Light
from .model import Model

_WIDTH, _LETTERS = 320, 15  # pixels: width of the legend, and height of its letters


class Work(NamedTuple):
    """The work of a plan in a picture."""

    image: np.ndarray  # (h, w, 3) uint8 sRGB; black where no ray is asked
    rays: int
    each: str  # box tests for each ray, as text
    legend: np.ndarray  # (H, W, 3) uint8 sRGB: the colours and their numbers


def work_picture(model: Model, camera: Camera, lights: list[Light], spp: int) -> Work:
    """Count the box tests of a picture's shadow rays under the page's plan."""
    moment = TimeSample(model.time, camera, lights)
    explanation = explain(model.scene, [moment], [model.looks.plan], spp=spp, threads=model.threads)
    (found,) = explanation.plans
    scale = linear_scale(found.boxes[explanation.asks])
    each = f"{found.box_tests / max(explanation.rays, 1):.4g} boxes tested a ray by {found.plan}"
    legend = draw_bar(scale.bar("boxes tested for each pixel's rays"), _WIDTH, _LETTERS)
    return Work(scale.colours(found.boxes, explanation.asks), explanation.rays, each, legend)
