"""Ray sets through Open3D, which calls an Embree of its own one ray at a time."""

import time
from functools import cache

import numpy as np

from antumbra.errors import InputError
from antumbra.kernels.parallel import thread_count
from peers.ray_sets import RaySet, gathered


@cache
def library():
    """The open3d module.

    Raises
    ------
    InputError
        When Open3D, or a library that it needs, is not installed.
    """
    try:
        import open3d
    except (ImportError, OSError) as error:
        raise InputError(f"Open3D cannot be imported ({error}): pip install 'antumbra[all-peers]'") from None
    return open3d


class Open3DScene:
    """Triangles ((n, 3, 3) float32) that Open3D has built; `build_seconds` is the wall time of that."""

    def __init__(self, vertices, threads=None):
        o3d = library()
        vertices = np.ascontiguousarray(vertices, np.float32).reshape(-1, 3)
        faces = np.arange(len(vertices), dtype=np.uint32).reshape(-1, 3)
        start = time.perf_counter()
        self._scene = o3d.t.geometry.RaycastingScene(nthreads=thread_count(threads))
        self._scene.add_triangles(o3d.core.Tensor(vertices), o3d.core.Tensor(faces))
        self._scene.test_occlusions(o3d.core.Tensor(np.ones((1, 6), np.float32)))  # builds when it is first asked
        self.build_seconds = time.perf_counter() - start

    def write(self, rays: RaySet, ids: np.ndarray):
        """The rays with these ids (n,) as Open3D's tensor."""
        return library().core.Tensor(gathered(rays, ids))

    def trace(self, tensor, tmax: float, threads=None):
        """Trace what `write` made; what is timed. A tensor of bool."""
        return self._scene.test_occlusions(tensor, 0.0, tmax, thread_count(threads))


def occluded_of(rays: RaySet, ids: np.ndarray, blocked) -> np.ndarray:
    """(rays,) bool by ray id: what `Open3DScene.trace` answered; False for a ray that was not asked."""
    out = np.zeros(len(rays.directions), bool)
    out[ids] = blocked.numpy()
    return out
