"""Alpha masks from the file to the bits: glTF materials, textures and samplers against an oracle of their own.

`test_alpha_test_cutouts.py` gives masks to a scene. Here nothing of the package says which texel a ray meets, or
whether it is solid: the oracle reads the pixels that were written, in rational arithmetic.
"""

import io
from fractions import Fraction
from functools import cache
from math import floor
from typing import NamedTuple

import numpy as np
import pytest
from PIL import Image

import antumbra as at
import oracle
from antumbra.engine.plan import covering_plans
from antumbra.query.shadow_query import segments
from antumbra.trace.alpha_cutouts import cutout_tree
from antumbra.trace.transmission import transmission
from asking import answer, query_of
from gltf_files import Gltf

WRAPS = {"repeat": 10497, "clamp": 33071, "mirror": 33648}
NEAREST, LINEAR = 9728, 9729
N = 96  # cards


class Card(NamedTuple):
    """A triangle with a material, as the oracle knows it."""

    corners: np.ndarray  # (3, 3) float64, multiples of 1/256
    uv: np.ndarray  # (3, 2) float32, under the texture's transform; None: no texture
    alpha: np.ndarray | None  # (h, w) uint8 of the texture
    wrap: tuple[str, str]
    factor: float  # alpha of the material
    vertices: float  # mean alpha of the corners
    least: float | None  # alpha that is solid; None: any
    blends: bool = False  # whether shadow rays lose the share alpha of their light


def encoded(alpha, kind, rng):
    """(bytes of a PNG, alpha that it has)."""
    h, w = alpha.shape
    grey, stream = rng.integers(0, 256, (h, w), np.uint8), io.BytesIO()
    if kind == "RGBA":
        Image.fromarray(np.dstack([grey, grey, grey, alpha])).save(stream, "PNG")
    elif kind == "LA":
        Image.fromarray(np.dstack([grey, alpha]), "LA").save(stream, "PNG")
    elif kind == "P":  # a palette whose entries have an alpha each
        entries = rng.integers(0, 256, 16).astype(np.uint8)
        indices, image = alpha % 16, Image.fromarray((alpha % 16).astype(np.uint8), "P")
        image.putpalette(rng.integers(0, 256, 48).tolist())
        image.save(stream, "PNG", transparency=bytes(entries))
        alpha = entries[indices]
    else:
        Image.fromarray(np.dstack([grey] * 3)).save(stream, "PNG")
        alpha = np.full((h, w), 255, np.uint8)
    return stream.getvalue(), alpha


def grid(values, step):
    """The nearest multiples of a step: sums of few of them are exact in float32."""
    return np.round(np.asarray(values) / step) * step


@cache
def made(seed):
    """(GLB, cards): triangles with masks of all kinds, and a floor."""
    rng, file, cards = np.random.default_rng(seed), Gltf(), []
    primitives = []
    for k in range(N):
        kind, mode = ("RGBA", "LA", "P", "RGB")[k % 4], ("MASK", "BLEND", "MASK", "OPAQUE", "MASK")[k % 5]
        size = rng.integers(1, 9, 2) if k % 3 else (1 << rng.integers(0, 4, 2))
        data, alpha = encoded(rng.integers(0, 256, size).astype(np.uint8), kind, rng)
        wraps = tuple(rng.choice(list(WRAPS), 2).tolist())
        sampler = file.add("samplers", wrapS=WRAPS[wraps[0]], wrapT=WRAPS[wraps[1]], magFilter=(NEAREST, LINEAR)[k % 2])
        image = file.add("images", bufferView=file.view(data), mimeType="image/png")
        shown = {"index": file.add("textures", source=image, sampler=sampler)}
        uv = rng.uniform(-2.5, 2.5, (3, 2)).astype(np.float32)
        used, scale, offset = uv, np.ones(2), np.zeros(2)
        if k % 7 == 0:
            uv = grid(uv, 1 / 1024).astype(np.float32)
            scale, offset = 2.0 ** rng.integers(-2, 2, 2), grid(rng.uniform(-1, 1, 2), 1 / 8)
            used = (uv * scale + offset).astype(np.float32)
            transform = {"scale": scale.tolist(), "offset": offset.tolist()}
            shown["extensions"] = {"KHR_texture_transform": transform}
        factor = float(rng.choice([1.0, 1.0, 0.75, 0.5]))
        material = {"pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1, factor], "baseColorTexture": shown}}
        cutoff = float(rng.choice([0.05, 0.3, 0.5, 0.9, 0.0, 1.5]))
        if mode != "OPAQUE":
            material["alphaMode"] = mode
        if mode == "MASK" and cutoff != 0.5:
            material["alphaCutoff"] = cutoff
        corners = grid(rng.uniform((-4, 0, -4), (4, 4, 4)) + rng.normal(0, 1.2, (3, 3)), 1 / 256)
        attributes, colours = {"TEXCOORD_0": file.accessor(uv)}, np.ones(3)
        if k % 6 == 0:
            colours = rng.choice([0.25, 0.5, 1.0], 3)
            attributes["COLOR_0"] = file.accessor(np.column_stack([np.ones((3, 3)), colours]).astype(np.float32))
        if k % 11 == 0:  # no texture coordinates: the texture is not shown
            del attributes["TEXCOORD_0"]
            used = None
        index = file.add("materials", **material)
        primitives.append(file.primitive(corners.astype(np.float32), attributes=attributes, material=index))
        least = {"MASK": cutoff, "BLEND": 0.5, "OPAQUE": None}[mode]
        cards.append(Card(corners, used, alpha, wraps, factor, float(colours.mean()), least, mode == "BLEND"))
    floor_ = np.array([[-8, -1, -8], [-8, -1, 8], [8, -1, 8], [-8, -1, -8], [8, -1, 8], [8, -1, -8]], np.float64)
    primitives.append(file.primitive(floor_.astype(np.float32)))
    cards += [Card(part, None, None, ("", ""), 1.0, 1.0, None) for part in (floor_[:3], floor_[3:])]
    for part in np.array_split(np.arange(len(primitives)), 3):
        file.node(mesh=file.mesh(*(primitives[i] for i in part)))
    return file.glb(), cards


@cache
def scene_of(seed):
    """The scene of the file, whose corners are exactly those of the cards."""
    import tempfile
    from pathlib import Path

    data, cards = made(seed)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "cards.glb"
        path.write_bytes(data)
        scene = at.load(path, up="y")
        _ = scene.cutouts
    corners = scene.triangles().vertices.astype(np.float64) + scene.origin
    assert np.array_equal(corners, [card.corners for card in cards])
    return scene, cards


def rational(v):
    return [Fraction(float(x)) for x in v]


def place_of(card, origin, along):
    """(u, v) where a line meets the plane of a card: barycentric coordinates in the projection along an axis."""
    corners, o, d = [rational(c) for c in card.corners], rational(origin), rational(along)
    e, f = ([b - a for a, b in zip(corners[0], corners[k])] for k in (1, 2))
    normal = [e[(k + 1) % 3] * f[(k + 2) % 3] - e[(k + 2) % 3] * f[(k + 1) % 3] for k in range(3)]
    t = sum(n * (a - b) for n, a, b in zip(normal, corners[0], o)) / sum(n * x for n, x in zip(normal, d))
    p = [a + t * b - c for a, b, c in zip(o, d, corners[0])]
    k = max(range(3), key=lambda axis: abs(normal[axis]))
    i, j = (k + 1) % 3, (k + 2) % 3
    b, c = (p[i] * f[j] - p[j] * f[i]) / normal[k], (e[i] * p[j] - e[j] * p[i]) / normal[k]
    assert b >= 0 and c >= 0 and b + c <= 1
    uv = [rational(corner) for corner in card.uv]
    return [(1 - b - c) * uv[0][axis] + b * uv[1][axis] + c * uv[2][axis] for axis in (0, 1)]


def texel_at(place, size, wrap):
    if wrap == "clamp":
        return max(0, min(size - 1, floor(place * size)))
    if wrap == "mirror":
        place = abs(place) % 2
        place, edge = (2 - place, True) if place >= 1 else (place, False)
        at_ = place * size
        return (at_.numerator // at_.denominator - (at_.denominator == 1)) if edge else floor(at_)
    return floor((place % 1) * size)


def alpha_at(card, origin, along):
    """The alpha where a line meets a card."""
    byte = 255
    if card.uv is not None:
        u, v = place_of(card, origin, along)
        h, w = card.alpha.shape
        byte = int(card.alpha[texel_at(v, h, card.wrap[1]), texel_at(u, w, card.wrap[0])])
    return byte / 255 * card.factor * card.vertices


def is_solid(card, origin, along):
    """Whether a line that meets a card is stopped there."""
    if card.least is None:
        return True
    missing = card.least - alpha_at(card, origin, along)
    assert not 1e-9 < missing < 1e-5  # equal, up to the rounding of a decimal cutoff: solid
    return missing < 1e-9


def passing(card, origin, along):
    """The share of the light along a line that passes a card."""
    return 1.0 - (alpha_at(card, origin, along) if card.blends else is_solid(card, origin, along))


def met(cards, origins, ends, property=is_solid):
    """All pairs (segment, card) that meet, and a property of the card there."""
    vertices = np.array([card.corners for card in cards], np.float32)
    for i, row in enumerate(oracle.all_hits(vertices, origins, ends)):
        for k in np.flatnonzero(row):
            along = [a - b for a, b in zip(rational(ends[i]), rational(origins[i]))]
            yield i, int(k), property(cards[k], origins[i], along)


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow), pytest.param(2, marks=pytest.mark.slow)])
def test_rays(seed):
    """`occluded` and `closest_hit` of a list of rays."""
    scene, cards = scene_of(seed)
    rng = np.random.default_rng(seed)
    origins = grid(rng.uniform((-5, -0.5, -5), (5, 5, 5), (500, 3)), 1 / 256).astype(np.float32)
    directions = grid(rng.normal(size=(500, 3)), 1 / 64).astype(np.float32)
    hits, through = [[] for _ in origins], 0
    for i, k, solid in met(cards, origins, origins + directions * np.float32(64)):
        t = oracle.meets_exactly(origins[i], directions[i], cards[k].corners)[1]
        through += not solid
        if solid:
            hits[i].append((t, k))
    nearest = [min(each, default=(np.inf, -1)) for each in hits]
    face = np.array([k for _, k in nearest])
    found = scene.closest_hit(origins, directions)
    assert np.array_equal(found.face, face)
    assert np.array_equal(scene.occluded(origins, directions), face >= 0)
    assert through > 100 and 0.2 < (face >= 0).mean() < 0.95 and len(set(face.tolist())) > N // 3


@cache
def shadows():
    """(scene, triangles, query, lit) of an area light above the cards; lit: the share of light that arrives."""
    scene, cards = scene_of(0)
    light = at.QuadLight((-2, 7, -2), (4, 1, 0), (0, 0, 4))
    triangles, query = query_of(scene, at.Camera((0, 3, 14), (0, 0.5, 0), width=22, height=16), light, 8)
    ends, above = segments(query)
    lit = np.where(above, 1.0, 0.0)
    moved = [card._replace(corners=card.corners - scene.origin) for card in cards]
    y, x, s = np.nonzero(above)
    for i, _, share in met(moved, query.origins[y, x], ends[y, x, s], passing):
        lit[y[i], x[i], s[i]] *= share
    assert not (abs(lit * 256 - 1) < 1e-6).any()
    lit[lit < 1 / 256] = 0
    assert 0.05 < (lit[above] == 0).mean() < 0.95 and ((lit > 0) & (lit < 1)).sum() > 25
    return scene, triangles, query, lit


@pytest.mark.parametrize("plan", list(covering_plans()), ids=str)
def test_shadows_by_every_plan(plan):
    _, triangles, query, lit = shadows()
    asked = np.broadcast_to((query.sides != 0)[..., None], lit.shape)
    assert np.array_equal(answer(str(plan), triangles, query), asked & (lit == 0))


def test_the_light_that_passes():
    """Sums of rounded logarithms agree with sorted float64 products, and a pane of grey has one channel."""
    _, triangles, query, lit = shadows()
    tree = cutout_tree(triangles)
    bits = np.packbits(lit == 0, axis=-1, bitorder="little")[..., :1].astype(np.uint64)
    light = transmission(tree, query, bits, 2)
    assert light.values.shape[1:] == (8, 1)
    there = light.rows >= 0
    assert np.allclose(light.values[light.rows[there]][..., 0], lit[there], rtol=2e-6, atol=0)
    assert ((lit[~there] == 0) | (lit[~there] == 1)).all() and there.sum() > 8


@pytest.mark.parametrize("gbuffer", ["raster", "rays"])
def test_pictures(gbuffer):
    """The first surface behind each pixel."""
    scene, cards = scene_of(0)
    camera = at.Camera((0.0, 3.0, 14.0), (0.0, 1.0, 0.0), width=40, height=30)
    light = at.PointLight((0.5, 7.0, 0.25))
    face = at.Renderer(scene, "bsah+single", gbuffer=gbuffer).render(camera, [light], spp=1).gbuffer.face
    rays = camera.rays(scene.origin)
    y, x = (each.ravel() for each in np.mgrid[:30, :40])
    along = (rays.corner + (x[:, None] + 0.5) * rays.dx + (y[:, None] + 0.5) * rays.dy).astype(np.float32)
    origins = np.broadcast_to(rays.origin.astype(np.float32), along.shape)
    moved, hits = [card._replace(corners=card.corners - scene.origin) for card in cards], [[] for _ in along]
    vertices = np.array([card.corners for card in moved], np.float32)
    for k, (corners, card) in enumerate(zip(vertices, moved)):
        for i in np.flatnonzero(oracle.all_hits(corners[None], origins, origins + along * np.float32(64))[:, 0]):
            exact, t = oracle.meets_exactly(origins[i], along[i], corners)
            if exact and is_solid(card, origins[i], along[i]):
                hits[i].append((t, k))
    truth = [min(each, default=(np.inf, -1))[1] for each in hits]
    assert np.array_equal(face.ravel(), truth)
    assert len(set(truth)) > N // 4


def test_texels_of_the_oracle():
    """The oracle's own wrap modes, which are written in another way than the package's."""
    third, names = Fraction(1, 3), "0123"
    read = lambda wrap, *places: "".join(names[texel_at(Fraction(p), 4, wrap)] for p in places)
    assert read("repeat", 0, third, 1, -third, Fraction(-1, 10**9), Fraction(7, 4)) == "010233"
    assert read("clamp", -5, third, 1, 9) == "0133"
    quarter = Fraction(1, 4)
    assert read("mirror", 0, quarter, 1 - quarter, 1, 1 + quarter / 2, 1 + 2 * quarter, 2 - quarter / 2) == "0133310"
    assert read("mirror", -quarter / 2, -quarter - quarter / 2, -1 - quarter / 2) == "013"
