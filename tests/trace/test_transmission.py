"""Light through panes: products of transmittances, and surfaces that count once at common edges and vertices."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import antumbra as at
import oracle
from antumbra.engine.accelerator import Accelerator
from antumbra.engine.plan import covering_plans, parse_plan
from antumbra.query.shadow_query import segments
from antumbra.scene.alpha_masks import AlphaMask, cutouts_of
from antumbra.scene.materials import CLAMP
from antumbra.trace.alpha_cutouts import cutout_tree
from antumbra.trace.transmission import transmission
from asking import answer, query_of
from devices import device_plans
from ray_cases import displaced_meets
from surface_crossings import crossings

# --- Crossings --------------------------------------------------------------------------------------------------------


small = st.integers(-2, 2)
point = st.tuples(small, small, small)


@given(st.lists(point, min_size=3, max_size=3), point, point)
def test_crossings_are_those_of_a_displaced_line(triangle, origin, direction):
    ray = (np.array(vector, np.float32) for vector in (origin, direction))
    if any(direction) and oracle.meets_exactly(*ray, np.array(triangle, float))[0]:
        expected = displaced_meets(origin, direction, triangle)
        assert crossings([triangle], [origin], [direction])[0, 0] == expected


def fan(rng, n=7):
    """A closed body around the origin: two fans over a ring of corners on a grid."""
    angles = 2 * np.pi * (np.arange(n) + rng.uniform(0, 0.5, n)) / n
    ring = np.round(np.column_stack([np.cos(angles), np.sin(angles), np.zeros(n)]) * 4 * 8) / 8
    top, bottom = np.array([0, 0, 2.0]), np.array([0, 0, -3.0])
    after = np.roll(ring, -1, axis=0)
    return np.concatenate([[(a, b, top) for a, b in zip(ring, after)], [(b, a, bottom) for a, b in zip(ring, after)]])


def test_a_line_through_edges_and_vertices_enters_and_leaves_a_body_once():
    rng = np.random.default_rng(3)
    for _ in range(20):
        body = fan(rng)
        corners = np.unique(body.reshape(-1, 3), axis=0)
        targets = np.concatenate([corners, (corners[:, None] + corners[None]).reshape(-1, 3) / 2])
        inside = np.zeros((len(targets), 3), np.float32)
        hits = oracle.all_hits(body.astype(np.float32), inside, (targets * 4).astype(np.float32))
        counts = (hits & crossings(body, inside, targets * 4)).sum(1)
        away = (targets != 0).any(1) & hits.any(1)
        assert (hits.sum(1) > 1).sum() > 5 and (counts[away] == 1).all()


# --- Products ---------------------------------------------------------------------------------------------------------


def panes(colour=None, n=24):
    """Cards in parallel planes above a floor: quads of two triangles, so that rays meet their diagonals."""
    rng, scenes = np.random.default_rng(0), []
    for k in range(n):
        x, z = np.round(rng.uniform(-3, 1, 2))
        y = 0.5 + k / 16
        a, b, c, d = (x, y, z), (x + 2, y, z), (x + 2, y, z + 2), (x, y, z + 2)
        scenes += [(a, b, c), (a, c, d)]
    floor = [[(-6, 0, -6), (-6, 0, 6), (6, 0, 6)], [(-6, 0, -6), (6, 0, 6), (6, 0, -6)]]
    scene = at.Scene.from_arrays(np.array(scenes + floor, np.float64), name="panes")
    shares = rng.choice([0.9, 0.7, 0.5, 0.3], (n, 1)) if colour is None else rng.uniform(0.2, 1.0, (n, 3))
    masks = [AlphaMask(np.zeros((1, 1), np.uint8), np.full((1, 3), share), (CLAMP, CLAMP)) for share in shares]
    mask = np.array([*np.repeat(np.arange(n), 2), -1, -1], np.int32)
    scene.data.cutouts = cutouts_of(np.zeros((2 * n + 2, 3, 2), np.float32), mask, masks)
    return scene, shares, mask


@cache
def lit_case(colour):
    """(triangles, query, lit): lit is (h, w, spp, 3), the product of all panes' transmittances."""
    scene, shares, mask = panes(colour)
    light = at.PointLight((0.0, 8.0, 0.0))
    triangles, query = query_of(scene, at.Camera((0, 12, 0.001), (0, 0, 0), width=24, height=24), light, 1)
    ends, above = segments(query)
    y, x, s = np.nonzero(above)
    origins, ends = query.origins[y, x], ends[y, x, s]
    hits = oracle.all_hits(triangles.vertices, origins, ends)
    crossed = hits & crossings(triangles.vertices, origins, ends.astype(np.float64) - origins)
    lit, assumed = np.zeros((*above.shape, 3)), np.ones((len(y), 3))
    for k in range(len(shares)):
        count = (crossed[:, mask == k] & (query.faces[y, x] != np.flatnonzero(mask == k)[:, None]).T).sum(1)
        assumed *= (np.zeros(3) + shares[k]) ** count[:, None]
    assumed[hits[:, mask < 0].any(1)] = 0
    lit[y, x, s] = np.where(assumed < 1 / 256, 0, assumed)
    assert ((lit > 0) & (lit < 1)).any(-1).sum() > 60
    return triangles, query, lit


@pytest.mark.parametrize("colour", [None, "rgb"])
def test_transmittances_multiply(colour):
    triangles, query, lit = lit_case(colour)
    tree = cutout_tree(triangles)
    assert tree.channels == (1 if colour is None else 3)
    bits = answer_words("bsah+multifrusta", triangles, query)
    light = transmission(tree, query, bits, 2)
    there = light.rows >= 0
    values = np.broadcast_to(light.values[light.rows[there]], lit[there].shape)
    assert np.allclose(values, lit[there], rtol=2e-6, atol=1e-12)
    dark = lit.max(-1) == 0
    assert np.array_equal((bits[..., None] >> np.arange(1, dtype=np.uint64) & 1 != 0)[query.sides != 0][:, 0],
                          dark[query.sides != 0])  # fmt: skip


def answer_words(plan, triangles, query):
    accelerator = Accelerator(parse_plan(plan), 2)
    return accelerator.answer(accelerator.build(triangles), query)


@pytest.mark.parametrize("plan", [*covering_plans(), *device_plans()], ids=str)
def test_every_plan_has_the_same_dark_samples(plan):
    triangles, query, lit = lit_case("rgb")
    asked = np.broadcast_to((query.sides != 0)[..., None], lit.shape[:-1])
    assert np.array_equal(answer(str(plan), triangles, query), asked & (lit.max(-1) == 0))
