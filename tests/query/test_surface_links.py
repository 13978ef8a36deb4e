"""Links between pixels, against the definition pixel by pixel."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from antumbra.query.receivers import NOTHING
from antumbra.query.surface_links import (
    APART,
    BELOW,
    COSINE,
    N_LINKS,
    RIGHT,
    PictureSurfaces,
    SurfaceLinks,
)
from strength import examples

OFFSETS = [(y, x) for y in range(3) for x in range(-2, 3) if (y, x) > (0, 0)]


def surfaces(h, w, seed, faces=6):
    """Random surfaces of which about half of the neighbours are one, in patches of a few pixels."""
    rng = np.random.default_rng(seed)
    patch = np.repeat(np.repeat(rng.integers(0, faces, (-(-h // 3), -(-w // 5))), 3, 0), 5, 1)[:h, :w]
    side = np.where(rng.random((h, w)) < 0.1, NOTHING, rng.choice([-1, 1], (h, w))).astype(np.int8)
    face = np.where(rng.random((h, w)) < 0.3, rng.integers(0, 100, (h, w)), patch).astype(np.int32)
    y, x = np.mgrid[:h, :w]
    position = np.stack([x, y, 0.3 * rng.random((h, w)) * (patch % 3)], -1).astype(np.float32)
    normal = np.stack([0.25 * (patch % 3), 0.2 * rng.random((h, w)), np.ones((h, w))], -1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    depth = rng.uniform(0.2, 2.0, (h, w)).astype(np.float32)
    return PictureSurfaces(position, normal.astype(np.float32), face, depth, side, np.float32(0.4))


def is_linked(seen, at, other):
    """Eq. (2) of docs/design/filter.md for two pixels, in float32."""
    h, w = seen.face.shape
    if not (0 <= other[0] < h and 0 <= other[1] < w) or NOTHING in (seen.side[at], seen.side[other]):
        return False
    if seen.face[at] == seen.face[other]:
        return True
    n, m, d = seen.normal[at], seen.normal[other], seen.position[other] - seen.position[at]
    dot = lambda a, b: a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    limit = APART * seen.pixel * min(seen.depth[at], seen.depth[other])
    return bool(dot(n, m) >= COSINE and abs(dot(n, d)) <= limit and abs(dot(m, d)) <= limit)


def bits_of(links: SurfaceLinks):
    """(h, w, 12) bool: the links of the pixels."""
    inner = links.bits[links.pad : len(links.bits) - links.pad].reshape(links.h, links.w)
    assert not links.bits[: links.pad].any() and not links.bits[len(links.bits) - links.pad :].any()
    return (inner[..., None] >> np.arange(N_LINKS) & 1).astype(bool)


def expected(seen):
    h, w = seen.face.shape
    return np.array(
        [[[is_linked(seen, (y, x), (y + v, x + u)) for v, u in OFFSETS] for x in range(w)] for y in range(h)]
    ).reshape(h, w, N_LINKS)


@examples(25)
@given(st.integers(1, 20), st.integers(1, 40), st.integers(0, 1000))
def test_links_are_those_of_the_definition(h, w, seed):
    seen = surfaces(h, w, seed)
    np.testing.assert_array_equal(bits_of(seen.links(2)), expected(seen))


def test_some_neighbours_are_linked_and_some_are_not():
    links = bits_of(surfaces(30, 50, 1).links())
    assert 0.2 < links.mean() < 0.9
    assert (links.mean((0, 1)) > 0.1).all()


@pytest.mark.parametrize("seed", range(3))
def test_blocks_of_one_face_are_linked_as_others(seed):
    """A picture of few faces, in whole blocks of eight columns."""
    seen = surfaces(24, 64, seed, faces=1)
    seen.face[:] = seed
    seen.face[5:7, 40:43] = 9
    np.testing.assert_array_equal(bits_of(seen.links()), expected(seen))


def test_adjacent_links_are_links_and_threads_do_not_matter():
    one, three = surfaces(33, 47, 5), surfaces(33, 47, 5)
    adjacent = bits_of(one.adjacent_links(1))
    every = bits_of(three.links(3))
    np.testing.assert_array_equal(adjacent[..., [RIGHT, BELOW]], every[..., [RIGHT, BELOW]])
    np.testing.assert_array_equal(bits_of(one.links(1)), every)
    assert three.adjacent_links() is three.links()


def test_a_subset_of_surfaces_has_the_links_within_it():
    seen = surfaces(20, 30, 2)
    side = seen.side.copy()
    side[:, ::3] = NOTHING
    links = bits_of(seen.with_side(side).links())
    assert not links[:, ::3].any() and not links[:, 2::3, OFFSETS.index((0, 1))].any()
    assert links.any() and (links <= bits_of(seen.links())).all()
