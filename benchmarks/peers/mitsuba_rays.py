"""Traces ray sets with Mitsuba 3, whose LLVM variant traces packets with its own Embree."""

import time
from functools import cache

import numpy as np

from antumbra.base.errors import InputError
from antumbra.kernels.parallel import thread_count
from peers.ray_contest import PeerRays, ray_array

VARIANT = "llvm_ad_rgb"


@cache
def library():
    """The mitsuba and drjit modules, with the LLVM variant.

    Raises
    ------
    InputError
        If Mitsuba is not installed or finds no LLVM. Its scalar variants trace only one ray per Python call.
    """
    try:
        import drjit
        import mitsuba
    except ImportError as error:
        raise InputError(f"Mitsuba cannot be imported ({error}): pip install 'antumbra[all-peers]'") from None
    mitsuba.set_variant(VARIANT)
    try:
        drjit.eval(mitsuba.Float([1.0]) + 1.0)
    except Exception as error:
        raise InputError(f"Mitsuba finds no LLVM ({error}): install libLLVM, or set DRJIT_LIBLLVM_PATH") from None
    return mitsuba, drjit


def version() -> str:
    """The versions of Mitsuba and LLVM, such as "Mitsuba 3.9.1 llvm_ad_rgb, LLVM 15.0.6"."""
    mitsuba, drjit = library()
    return f"Mitsuba {mitsuba.__version__} {VARIANT}, LLVM {'.'.join(map(str, drjit.detail.llvm_version()))}"


class MitsubaScene:
    """A Mitsuba scene of triangles ((n, 3, 3) float32). `build_seconds` is the wall time of its build.

    robust : whether to set Embree's robust flag
    """

    def __init__(self, vertices, robust: bool = False):
        mitsuba, drjit = library()
        start = time.perf_counter()
        mesh = mitsuba.Mesh("triangles", 3 * len(vertices), len(vertices))
        parameters = mitsuba.traverse(mesh)
        parameters["vertex_positions"] = np.ascontiguousarray(vertices, np.float32).ravel()
        parameters["faces"] = np.arange(3 * len(vertices), dtype=np.uint32)
        parameters.update()
        self._scene = mitsuba.load_dict({"type": "scene", "triangles": mesh, "embree_use_robust_intersections": robust})
        drjit.sync_thread()
        self.build_seconds = time.perf_counter() - start
        one = PeerRays((1, 1, 1), np.zeros((1, 3), "f4"), 1, np.ones((1, 3), "f4"), 1.0, np.ones(1, bool))
        for coherent in (False, True):  # compile before timing
            self.trace(self.write(one, np.zeros(1, np.int32)), coherent)

    def write(self, rays: PeerRays, ids: np.ndarray):
        """The rays with these ids, (n,), as a Mitsuba ray. 16 consecutive rays are a packet (8 without AVX-512)."""
        mitsuba, drjit = library()
        columns = [mitsuba.Float(np.ascontiguousarray(column)) for column in ray_array(rays, ids).T]
        ray = mitsuba.Ray3f(mitsuba.Point3f(*columns[:3]), mitsuba.Vector3f(*columns[3:]), rays.tmax, 0.0, [])
        drjit.eval(ray)
        drjit.sync_thread()
        return ray

    def trace(self, ray, coherent: bool = False, threads=None):
        """Trace a result of `write`; return a Mitsuba array of bool. This is the timed call."""
        _, drjit = library()
        blocked = self._scene.ray_test(ray, coherent=coherent)
        drjit.eval(blocked)
        drjit.sync_thread()
        return blocked


def set_threads(threads) -> None:
    """Set the number of threads of Mitsuba's kernels."""
    library()[1].set_thread_count(thread_count(threads))


def occluded_of(rays: PeerRays, ids: np.ndarray, blocked) -> np.ndarray:
    """(rays,) bool by ray id: the answers of `MitsubaScene.trace`; False for rays that were not traced."""
    out = np.zeros(len(rays.directions), bool)
    out[ids] = np.array(blocked)
    return out
