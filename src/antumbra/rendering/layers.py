"""The parts of a frame's image: base colours, each light alone, and objects. Compositors put them together again."""

import numpy as np

from ..picture.shading import shade
from ..query.gbuffer import PictureSurfaces
from ..query.shadow_query import Surfaces
from .frame import Layers
from .state import FrameState, TracedLights, arriving_at, coloured


def layers_of(
    state: FrameState, surfaces: Surfaces, seen: PictureSurfaces, traced: TracedLights, shares, indirect
) -> Layers:
    """The `Layers` of a frame: its surfaces are shaded once more for each light."""
    request, ids = state.request, surfaces.ids
    gbuffer, colour = coloured(surfaces)
    arrived, dark = arriving_at(state, surfaces, traced, seen if request.smooth else None), np.zeros(3, np.float32)
    up = state.tracer.scene.up

    def shaded(lights, arrived, shares, indirect=None) -> np.ndarray:
        return shade(gbuffer, colour, lights, arrived, shares, dark, up, indirect, state.threads)

    alone = [shaded([light], [a], [s]) for light, a, s in zip(request.lights, arrived, shares)]
    bounced = None if indirect is None else shaded([], [], [], indirect)
    met = ids >= 0
    albedo = np.where(met[..., None], colour[np.where(met, gbuffer.face, 0)], np.float32(0.0))
    things = state.tracer.scene.object_of_face[np.where(met, ids, 0)]
    state.clock.lap("shade")
    return Layers(albedo, alone, bounced, np.where(met, things, np.int32(-1)))
