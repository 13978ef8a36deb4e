"""Shading normals: those of the corners of triangles, interpolated. Shadows stay on the geometric surface."""

import numpy as np

from ..kernels.jit import inlined, kernel
from ..kernels.parallel import new_ticket, run, shares, thread_count
from ..kernels.predicate.filters import dot
from ..kernels.simd import get, ptr, put
from ..query.shadow_query import ShadingNormals, three_at
from ..scene.appearance import Appearance
from .corners import Places, frame_of, weights


@inlined
def _evaluated(frame, kept):
    """The normal that `scene.appearance.in_frames` keeps as `kept`, of any length, in the triangle as it is now.

    In its plane it is the vector x e1 + y e2 with the two kept products; this is a system of two equations.
    """
    e1, e2, g, g2 = frame
    a, b, c = dot(e1, e1), dot(e1, e2), dot(e2, e2)
    x, y = (c * kept[0] - b * kept[1]) / g2, (a * kept[1] - b * kept[0]) / g2
    z = kept[2] / (np.sqrt(g2) * np.sqrt(np.sqrt(g2)))  # g is |g| long, and kept[2] is |g|^(1/2) times the product
    return x * e1[0] + y * e2[0] + z * g[0], x * e1[1] + y * e2[1] + z * g[1], x * e1[2] + y * e2[2] + z * g[2]


@kernel
def _normal_rows(ticket, places, kept, bends, out):
    w = places.ids.shape[1]
    ids, faces, corners, normals = ptr(places.ids), ptr(places.face), ptr(places.corners), ptr(kept)
    positions, geometric, shown = ptr(places.position), ptr(places.normal), ptr(out.normal)
    sines, ends = ptr(bends), ptr(out.bend)
    for y0, last in shares(ticket):
        for at in range(y0 * w, last * w):
            n, k, bend = three_at(geometric, at), np.int64(get(ids, at)), 0.0
            if k >= 0:
                i = np.int64(get(faces, at))
                frame = frame_of(corners, i)
                b0, b1, b2 = weights(frame, corners, i, three_at(positions, at))
                p, q, r = three_at(normals, 3 * k), three_at(normals, 3 * k + 1), three_at(normals, 3 * k + 2)
                m = _evaluated(
                    frame,
                    (
                        b0 * p[0] + b1 * q[0] + b2 * r[0],
                        b0 * p[1] + b1 * q[1] + b2 * r[1],
                        b0 * p[2] + b1 * q[2] + b2 * r[2],
                    ),
                )
                length = np.sqrt(dot(m, m))
                if length > 0.0 and length < np.inf:
                    scale = (1.0 if dot(m, n) >= 0.0 else -1.0) / length  # towards the seen side
                    n = m[0] * scale, m[1] * scale, m[2] * scale
                    bend = b0 * get(sines, 3 * k) + b1 * get(sines, 3 * k + 1) + b2 * get(sines, 3 * k + 2)
                    bend /= max(length, 0.5)  # the mean of unit vectors is shorter: docs/design/shading.md
            put(ends, at, np.float32(bend))
            put(shown, 3 * at, np.float32(n[0]))
            put(shown, 3 * at + 1, np.float32(n[1]))
            put(shown, 3 * at + 2, np.float32(n[2]))


def shading_normals(places: Places, appearance: Appearance, threads=None) -> ShadingNormals:
    """The interpolated normals of a scene that has some; geometric ones where a face has none."""
    out = ShadingNormals(np.empty(places.normal.shape, np.float32), np.empty(places.ids.shape, np.float32))
    ticket = new_ticket(len(places.ids), 8)
    run(_normal_rows, thread_count(threads), ticket, places, appearance.normals, appearance.bends, out)
    return out
