"""Traces rays with NVIDIA Warp on the CPU: its own BVH, and one `mesh_query_ray` per ray."""

from functools import cache

import numpy as np

from antumbra.base.errors import InputError


@cache
def library():
    """The warp module.

    Raises
    ------
    InputError
        If it is not installed.
    """
    try:
        import warp
    except ImportError as error:
        raise InputError(f"Warp cannot be imported ({error}): pip install warp-lang") from None
    warp.config.quiet = True
    warp.init()
    return warp


@cache
def _kernel():
    wp = library()

    @wp.kernel
    def ask(
        mesh: wp.uint64,
        origins: wp.array(dtype=wp.vec3),
        directions: wp.array(dtype=wp.vec3),
        blocked: wp.array(dtype=wp.int32),
    ):
        i = wp.tid()
        hit = wp.mesh_query_ray(mesh, origins[i], directions[i], 1.0e30)
        if hit.result:
            blocked[i] = 1

    return ask


def occluded(vertices: np.ndarray, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """(n,) bool: whether rays ((n, 3) float32 each) hit triangles ((m, 3, 3) float32)."""
    wp = library()
    points = wp.array(vertices.reshape(-1, 3), dtype=wp.vec3, device="cpu")
    mesh = wp.Mesh(points, wp.array(np.arange(3 * len(vertices), dtype=np.int32), dtype=wp.int32, device="cpu"))
    blocked = wp.zeros(len(origins), dtype=wp.int32, device="cpu")
    rays = (wp.array(np.ascontiguousarray(part), dtype=wp.vec3, device="cpu") for part in (origins, directions))
    wp.launch(_kernel(), dim=len(origins), inputs=[mesh.id, *rays, blocked], device="cpu")
    return blocked.numpy().astype(bool)
