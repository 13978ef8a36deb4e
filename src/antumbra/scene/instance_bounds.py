"""The exact bounds of instances: those of the float64 world vertices that flattening computes."""

import numpy as np
from numpy.typing import NDArray

from ..kernels.jit import kernel
from ..kernels.parallel import items, new_ticket, run
from ..kernels.simd import f64_at, get, put, stack_f64
from .instances import InstanceSet

# mypy: disable-error-code="call-arg, var-annotated"
# (mypy counts the typing context among the arguments of intrinsics)

_LANES = 8


def columns_of(positions: np.ndarray) -> NDArray[np.float64]:
    """(3, v) float64: the coordinates of vertices, (v, 3). v is rounded up to a multiple of 8: the last one repeats."""
    n = len(positions)
    rows = np.minimum(np.arange(-(-n // _LANES) * _LANES), n - 1)
    return np.ascontiguousarray(positions[rows].T, np.float64)


@kernel
def _bounds(ticket, meshes, mesh, matrices, out):
    """Worker: write the bounds of copies. LLVM vectorises the innermost loop."""
    # In: meshes, (m, 2) int64, address of the columns and number of vertices; mesh, (k,) int32
    # In: matrices, (k, 3, 4) float64. Out: out, (k, 2, 3) float64
    low, high, far = stack_f64(_LANES), stack_f64(_LANES), np.float64(np.inf)
    for i in items(ticket):
        p, n = f64_at(meshes[mesh[i], 0]), meshes[mesh[i], 1]
        for axis in range(3):
            a, b, c, d = matrices[i, axis, 0], matrices[i, axis, 1], matrices[i, axis, 2], matrices[i, axis, 3]
            for lane in range(_LANES):
                put(low, lane, far)
                put(high, lane, -far)
            for first in range(0, n, _LANES):
                for lane in range(_LANES):
                    at = first + lane
                    w = a * get(p, at) + b * get(p, n + at) + c * get(p, 2 * n + at) + d
                    put(low, lane, w if w < get(low, lane) else get(low, lane))
                    put(high, lane, w if w > get(high, lane) else get(high, lane))
            lower, upper = get(low, 0), get(high, 0)
            for lane in range(1, _LANES):
                lower = get(low, lane) if get(low, lane) < lower else lower
                upper = get(high, lane) if get(high, lane) > upper else upper
            out[i, 0, axis], out[i, 1, axis] = lower, upper


def instance_bounds(instances: InstanceSet, threads: int) -> NDArray[np.float64]:
    """(k, 2, 3) float64, world: lower and upper corner of each copy; inf and -inf for a mesh without vertices."""
    columns = [columns_of(mesh.positions) if len(mesh.positions) else np.empty((3, 0)) for mesh in instances.meshes]
    meshes = np.array([(each.ctypes.data, each.shape[1]) for each in columns], np.int64).reshape(-1, 2)
    out = np.empty((len(instances.mesh), 2, 3))
    run(_bounds, threads, new_ticket(len(out), 16), meshes, instances.mesh, instances.matrices, out)
    return out
