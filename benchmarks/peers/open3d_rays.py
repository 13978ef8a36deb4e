"""Traces ray sets with Open3D, which calls its own Embree one ray at a time."""

import time
from functools import cache

import numpy as np

from antumbra.base.errors import InputError
from antumbra.kernels.parallel import thread_count
from peers.ray_contest import PeerRays, ray_array


@cache
def library():
    """The open3d module.

    Raises
    ------
    InputError
        If Open3D, or a library that it needs, is not installed.
    """
    try:
        import open3d
    except (ImportError, OSError) as error:
        raise InputError(f"Open3D cannot be imported ({error}): pip install 'antumbra[all-peers]'") from None
    return open3d


class Open3DScene:
    """An Open3D scene of triangles ((n, 3, 3) float32). `build_seconds` is the wall time of its build."""

    def __init__(self, vertices, threads=None):
        o3d = library()
        vertices = np.ascontiguousarray(vertices, np.float32).reshape(-1, 3)
        faces = np.arange(len(vertices), dtype=np.uint32).reshape(-1, 3)
        start = time.perf_counter()
        self._scene = o3d.t.geometry.RaycastingScene(nthreads=thread_count(threads))
        self._scene.add_triangles(o3d.core.Tensor(vertices), o3d.core.Tensor(faces))
        self._scene.test_occlusions(o3d.core.Tensor(np.ones((1, 6), np.float32)))  # the first query builds
        self.build_seconds = time.perf_counter() - start

    def write(self, rays: PeerRays, ids: np.ndarray):
        """The rays with these ids, (n,), as an Open3D tensor."""
        return library().core.Tensor(ray_array(rays, ids))

    def trace(self, tensor, tmax: float, threads=None):
        """Trace a result of `write`; return a tensor of bool. This is the timed call."""
        return self._scene.test_occlusions(tensor, 0.0, tmax, thread_count(threads))


def occluded_of(rays: PeerRays, ids: np.ndarray, blocked) -> np.ndarray:
    """(rays,) bool by ray id: the answers of `Open3DScene.trace`; False for rays that were not traced."""
    out = np.zeros(len(rays.directions), bool)
    out[ids] = blocked.numpy()
    return out
