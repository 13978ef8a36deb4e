"""Tree lists on devices: the bits of the whole scene, however its triangles are shared out over trees and calls."""

import numpy as np
import pytest

import antumbra as at
from antumbra.bvh import binned_sah
from antumbra.query.shadow_query import new_bits
from antumbra.trace.device.device_stages import CAPACITIES, Capacities
from antumbra.trace.device.part_trees import part_tree
from antumbra.trace.device.tree_list_kernels import TREE_WORDS
from antumbra.trace.device.tree_list_tracer import TiledTracer, TileLayout, TreeLists, set_bits
from antumbra.trace.rays.single_rays import as_built, trace_shadow
from asking import query_of, unpack
from devices import DEVICES, opened
from truths import LIGHTS, soup_scene

TREES = 5
SCENE = soup_scene(3)
CAMERA = at.Camera((0, 2, 9), (0, -0.5, 0), width=37, height=29)
SIZES = {"large lists": CAPACITIES, "tiny lists": Capacities(24, 8, 4), "no lists": Capacities(16, 16, 1 << 20)}


@pytest.fixture(scope="module", params=DEVICES)
def device(request):
    return opened(request.param)


@pytest.fixture(scope="module")
def trees(device):
    """(trees of shares of the scene's triangles, which lie next to each other or everywhere; their table)."""
    vertices, rng = SCENE.triangles().vertices, np.random.default_rng(7)
    share = np.where(rng.random(len(vertices)) < 0.5, rng.integers(0, TREES, len(vertices)), vertices[:, 0, 0] > 0)
    found = []
    for k in range(TREES):
        ids = np.flatnonzero(share == k).astype(np.int32)
        bvh = binned_sah.build(vertices[ids], 1)
        found.append(part_tree(bvh._replace(prim_ids=ids[bvh.prim_ids]), device))
    return found, np.stack([each.row for each in found])


def lists_of(rng, table, tiles, sets, trees):
    """(lists with these trees in any order, in all lists; other tiles have none)."""
    items = [rng.permutation(trees) for _ in range(tiles * sets)]
    starts = np.concatenate([[0], np.cumsum([len(each) for each in items])]).astype(np.int32)
    return TreeLists(table, starts, np.concatenate([np.empty(0), *items]).astype(np.int32), sets)


def expected_of(query):
    bits = new_bits(query)
    trace_shadow(as_built(binned_sah.build(SCENE.triangles().vertices, 1)), query, bits, 1)
    return bits


@pytest.mark.parametrize("sizes", SIZES)
@pytest.mark.parametrize("light", ["quad", "ambient", "list", "light in the floor's plane"])
@pytest.mark.parametrize("rows", [True, False], ids=["picture", "points"])
def test_bits_are_those_of_one_tree(device, trees, sizes, light, rows):
    _, query = query_of(SCENE, CAMERA, LIGHTS[light], 16)
    if not rows:
        query = query._replace(**{n: getattr(query, n).reshape(1, -1, *getattr(query, n).shape[2:]) for n in
                                  ("origins", "faces", "sides", "ids")})  # fmt: skip
    rng, tracer, bits, (h, w) = (
        np.random.default_rng(1),
        TiledTracer(device, SIZES[sizes]),
        new_bits(query),
        query.sides.shape,
    )
    pixels = 16 if rows else 200
    layout = TileLayout(pixels, -(-w // pixels), 0, query.samples.shape[1])
    tiles = np.arange(layout.across * -(-h // pixels), dtype=np.int32)
    tiled, sets = tracer.query(query, layout, 2), 16 if light == "ambient" else 1
    for turn in [], [0, 1], [2], [4, 3]:  # the first call has no trees, but what receivers' surfaces block
        lists = lists_of(rng, trees[1], len(tiles), sets, turn)
        before = bits.copy()
        words, blockers = tracer.trace_tiles(tiled, tiles, lists, 2)
        set_bits(bits, layout, tiles, words)
        assert (bits & before == before).all() and len(blockers) == len(lists.items)
        assert sizes != "large lists" or blockers.any() or not turn or (bits == before).all()
    np.testing.assert_array_equal(bits, expected_of(query))
    found = unpack(bits, query.samples.shape[1])[query.sides != 0]
    assert 0.02 < found.mean() < 0.98
    assert tracer.on_cpu > 0 or sizes != "large lists" or light != "light in the floor's plane"


def test_some_samples_of_some_tiles_are_traced(device, trees):
    """A stratum in the middle of a word, and tiles that are listed later."""
    _, query = query_of(SCENE, CAMERA, at.AmbientOcclusion(spp=40), 40)
    tracer, bits, expected = TiledTracer(device), new_bits(query), expected_of(query)
    layout = TileLayout(16, 3, 16, 16)
    tiled, tiles = tracer.query(query, layout, 1), np.arange(6, dtype=np.int32)
    for some in tiles, tiles[[1, 4]]:
        starts = np.cumsum([0, *np.where(np.repeat(np.isin(tiles, [1, 4]) == (len(some) == 2), 16), TREES, 0)])
        items = np.tile(np.arange(TREES), starts[-1] // TREES)
        words, blockers = tracer.trace_tiles(
            tiled, some, TreeLists(trees[1], starts.astype("i4"), items.astype("i4"), 16), 1
        )
        assert blockers.any() and words.shape == (len(some), 16, 16, 1)
        set_bits(bits, layout, some, words)
    chosen = np.uint64(0xFFFF) << np.uint64(16)
    np.testing.assert_array_equal(bits, expected & chosen)
    assert bits.any() and (expected & ~chosen).any()


def test_queries_of_the_same_receivers_share_what_is_on_the_device(device):
    _, query = query_of(SCENE, CAMERA, LIGHTS["quad"], 4)
    tracer, layout = TiledTracer(device), TileLayout(64, 1, 0, 4)
    tracer.query(query, layout, 1)  # reserves memory for answers, which stays
    before = device.used
    first = tracer.query(query, layout, 1)
    taken = device.used - before
    second = tracer.query(query._replace(light=query.light), layout, 1)
    assert device.used - before - taken < 16 * query.sides.size < taken
    other = tracer.query(query._replace(origins=query.origins.copy()), layout, 1)
    assert device.used - before > 2 * taken
    del first, second, other
    assert device.used == before


def test_a_row_of_the_table_names_a_tree(trees):
    assert trees[1].shape == (TREES, TREE_WORDS) and len(np.unique(trees[1][:, 0])) == TREES
