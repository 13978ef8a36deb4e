"""Selection of the first triangles of a two-pass traversal [Olsson and Assarsson 2011, Sec. 3.4].

The report does not define a good occluder. Several rules were measured (docs/design/rayhierarchy.md). The deciding
quantity is the share of the light's directions that a triangle hides.
"""

import numpy as np

from ..kernels.jit import kernel
from ..kernels.parallel import items, new_ticket, run
from ..kernels.simd import get, ptr, put
from .beams import PERSPECTIVE, Beam
from .soup import Soup

AREA, SOLID_ANGLE, NEAREST = 0, 1, 2
"""Rules: largest area; largest solid angle as seen from the light; smallest distance to the light."""

SHARE = 1.0 / 64.0
"""Share of the triangles that go first."""

FINISHED = 1.0 / 16.0
"""Share of the rays that must be finished for the hierarchy to be rebuilt."""


@kernel
def _write_scores(ticket, soup, beam, rule, scores):
    """Worker: score each triangle as an occluder by a rule."""
    c, apex, w, seen = ptr(soup.corners), beam.apex, beam.axes[2], beam.kind == PERSPECTIVE
    for i in items(ticket):
        k = 9 * i
        px, py, pz = get(c, k + 3) - get(c, k), get(c, k + 4) - get(c, k + 1), get(c, k + 5) - get(c, k + 2)
        qx, qy, qz = get(c, k + 6) - get(c, k), get(c, k + 7) - get(c, k + 1), get(c, k + 8) - get(c, k + 2)
        nx, ny, nz = np.float64(py * qz - pz * qy), np.float64(pz * qx - px * qz), np.float64(px * qy - py * qx)
        x, y, z = w[0], w[1], w[2]
        if seen:
            x, y, z = get(c, k) - apex[0], get(c, k + 1) - apex[1], get(c, k + 2) - apex[2]
        squared = x * x + y * y + z * z
        score = nx * nx + ny * ny + nz * nz
        if rule == SOLID_ANGLE:
            score = abs(nx * x + ny * y + nz * z) / max(squared * np.sqrt(squared), 1e-30)
        elif rule == NEAREST:
            score = -squared if seen else x * get(c, k) + y * get(c, k + 1) + z * get(c, k + 2)
        put(ptr(scores), i, score)


def occluders_first(soup: Soup, beam: Beam, threads: int, rule: int = SOLID_ANGLE) -> tuple[np.ndarray, np.ndarray]:
    """(good occluders, all others): int32 indices into the soup."""
    n = len(soup.corners)
    scores, k = np.empty(n), int(n * SHARE)
    run(_write_scores, threads, new_ticket(n, 4096), soup, beam, rule, scores)
    order = np.argpartition(-scores, k).astype(np.int32) if k else np.arange(n, dtype=np.int32)
    return np.sort(order[:k]), np.sort(order[k:])
