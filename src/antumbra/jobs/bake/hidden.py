"""Points of surfaces inside solids, which nobody sees, though interpolation would spread their darkness.

A receiver is inside if the rays of its hemisphere meet back faces first. So the direction of the faces decides what is
solid.
"""

import numpy as np

from ...engine.scene import Scene
from ...query.light_samples import light_samples
from ...scene.lights import AmbientOcclusion
from .measure import SurfacePoints

_RAYS, _ENOUGH = 16, 15  # one ray may leak through a gap
_BATCH = 1 << 16
_LIFT = 2.0**-20  # of the largest coordinate, off the surface


class Solids:
    """The solids of a scene at a time."""

    def __init__(self, scene: Scene, time: float, threads: int | None):
        triangles = scene.triangles(time, threads)
        a, b, c = (triangles.vertices[:, k].astype(np.float64) for k in range(3))
        self._scene, self._time, self._threads = scene, time, threads
        self._outward = np.cross(b - a, c - a)
        self._samples = light_samples(AmbientOcclusion(), _RAYS, "larcher-pillichshammer")[0]

    def hold(self, receivers: SurfacePoints) -> np.ndarray:
        """(n,) bool: which receivers are inside a solid."""
        inside = np.zeros(len(receivers.positions), bool)
        for start in range(0, len(inside), _BATCH):
            part = slice(start, start + _BATCH)
            inside[part] = self._hold(receivers.at(part))
        return inside

    def _hold(self, receivers: SurfacePoints) -> np.ndarray:
        local = receivers.positions - self._scene.origin
        far = np.abs(local).max(-1, keepdims=True)
        origins = receivers.positions + _LIFT * far * receivers.normals
        u, v = _tangents(receivers.normals)
        a, b, c = (self._samples[:, k, None] for k in range(3))
        directions = a * u[:, None] + b * v[:, None] + c * receivers.normals[:, None]
        face = self._scene.closest_hit(origins[:, None], directions, time=self._time, threads=self._threads).face
        from_behind = (self._outward[face] * directions).sum(-1) > 0.0
        return ((face >= 0) & from_behind).sum(1) >= _ENOUGH


def _tangents(n: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors at right angles to each of the unit vectors n ((k, 3)) [Duff et al. 2017]."""
    s = np.copysign(1.0, n[:, 2])
    a = -1.0 / (s + n[:, 2])
    b = n[:, 0] * n[:, 1] * a
    u = np.stack([1.0 + s * n[:, 0] ** 2 * a, s * b, -s * n[:, 0]], 1)
    return u, np.stack([b, s + n[:, 1] ** 2 * a, -n[:, 1]], 1)
