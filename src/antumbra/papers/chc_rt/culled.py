"""Traces the first two frames of a place's near walk, for the pictures of `pictures`, and keeps the fronts.

Parts and tiles have the paper's sizes in proportion: a screen is ten tiles wide, and a scene has at least 64 parts.
"""

from typing import NamedTuple

import numpy as np

from ...bvh.blocks import BlockTree
from ...errors import InputError
from ...query.ray_passes import RayPass
from ...query.shadow_query import Surfaces
from ...techniques.chcrt.chc_rt import ChcRtState, camera_hits
from ...techniques.chcrt.picture_ray_sets import PassRaySet
from ...techniques.chcrt.ray_bundles import pass_rays
from ...techniques.chcrt.tree_parts import TreeParts, parts_of
from ...techniques.chcrt.visibility_fronts import Fronts
from ...techniques.tracer_options import ChcRtOptions
from ...trace.tree_list import Hits
from .measure import InCore, bled
from .rays import DIFFUSE, SAMPLER, Culling, FrameRays, timed
from .variants import tracer_name

ERROR = 20
"""The threshold of Fig. 9."""
SHORT = 1 / 100
"""The length of the short rays of Fig. 4, as a share of the long ones'."""

_FRAMES = 2
_WALK = 60  # frames of the walk, whose first ones are drawn
_TILES = 1920 / 200  # tiles in a row of the paper's screen
_PARTS = 64  # at least
_MANY, _MUCH = 2_000_000, 1 / 6  # triangles of an opaque tile of Fig. 4; at most this share of the scene's


class Seen(NamedTuple):
    """A question of the last frame: the hits of its rays, and the state that it left."""

    hits: Hits
    fronts: Fronts


class Culled(NamedTuple):
    """The data behind the pictures of a place."""

    name: str
    parts: TreeParts
    surfaces: Surfaces
    length: float  # of the long rays, in world units
    camera: Seen
    short: Seen  # one pass of diffuse rays that end early
    long: Seen  # the same pass, across the whole scene
    exact: np.ndarray  # (h, w, 3) uint8: diffuse colour bleeding
    neglecting: np.ndarray  # (h, w, 3) uint8: the same with a threshold of ERROR rays

    @property
    def shape(self) -> tuple[int, int]:
        return self.surfaces.ids.shape

    @property
    def triangles(self) -> int:
        return len(self.surfaces.triangles.vertices)

    @property
    def many(self) -> int:
        """The number of triangles that makes a tile of Fig. 4 opaque."""
        return max(1, min(_MANY, int(self.triangles * _MUCH)))


def options_of(triangles: int, width: int) -> ChcRtOptions:
    """The options of the pictures: see this module."""
    tile = 32 * max(1, round(width / _TILES / 32))
    return ChcRtOptions(tile=tile, triangles=min(1 << 20, max(1, triangles // _PARTS)))


def culled(core: InCore) -> Culled:
    """Trace the two frames.

    InputError if the camera sees nothing.
    """
    tree, walk = core.culling().scheduled.parts.keeps, core.place.walks[0]
    assert isinstance(tree, BlockTree)
    options = options_of(len(core.triangles.vertices), walk.first.width)
    parts = parts_of(tree, options)
    low, high = parts.boxes[0].astype(np.float64)
    length = float(np.linalg.norm(high - low))
    camera, short, long = (ChcRtState(parts, options) for _ in range(3))
    methods = [
        Culling(tracer_name(n), ChcRtState(parts, options._replace(threshold=n)), core.threads) for n in (0, ERROR)
    ]
    for frame in range(_FRAMES):
        asked = core.asked(walk.camera(frame, _WALK), SAMPLER)
        if not (asked.surfaces.ids >= 0).any():
            raise InputError(f"{core.place.name}: the {walk.name} camera sees nothing; choose another scene")
        rays = next(q for q in asked.questions(DIFFUSE) if isinstance(q, RayPass))
        seen = _looked(camera, asked, core.threads)
        bounced = [
            _bounced(s, rays, asked.shape, n, core.threads) for s, n in ((short, SHORT * length), (long, length))
        ]
        pictures = [_bled(method, asked) for method in methods]
    return Culled(core.place.name, parts, asked.surfaces, length, seen, *bounced, *pictures)


def _looked(scheduled: ChcRtState, asked: FrameRays, threads: int) -> Seen:
    """A frame of the camera's rays."""
    scheduled.begin()
    hits = camera_hits(scheduled, asked.camera, threads)
    return Seen(hits, _state(scheduled))


def _bounced(scheduled: ChcRtState, rays: RayPass, shape: tuple[int, int], length: float, threads: int) -> Seen:
    """A frame of diffuse rays of this length."""
    scheduled.begin()
    low, high = scheduled.parts.boxes[0].astype(np.float64)
    made = pass_rays(rays, *shape, 2.0 * float(np.linalg.norm(high - low)))
    made = made._replace(spans=np.array([[0.0, length]]))
    scheduled.run(PassRaySet(scheduled.parts, scheduled.options, made, threads), shape)
    return Seen(made.hits, _state(scheduled))


def _state(scheduled: ChcRtState) -> Fronts:
    """The state of the frame's only question."""
    ((_, fronts),) = scheduled.states()
    return fronts


def _bled(method: Culling, asked: FrameRays) -> np.ndarray:
    """A frame of diffuse rays as a picture of colour bleeding."""
    method.scheduled.begin()
    colour = asked.surfaces.triangles.colour
    return bled(asked.surfaces, [(colour, met) for met, _ in timed(method, asked, DIFFUSE)[1]])
