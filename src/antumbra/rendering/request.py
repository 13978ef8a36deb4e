"""The request of a frame: its checked arguments."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ..query.diffuse import Passes
from ..query.refine import FinerSamples
from ..scene.camera import Camera


class Request(NamedTuple):
    """The checked arguments of a frame."""

    camera: Camera
    lights: list
    samples: list[np.ndarray]  # per light (16, n, 3), from `light_samples`
    facing: int = 0  # a value of CULL_FACES
    time: float = 0.0  # seconds
    counters: bool = False
    progress: Callable | None = None
    smooth: bool = False  # the argument `filter`
    finer: FinerSamples | None = None  # samples of refined pixels; None: no refinement
    passes: Passes | None = None  # passes of diffuse rays; None: no bounced light
    background: bool = True  # whether skies are seen
    smooth_skies: bool = False  # whether the light of skies is smoothed, as that of all lights is if `smooth`
    layers: bool = False  # whether the frame gets its `Layers`
    textures: bool = True  # whether pixels show textures and colours of vertices, not mean colours of faces
    smooth_normals: bool = True  # whether the normals of vertices shade, not those of faces
    ground: float | None = None  # height of the ground that catches shadows, world; None: there is none
    antialias: bool = True  # see `smooths_edges`

    @property
    def smooths_edges(self) -> bool:
        """Whether edges are smoothed without another ray. Finer samples divide them instead."""
        return self.antialias and self.finer is None


def rays_of(request: Request) -> tuple[int, int]:
    """At most so many shadow rays of the picture; and rays of bounced light, with their shadow rays."""
    pixels = request.camera.width * request.camera.height
    bounced = 0 if request.passes is None else len(request.passes.directions) * (1 + len(request.lights))
    return pixels * sum(samples.shape[1] for samples in request.samples), pixels * bounced
