"""The request of a frame: its checked arguments."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ..picture.shading import skies_of
from ..query.light_samples import light_samples
from ..query.pixel_refinement import FinerSamples, finer_samples
from ..query.ray_passes import Passes, diffuse_passes
from ..query.shadow_query import CULL_FACES
from ..scene.camera import Camera
from .options import RenderOptions


class Request(NamedTuple):
    """The checked arguments of a frame, and the samples that its options ask for."""

    camera: Camera
    lights: list
    options: RenderOptions  # its time is a moment of the scene
    samples: list[np.ndarray]  # per light (16, n, 3), from `light_samples`
    finer: FinerSamples | None = None  # samples of refined pixels; None: no refinement
    passes: Passes | None = None  # passes of diffuse rays; None: no bounced light
    ground: float | None = None  # height of the ground that catches shadows, world; None: there is none
    progress: Callable | None = None

    @property
    def facing(self) -> int:
        """The value of CULL_FACES."""
        return CULL_FACES[self.options.cull_faces]

    @property
    def smooth(self) -> bool:
        """Whether the visibility of all lights is smoothed."""
        return bool(self.options.filter)

    @property
    def smooth_skies(self) -> bool:
        """Whether the light of skies is smoothed, as that of all lights is if `smooth`."""
        return self.options.filter is not False and bool(skies_of(self.lights))


def request_of(camera: Camera, lights: list, options: RenderOptions, ground: float | None = None) -> Request:
    """The request of a picture, with the samples of its lights.

    lights : checked
    ground : height of the ground, world; None: there is none
    """
    samples = [light_samples(light, options.spp, options.sampler) for light in lights]
    finer = None if options.adaptive is None else finer_samples(lights, options.adaptive, options.sampler)
    passes = None if options.bounce is None else diffuse_passes(lights, options.bounce, options.sampler)
    return Request(camera, lights, options, samples, finer, passes, ground)


def rays_of(request: Request) -> tuple[int, int]:
    """At most so many shadow rays of the picture; and rays of bounced light, with their shadow rays."""
    pixels = request.camera.width * request.camera.height
    bounced = 0 if request.passes is None else len(request.passes.directions) * (1 + len(request.lights))
    return pixels * sum(samples.shape[1] for samples in request.samples), pixels * bounced
