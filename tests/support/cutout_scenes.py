"""Scenes with cut-outs, and the truth about them by brute force and rational arithmetic."""

from fractions import Fraction
from math import floor

import numpy as np

import oracle
from antumbra import Scene
from antumbra.query.shadow_query import segments
from antumbra.scene.alpha_masks import AlphaMask, Cutouts, cutouts_of
from antumbra.scene.materials import CLAMP, MIRROR, REPEAT


def holes(solid, wrap) -> AlphaMask:
    """The mask of a texture with holes: (h, w) bool, True: solid."""
    return AlphaMask(solid.astype(np.uint8), np.array([[1.0] * 3, [0.0] * 3]), wrap)


MASKS = [
    holes(np.indices((5, 7)).sum(0) % 2 == 0, (REPEAT, REPEAT)),
    holes(np.random.default_rng(0).random((9, 4)) < 0.5, (CLAMP, MIRROR)),
    holes(np.random.default_rng(1).random((16, 16)) < 0.3, (MIRROR, REPEAT)),
    holes(np.ones((2, 2), bool), (REPEAT, REPEAT)),
    holes(np.zeros((3, 1), bool), (REPEAT, CLAMP)),
]


def scene_with_cutouts(n=60, seed=0) -> Scene:
    """Large triangles above a floor: a third solid, the others with masks of all kinds."""
    rng = np.random.default_rng(seed)
    soup = rng.uniform((-3, 0, -3), (3, 2.5, 3), (n, 1, 3)) + rng.normal(0, 0.7, (n, 3, 3))
    soup[: n // 4] = np.round(soup[: n // 4] * 2) / 2  # shared edges and corners
    ground = np.array([[[-9, -1, -9], [-9, -1, 9], [9, -1, 9]], [[-9, -1, -9], [9, -1, 9], [9, -1, -9]]])
    scene = Scene.from_arrays(np.concatenate([soup, ground]), name="cut")
    uv = rng.uniform(-1.5, 2.5, (n + 2, 3, 2)).astype(np.float32)
    mask = np.where(np.arange(n + 2) < n, rng.integers(-3, len(MASKS), n + 2), -1).clip(-1).astype(np.int32)
    scene.data.cutouts = cutouts_of(uv, mask, MASKS)
    assert scene.cutouts is not None and len(scene.cutouts.faces) > n // 5
    return scene


def _texel(place: Fraction, size: int, wrap: int) -> int:
    x = floor(place * size)
    if wrap == CLAMP:
        return min(max(x, 0), size - 1)
    if wrap == MIRROR:
        return min(x % (2 * size), 2 * size - 1 - x % (2 * size))
    return x % size


def is_hole(cutouts: Cutouts, face: int, triangle, origin, direction) -> bool:
    """Whether the texel is clear where the line through `origin` along `direction`, rationals, meets the face."""
    k = int(np.searchsorted(cutouts.faces, face))
    a, b, c = (oracle.minus(oracle.rational(v), origin) for v in triangle)
    edges = [oracle.dot(direction, oracle.cross(p, q)) for p, q in ((b, c), (c, a), (a, b))]
    uv = [[Fraction(float(x)) for x in corner] for corner in cutouts.uv[k]]
    place = [sum(w * corner[axis] for w, corner in zip(edges, uv)) / sum(edges) for axis in range(2)]
    mask = MASKS[cutouts.mask[k]]
    rows, columns = mask.texels.shape
    texel = mask.texels[_texel(place[1], rows, mask.wrap[1]), _texel(place[0], columns, mask.wrap[0])]
    return bool(mask.transmittance[texel].mean() > 0.5)


def meets(triangles, origin, direction, face: int) -> bool:
    """Whether a ray that meets the triangle of a face is stopped there."""
    own = triangles.cutouts
    if face in own.solid:
        return True
    if face not in own.faces:
        return False
    exact = oracle.rational(origin), direction
    return not is_hole(own, face, triangles.vertices[face], *exact)


def true_shadows(triangles, query) -> tuple[np.ndarray, np.ndarray]:
    """(truth, active) as from `asking.true_occlusion`, with cut-outs."""
    ends, above = segments(query)
    active = np.broadcast_to((query.sides != 0)[..., None], above.shape)
    truth = active & ~above
    y, x, s = np.nonzero(above)
    origins, ends = query.origins[y, x], ends[y, x, s]
    hits = oracle.all_hits(triangles.vertices, origins, ends)
    for i, row in enumerate(hits):
        along = oracle.minus(oracle.rational(ends[i]), oracle.rational(origins[i]))
        truth[y[i], x[i], s[i]] = any(meets(triangles, origins[i], along, int(f)) for f in np.flatnonzero(row))
    return truth, active
