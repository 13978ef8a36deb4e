"""Points inside solids, which are dark but never visible.

A receiver is inside a solid if almost all rays of its hemisphere hit a back face first, and almost all rays to the
sides, from halfway to the surface above, leave a solid. The latter tell a solid from a sheet above a floor: little
light enters below the sheet, but cameras see what is there.

Back faces of double-sided materials are visible, so they enclose nothing, unless their mesh is closed: many exporters
declare all materials double-sided.
"""

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..city.sensors.surface_groups import tangents_of
from ..engine.scene import Scene
from ..kernels.elementary import cos, sin
from ..query.light_samples import light_samples
from ..scene.lights import AmbientOcclusion
from .surface_meter import ReceiverPoints

_RAYS, _ENOUGH = 16, 15  # one ray may leak through a gap
_CROSSINGS = 8  # surfaces along a ray: solids contain parts of others
_BATCH = 1 << 14
_LIFT = 2.0**-20  # offset from the surface, in units of the largest coordinate


class Solids:
    """The solids of a scene at a time.

    double_sided : (n,) bool
        The faces of the scene whose back is visible.
    """

    def __init__(self, scene: Scene, double_sided: NDArray[np.bool_], time: float, threads: int | None):
        self._corners = scene.triangles(time, threads).vertices
        a, b, c = (self._corners[:, k].astype(np.float64) for k in range(3))
        self._scene, self._double_sided, self._time, self._threads = scene, double_sided, time, threads
        self._outward = np.cross(b - a, c - a)
        self._hemisphere = light_samples(AmbientOcclusion(), _RAYS, "larcher-pillichshammer")[0]
        self._highest = int(self._hemisphere[:, 2].argmax())
        angles = 2.0 * np.pi * (np.arange(_RAYS) + 0.5) / _RAYS
        self._sideways = np.stack([cos(angles), sin(angles), np.zeros(_RAYS)], 1)

    @cached_property
    def _encloses(self) -> NDArray[np.bool_]:
        """(n,) bool: faces whose backs are the inside of a solid."""
        encloses = ~self._double_sided
        encloses[self._double_sided] = is_closed(self._corners[self._double_sided])
        return encloses

    def contain(self, receivers: ReceiverPoints) -> NDArray[np.bool_]:
        """(n,) bool: which receivers are inside a solid."""
        inside = np.zeros(len(receivers.positions), bool)
        for start in range(0, len(inside), _BATCH):
            part = slice(start, start + _BATCH)
            inside[part] = self._contain(receivers.at(part))
        return inside

    def _contain(self, receivers: ReceiverPoints) -> NDArray[np.bool_]:
        far = np.abs(receivers.positions - self._scene.origin).max(-1)
        origins, directions = _rays(receivers, _LIFT * far, self._hemisphere)
        first = self._scene.closest_hit(origins, directions, time=self._time, threads=self._threads)
        exits = self._exits(first.face, directions) * (first.face >= 0)
        inside: NDArray[np.bool_] = (exits > 0).sum(1) >= _ENOUGH
        candidates, above = np.flatnonzero(inside), first.t[inside, self._highest]
        if len(candidates):
            halfway = _LIFT * far[candidates] + np.where(np.isfinite(above), 0.5 * above, 0.0)
            rays = _rays(receivers.at(candidates), halfway, self._sideways)
            inside[candidates] = self._leaves_a_solid(*rays).sum(1) >= _ENOUGH
        return inside

    def _leaves_a_solid(self, origins: np.ndarray, directions: np.ndarray) -> NDArray[np.bool_]:
        """(n, 16) bool: whether each ray leaves more solids than it has entered, at any of its hits."""
        hits = self._scene.all_hits(origins, directions, time=self._time, max_hits=_CROSSINGS, threads=self._threads)
        ray = np.repeat(np.arange(directions.size // 3), np.diff(hits.ray_offsets))
        exits = self._exits(hits.face, directions.reshape(-1, 3)[ray])
        before = np.append(0, np.cumsum(exits))
        surplus = before[1:] - before[hits.ray_offsets[:-1]][ray]
        return np.asarray(np.bincount(ray, surplus > 0, directions.size // 3).reshape(directions.shape[:2]) > 0)

    def _exits(self, face: NDArray[np.integer], directions: NDArray[np.float64]) -> NDArray[np.int64]:
        """(...) int64: 1 where a ray that hits a face leaves a solid, -1 where it enters one; 0 at visible backs."""
        along = (self._outward[face] * directions).sum(-1)
        leaves = along > 0.0
        if self._double_sided.any():
            leaves &= self._encloses[face]
        return np.asarray(leaves.astype(np.int64) - (along < 0.0))


def _rays(
    receivers: ReceiverPoints, lift: NDArray[np.float64], samples: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """((n, 1, 3) origins, (n, 16, 3) directions) of rays from receivers.

    lift : (n,) distances of the origins from the surfaces
    samples : (16, 3) directions around +z, which becomes the normal
    """
    u, v = tangents_of(receivers.normals)
    a, b, c = (samples[:, k, None] for k in range(3))
    directions = a * u[:, None] + b * v[:, None] + c * receivers.normals[:, None]
    return (receivers.positions + lift[:, None] * receivers.normals)[:, None], directions


def is_closed(corners: NDArray[np.float32]) -> NDArray[np.bool_]:
    """(n,) bool: whether each triangle, (n, 3, 3), belongs to a closed surface.

    Along each edge of a closed surface, as many triangles run one way as the other. Triangles are connected at vertices
    with the same coordinates.
    """
    _, vertex = np.unique(corners.reshape(-1, 3) + np.float32(0.0), axis=0, return_inverse=True)
    faces = vertex.reshape(-1, 3)
    count = int(faces.max(initial=-1)) + 1
    start, end = faces.reshape(-1), faces[:, [1, 2, 0]].reshape(-1)
    edge, of = np.unique(np.minimum(start, end) * count + np.maximum(start, end), return_inverse=True)
    open_edge = np.bincount(of.reshape(-1), np.sign(end - start), len(edge)) != 0.0
    surface = _connected(start, end, count)
    is_open = np.zeros(count, bool)
    is_open[surface[edge[open_edge] // max(count, 1)]] = True
    return np.asarray(~is_open[surface[faces[:, 0]]])


def _connected(a: NDArray[np.int64], b: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """(count,) int64: the smallest vertex that edges from `a` to `b` connect with each vertex."""
    label = np.arange(count)
    while True:
        lower, least = label.copy(), np.minimum(label[a], label[b])
        for ends in (label[a], label[b]):
            np.minimum.at(lower, ends, least)
        lower = lower[lower]
        if (lower == label).all():
            return label
        label = lower
