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


# --- Scenes of all kinds of faces that let light pass -----------------------------------------------------------------


def with_masks(n, masks, seed=1):
    """A scene of cards, each of which has a mask, above a floor."""
    rng = np.random.default_rng(seed)
    cards = rng.uniform((-3, 0, -3), (3, 2.5, 3), (n, 1, 3)) + rng.normal(0, 0.7, (n, 3, 3))
    floor = np.array([[[-9, -1, -9], [-9, -1, 9], [9, -1, 9]], [[-9, -1, -9], [9, -1, 9], [9, -1, -9]]])
    scene = Scene.from_arrays(np.concatenate([cards, floor]), name="cards")
    uv = rng.uniform(-1.5, 2.5, (n + 2, 3, 2)).astype(np.float32)
    mask = np.append(rng.integers(0, len(masks), n), [-1, -1]).astype(np.int32)
    scene.data.cutouts = cutouts_of(uv, mask, masks)
    return scene


def pane(share, **fields):
    return AlphaMask(np.zeros((1, 1), np.uint8), np.broadcast_to(np.float64(share), (1, 3)), (CLAMP, CLAMP), **fields)


def seasonal(rng):
    months = np.repeat(rng.uniform(0.2, 1.0, (12, 1, 1)), 3, 2)
    return pane(months.mean(0), months=months)


def without_floor():
    """All faces let light pass, so that chunks have none."""
    scene = with_masks(40, MASKS)
    mask = np.full(scene.n_triangles, 0, np.int32)
    scene.data.cutouts = cutouts_of(np.tile(np.float32([[0, 0], [3, 0], [0, 3]]), (len(mask), 1, 1)), mask, MASKS[:1])
    assert not len(scene.cutouts.solid)
    return scene


def hidden():
    """Some faces are not there: the first, cut-outs and solid ones."""
    scene = scene_with_cutouts(90)
    gone = np.random.default_rng(3).random(scene.n_triangles) < 0.3
    gone[0], gone[-2:] = True, False
    return Scene.of_data(scene.data.hiding(gone))


OPEN_SCENES = {
    "holes": lambda: scene_with_cutouts(90),
    "panes": lambda: with_masks(80, [pane(0.9), pane(0.6), pane(0.3)]),
    "coloured glass": lambda: with_masks(80, [pane((0.9, 0.5, 0.7)), pane(0.8)]),
    "crowns": lambda: with_masks(80, [pane(0.7, closed=True), *MASKS[:2]]),
    "seasons": lambda: with_masks(80, [seasonal(np.random.default_rng(2)), MASKS[0], pane(0.6)]),
    "without solid faces": without_floor,
    "hidden faces": hidden,
}


def rays(n=1500, seed=5):
    rng = np.random.default_rng(seed)
    return rng.uniform((-3, -0.5, -3), (3, 3, 3), (n, 3)), rng.normal(size=(n, 3)) * 10.0 ** rng.uniform(-2, 2, (n, 1))


def same(found, right):
    for a, b in zip(found, right, strict=True):
        np.testing.assert_array_equal(a, b)
