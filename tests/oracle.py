"""The brute-force oracle: every ray against every triangle, in plain numpy. It imports nothing of the package.

Decisions are those of real arithmetic on the float32 input. Float64 Pluecker products decide the cases that exceed
their error bound. They are matrix products, so thousands of triangles times 100 000 rays take seconds. Exact rational
arithmetic decides the rest. Formulas differ from the package's on purpose.
"""

from fractions import Fraction
from functools import cache

import numpy as np

_CHUNK = 200_000  # ray-triangle pairs in memory at a time: few enough for the processor's cache


def cross(a, b):
    """The cross product."""
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def dot(a, b):
    """The scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def minus(a, b):
    """The difference of two vectors."""
    return tuple(x - y for x, y in zip(a, b))


def rational(v):
    """The exact numbers of a float vector: a tuple of Fractions."""
    return tuple(Fraction(float(x)) for x in v)


def _integers(*vectors):
    """(vectors, power): the vectors times a power of two that makes all of them integers, and this power."""
    ratios = [[(x if isinstance(x, Fraction) else float(x)).as_integer_ratio() for x in v] for v in vectors]
    scale = max(low for v in ratios for _, low in v)
    return [tuple(high * (scale // low) for high, low in v) for v in ratios], scale


def meets_exactly(origin, direction, triangle, tmin=0.0, tmax=np.inf):
    """(side, t) of one ray and one triangle, by rational arithmetic; side 0 if they do not meet.

    direction : three floats, or three Fractions (the exact difference of two points)
    tmin, tmax : bound t rounded to the nearest float64; where the direction is of Fractions, t itself

    All numbers are integers over powers of two. So the arithmetic uses integers, which are faster.
    """
    (o, *corners), scale = _integers(origin, *triangle)
    (d,), pace = _integers(direction)
    v = [minus(p, o) for p in corners]
    e = [dot(d, cross(v[(k + 1) % 3], v[(k + 2) % 3])) for k in range(3)]
    total = sum(e)
    if total == 0 or (min(e) < 0 < max(e)):
        return 0, None
    t = Fraction(dot(v[0], cross(v[1], v[2])) * pace, total * scale)
    compared = t if isinstance(direction[0], Fraction) else float(t)
    if not float(tmin) < compared < float(tmax):
        return 0, None
    return (1 if total > 0 else -1), t


def plane_side(point, triangle):
    """The exact sign of (point - v0) . n."""
    p, (a, b, c) = rational(point), [rational(v) for v in triangle]
    s = dot(minus(p, a), cross(minus(b, a), minus(c, a)))
    return (s > 0) - (s < 0)


def _pairs(vertices, origins, directions):
    """Yield (ray, triangle, sure) of the pairs whose line may meet the triangle, by float64 with a generous bound.

    No ray meets a triangle without area. So triangles with two equal corners are left out.
    """
    v = vertices.astype(np.float64)
    solid = np.nonzero((v != v[:, [1, 2, 0]]).any(2).all(1))[0]
    v = v[solid]
    o, d = origins.astype(np.float64), directions.astype(np.float64)
    centre = v.reshape(-1, 3).mean(0) if len(v) else np.zeros(3)
    v, o = v - centre, o - centre
    a, b = v[:, [1, 2, 0]], v[:, [2, 0, 1]]
    edges = np.concatenate([np.cross(a, b), b - a], -1)  # d . (a x b) + (o x d) . (b - a)
    scale = np.abs(v).max((1, 2)) if len(v) else np.zeros(0)
    rays = np.concatenate([d, np.cross(o, d)], 1)
    reach = np.abs(o).max(1) if len(o) else np.zeros(0)
    length = np.abs(d).max(1) if len(o) else np.zeros(0)
    # The error of a sum of 6 products, with cancellation by the shift to `centre`: far below 1e-13 of the magnitudes.
    bound = lambda ray, scale: 1e-13 * length[ray] * (scale + reach[ray]) ** 2
    widest = bound(slice(None), scale.max(initial=0.0))[:, None]
    step = max(1, _CHUNK // max(1, len(v)))
    held = np.empty((5, min(step, len(o)), len(v)))  # reused: new memory would cost more than the sums
    for first in range(0, len(o), step):
        wide = widest[first : first + step]
        *e, low, high = held[:, : len(wide)]
        for k in range(3):
            np.matmul(rays[first : first + step], edges[:, k].T, out=e[k])
        np.minimum(np.minimum(e[0], e[1], out=low), e[2], out=low)
        np.maximum(np.maximum(e[0], e[1], out=high), e[2], out=high)
        ray, tri = np.divmod(np.flatnonzero((low >= -wide) | (high <= wide)), max(1, len(v)))
        low, high, limit = low[ray, tri], high[ray, tri], bound(ray + first, scale[tri])
        kept = (low >= -limit) | (high <= limit)
        yield (ray + first)[kept], solid[tri[kept]], ((low > limit) | (high < -limit))[kept]


def _interval(vertices, origins, directions, ray, tri, tmin, tmax):
    """For pairs whose line certainly meets: +1 certainly inside (tmin, tmax), -1 certainly outside, 0 uncertain."""
    v = vertices[tri].astype(np.float64)
    o, d = origins[ray].astype(np.float64), directions[ray].astype(np.float64)
    n = np.cross(v[:, 1] - v[:, 0], v[:, 2] - v[:, 0])
    num, den = ((v[:, 0] - o) * n).sum(1), (d * n).sum(1)
    lo, hi = tmin[ray], np.where(np.isfinite(tmax[ray]), tmax[ray], 0.0)
    size = np.abs(n).sum(1)
    far_point = np.abs(v[:, 0] - o).max(1)
    bound = 1e-13 * size * (far_point + (np.abs(lo) + np.abs(hi)) * np.abs(d).max(1))
    # n is a rounded cross product: its error is relative to the edges, not to its own length
    edge = np.abs(v - v[:, :1]).max((1, 2))
    bound += 1e-14 * edge * edge * (far_point + (np.abs(lo) + np.abs(hi)) * np.abs(d).max(1))
    sign = np.sign(den)
    after = (num - lo * den) * sign
    before = np.where(np.isfinite(tmax[ray]), (hi * den - num) * sign, np.inf)
    worst = np.minimum(after, before)
    verdict = np.where(worst > bound, 1, np.where(worst < -bound, -1, 0))
    return np.where(np.abs(den) > bound, verdict, 0)


def _prepare(origins, directions, ends, tmin, tmax):
    origins = np.asarray(origins, np.float32).reshape(-1, 3)
    if ends is not None:
        ends = np.asarray(ends, np.float32).reshape(-1, 3)
        directions = ends.astype(np.float64) - origins.astype(np.float64)
        tmin, tmax = 0.0, 1.0
    directions = np.asarray(directions).reshape(-1, 3)
    full = lambda x: np.broadcast_to(np.asarray(x, np.float64), len(origins))
    return origins, directions, ends, full(tmin), full(tmax)


def _verdicts(vertices, origins, directions, tmin, tmax, skip):
    """Yield (ray, triangle, verdict) of pairs that may meet: 1 if they certainly do, else 0."""
    for ray, tri, sure in _pairs(vertices, origins, directions):
        if skip is not None:
            kept = skip[ray] != tri
            ray, tri, sure = ray[kept], tri[kept], sure[kept]
        inside = _interval(vertices, origins, directions, ray, tri, tmin, tmax)
        kept = ~sure | (inside >= 0)
        yield ray[kept], tri[kept], np.where(sure & (inside > 0), 1, 0)[kept]


def _decided(vertices, origins, directions, ends, tmin, tmax, ray, tri):
    """(n,) bool: whether each pair meets, by rational arithmetic, one at a time."""
    exact_direction = cache(lambda i: minus(rational(ends[i]), rational(origins[i])))
    return np.array(
        [
            meets_exactly(
                origins[i], directions[i] if ends is None else exact_direction(i), vertices[j], tmin[i], tmax[i]
            )[0]
            != 0
            for i, j in zip(ray.tolist(), tri.tolist())
        ],
        bool,
    )


def _hits(vertices, origins, directions, ends, tmin, tmax, skip):
    """Yield (ray, triangle) arrays of all pairs that meet."""
    for ray, tri, verdict in _verdicts(vertices, origins, directions, tmin, tmax, skip):
        meets, unsure = verdict > 0, verdict == 0
        meets[unsure] = _decided(vertices, origins, directions, ends, tmin, tmax, ray[unsure], tri[unsure])
        yield ray[meets], tri[meets]


def occluded(vertices, origins, directions=None, ends=None, tmin=0.0, tmax=np.inf, skip=None):
    """(m,) bool: whether any triangle (n, 3, 3) meets each ray strictly inside its interval.

    With `ends`, the rays are the segments to `ends`.
    """
    o, d, ends, tmin, tmax = _prepare(origins, directions, ends, tmin, tmax)
    out = np.zeros(len(o), bool)
    for ray, tri, verdict in _verdicts(vertices, o, d, tmin, tmax, skip):
        out[ray[verdict > 0]] = True
        unsure = (verdict == 0) & ~out[ray]  # rays that certainly meet a triangle need no other decisions
        ray, tri = ray[unsure], tri[unsure]
        out[ray[_decided(vertices, o, d, ends, tmin, tmax, ray, tri)]] = True
    return out


def all_hits(vertices, origins, ends, skip=None):
    """(m, n) bool: whether each segment meets each triangle."""
    o, d, ends, tmin, tmax = _prepare(origins, None, ends, 0.0, 1.0)
    out = np.zeros((len(o), len(vertices)), bool)
    for ray, tri in _hits(vertices, o, d, ends, tmin, tmax, skip):
        out[ray, tri] = True
    return out


def closest_hit(vertices, origins, directions, tmin=0.0, tmax=np.inf, skip=None):
    """(t, face) for each ray: the smallest exact t as float64, inf and -1 on a miss.

    Of triangles at this t, those whose normal points against the ray come first, then the lowest face.
    """
    o, d, _, tmin, tmax = _prepare(origins, directions, None, tmin, tmax)
    best_t, best, best_side = np.full(len(o), np.inf), np.full(len(o), -1), np.zeros(len(o), int)
    for ray, tri in _hits(vertices, o, d, None, tmin, tmax, skip):
        for i, j in zip(ray, tri):
            v = vertices[j].astype(np.float64)
            n = np.cross(v[1] - v[0], v[2] - v[0])
            t = ((v[0] - o[i].astype(np.float64)) * n).sum() / (d[i].astype(np.float64) * n).sum()
            if t <= best_t[i] * (1 + 1e-9) or best[i] < 0:
                side, exact = meets_exactly(o[i], d[i], vertices[j], tmin[i], tmax[i])
                if best[i] < 0 or (float(exact), side, j) < (best_t[i], best_side[i], best[i]):
                    best_t[i], best_side[i], best[i] = float(exact), side, j
    return best_t, best
