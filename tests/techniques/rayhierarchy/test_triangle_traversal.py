"""Traversal: bounded memory, covered nodes, good occluders first. The bits are always the same."""

import numpy as np
import pytest

import antumbra as at
from antumbra.kernels.jit import kernel
from antumbra.kernels.parallel import new_ticket
from antumbra.kernels.simd import ptr, ptr_at, stack_array, stack_f32
from antumbra.lab.papers.ray_hierarchy.cone_hierarchy import TABLE_1, Cones
from antumbra.techniques.culling.pre_bvh_culling import Soup, soup_of
from antumbra.techniques.rayhierarchy import ray_hierarchy, triangle_traversal
from antumbra.techniques.rayhierarchy.box_nodes import Boxes
from antumbra.techniques.rayhierarchy.light_beams import beams_of, view_of
from antumbra.techniques.rayhierarchy.ray_leaves import leaves_of
from antumbra.techniques.rayhierarchy.ray_tree import tree_pointers
from antumbra.techniques.rayhierarchy.shadow_planes import BLOCK, LANES, NUMBERS
from antumbra.techniques.rayhierarchy.triangle_traversal import (
    AREA,
    BATCH,
    NEAREST,
    PAIRS,
    QUEUES,
    SOLID_ANGLE,
    Queues,
    TraversalOptions,
    memory_for,
    occluders_first,
    queue_block,
    queues_blocks,
    trace_triangles,
    traverse_queues,
    write_rows,
)
from antumbra.techniques.tracer_options import FASTEST_RAY_HIERARCHY, RayHierarchyOptions
from antumbra.trace.counters import as_dict, new_counters
from asking import unpack
from beam_scenes import lit, on_surfaces
from hierarchies import hierarchy, met_by, nodes_in, points_query, receivers_in, triangles_of

HOW = TraversalOptions(False, True, 0, False, PAIRS)


def _traced(made, triangles, how=HOW, counters=None, picks=None):
    """(m, spp) bool: whether each segment is blocked, by a traversal of all triangles, or of `picks`."""
    soup = soup_of(triangles)
    picks = np.arange(len(soup.corners), dtype=np.int32) if picks is None else picks
    ticket, memory = new_ticket(len(picks), BATCH), memory_for(len(made.tree.faces), how)
    trace_triangles(ticket, soup, picks, made.beam, made.tree, made.rays, how, counters, memory)
    return _dead(made)


def _dead(made):
    ids = receivers_in(made.rays)
    lanes = np.arange(made.rays.ways)[:, None]
    dead = (made.rays.dead[:, None] >> lanes & 1).astype(bool)  # leaf, lane, sample
    out = np.zeros((made.query.sides.size, made.rays.n_samples), bool)
    out[ids[ids >= 0]] = dead[ids >= 0]
    return out


GUARD, MARGIN = -123456789, 64  # words after each level's queue, which must not change; their number


@kernel
def _trace_guarded(triangles, beam, arrays, rays, how, pairs, step, memory, found):
    """As `trace_triangles`, one batch after the other, in queues that the test can read."""
    tree, parts, view, leaves = tree_pointers(arrays), len(arrays.faces), view_of(beam), leaves_of(rays)
    soup, n = Soup(ptr(triangles.corners), ptr(triangles.ids)), len(triangles.corners)
    rows, marks, slots, flat = memory.rows, memory.marks, stack_array(np.int32, LANES), ptr(pairs)
    blocks = queues_blocks(tree, how)
    queues = Queues(flat, ptr_at(flat, QUEUES * step), ptr(marks), step, stack_f32(LANES), blocks)
    for first in range(0, n, BATCH):
        last = min(first + BATCH, n)
        for i in range(first, last, LANES):
            for lane in range(LANES):
                slots[lane] = min(i + lane, last - 1)
            block = (i - first) // LANES
            to = ptr_at(found, block * parts)
            write_rows(tree, parts, view, soup, ptr(slots), min(last - i, LANES), how, ptr_at(rows, block * BLOCK), to)
        for part in range(parts):
            of_part = ptr_at(rows, part * BATCH * NUMBERS)
            for block in range((last - first + LANES - 1) // LANES):
                queue_block(tree, part, block, of_part, np.int64(found[block * parts + part]), queues)
            traverse_queues(tree, part, leaves, soup, of_part, queues, how, None)


def _met_by_all_nodes(n):
    """Large triangles around the light at the origin, in planes through it. No node rejects them, and none blocks."""
    k = np.arange(n) % 5 + 1
    flat = np.array([[-5, -5], [5, -5], [0, 9]])[None] * k[:, None, None]
    along = np.array([[1, 0, 0], [0, 1, 0], [1, 1, 0]])[np.arange(n) % 3]
    return flat[..., :1] * along[:, None] + flat[..., 1:] * [0, 0, 1]


HALF = np.array([[[-2e3, -1e3, 1], [1e-3, -1e3, 1], [1e-3, 3e3, 1]]])
"""A triangle that shades the receivers of `_under` with x < 0 from a light at the origin."""


def _under(m, seed=1):
    """Receivers above z = 2, in random order."""
    rng = np.random.default_rng(seed)
    return np.stack([*rng.uniform(-3, 3, (2, m)), rng.uniform(2, 4, m)], -1).astype(np.float32)


@pytest.mark.parametrize("early_accept", [False, True])
@pytest.mark.parametrize("ways", [4, 16])
@pytest.mark.parametrize("kind", [Boxes, Cones])
def test_queues_never_hold_more_than_they_may(kind, ways, early_accept):
    """Triangles that all nodes of a hierarchy of several levels meet, and queues of the smallest size."""
    triangles = triangles_of(np.concatenate([_met_by_all_nodes(60), HALF, _met_by_all_nodes(90)]))
    query = points_query(triangles, _under(600), at.PointLight((0, 0, 0)), 1)
    (beam,) = beams_of(query)
    truth = met_by(query, triangles.vertices.reshape(-1, 9)).any(0)
    assert 0.3 < truth.mean() < 0.7
    held = []
    for pairs in (BATCH, 2 * LANES * LANES, PAIRS):  # the second is the smallest that holds blocks
        made = hierarchy(kind, query, beam, ways, True)
        step = pairs + LANES + MARGIN
        queues = np.full((2, QUEUES, step), GUARD, np.int32)
        how = HOW._replace(early_accept=early_accept, pairs=pairs)
        parts = len(made.tree.faces)
        memory, found = memory_for(parts, how), np.zeros(BATCH // LANES * parts, np.int32)
        _trace_guarded(soup_of(triangles), beam, made.tree, made.rays, how, queues, step, memory, found)
        np.testing.assert_array_equal(_dead(made), truth)
        assert (queues[:, :, pairs + LANES :] == GUARD).all()
        assert made.tree.heights.max() >= 3 or ways == 16
        held.append(int((queues[0] != GUARD).sum(1).max()))
    assert BATCH // 2 < held[0] <= BATCH + LANES and held[-1] > (held[0] if early_accept else 2 * BATCH)


@pytest.mark.parametrize("options", [FASTEST_RAY_HIERARCHY, TABLE_1["Spheres"], TABLE_1["PreciseSEATP"]], ids=str)
def test_the_smallest_queues_give_the_same_bits(options, monkeypatch):
    triangles, query = on_surfaces(4, "quad", (33, 40), n=200, spp=3)
    bits = [np.zeros((33, 40, 1), np.uint64) for _ in range(2)]
    ray_hierarchy.trace_shadow(soup_of(triangles), query, bits[0], 2, None, None, options)
    monkeypatch.setattr(ray_hierarchy, "PAIRS", BATCH)
    ray_hierarchy.trace_shadow(soup_of(triangles), query, bits[1], 2, None, None, options)
    np.testing.assert_array_equal(bits[0], bits[1])
    assert bits[0].any() and not (bits[0] == 7).all()


@pytest.mark.parametrize("ways", [4, 16])
@pytest.mark.parametrize("kind", [Boxes, Cones])
def test_a_covered_node_is_finished_with_all_below_it_and_nothing_else(kind, ways):
    """A half plane in front of half of the receivers: nodes on its side finish at once, the others stay alive."""
    triangles = triangles_of(HALF)
    query = points_query(triangles, _under(2500), at.PointLight((0, 0, 0)), 1)
    (beam,) = beams_of(query)
    truth = met_by(query, triangles.vertices.reshape(-1, 9)).any(0)
    assert 0.3 < truth.mean() < 0.7
    work = {}
    for early_accept in (False, True):
        made, tally = hierarchy(kind, query, beam, ways, True), new_counters()
        np.testing.assert_array_equal(_traced(made, triangles, HOW._replace(early_accept=early_accept), tally), truth)
        work[early_accept] = as_dict(tally)
    assert work[False]["covered"] == 0 < work[True]["covered"]
    assert work[True]["triangle_tests"] < 0.3 * work[False]["triangle_tests"]
    dead, whole = 0, 0
    for node in nodes_in(made):
        group = made.tree.groups[node.part, node.level] + node.index // ways
        alive = made.tree.alive[group] >> node.index % ways & 1
        if not alive and len(node.receivers):
            assert truth[node.receivers].all()
            dead += 1
            whole += node.level > 0
    assert dead > 20 and (whole > 3 or ways == 16)
    again = new_counters()
    _traced(made, triangles, counters=again)
    assert as_dict(again)["nodes"] < work[True]["nodes"]


def test_what_is_finished_is_finished_up_to_the_root():
    """When all rays are blocked, no node is visited."""
    triangles = triangles_of([[[-1e3, -1e3, 1], [2e3, -1e3, 1], [0, 2e3, 1]]])
    query = points_query(triangles, _under(700), at.PointLight((0, 0, 0)), 1)
    (beam,) = beams_of(query)
    for kind in (Boxes, Cones):
        for ways in (4, 16):
            made, tally = hierarchy(kind, query, beam, ways, True), new_counters()
            assert _traced(made, triangles, counters=tally).all()
            assert as_dict(tally)["triangle_tests"] < 20
            _traced(made, triangles)  # finds leaves finished whose rays ended one by one
            assert not made.tree.alive.any()
            before = as_dict(tally)["nodes"]
            _traced(made, triangles, counters=tally)
            assert as_dict(tally)["nodes"] == before


def test_rays_that_end_one_by_one_finish_their_leaves():
    """No single triangle covers a leaf, but the triangles of a mosaic end all its rays. Then the leaf is finished."""
    x, y = (a.ravel() for a in np.meshgrid(np.arange(-40, 40), np.arange(-40, 40)))
    low = np.stack([x, y, 0 * x + 20.0], 1) / 20
    squares = low[:, None] + np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 0, 0], [1, 1, 0], [0, 1, 0]]) / 20
    triangles = triangles_of(squares)
    query = points_query(triangles, _under(400), at.PointLight((0, 0, 0)), 1)
    (beam,) = beams_of(query)
    made = hierarchy(Boxes, query, beam, 16, True)
    assert _traced(made, triangles).all()
    _traced(made, triangles)  # the next triangle finds the leaf finished
    assert not made.tree.alive.any()


RULES = {"area": AREA, "solid angle": SOLID_ANGLE, "nearest": NEAREST}


@pytest.mark.parametrize("light", ["point", "quad", "sun", "ambient"])
@pytest.mark.parametrize("rule", RULES)
def test_two_passes_give_the_same_bits_whatever_goes_first(rule, light, monkeypatch):
    triangles, query = on_surfaces(9, light, (20, 30), n=120, spp=3)
    blank = lambda: np.zeros((20, 30, 1), np.uint64)
    plain, bits = blank(), blank()
    ray_hierarchy.trace_shadow(soup_of(triangles), query, plain, 1, None, None, RayHierarchyOptions(nodes=Cones))
    monkeypatch.setattr(triangle_traversal, "SHARE", 0.25)
    picked = []

    def chosen(soup, beam, threads):
        picked.append(occluders_first(soup, beam, threads, RULES[rule]))
        return picked[-1]

    monkeypatch.setattr(ray_hierarchy, "occluders_first", chosen)
    for options in (
        RayHierarchyOptions(nodes=Cones, two_pass=True),
        FASTEST_RAY_HIERARCHY._replace(two_pass=True),
        TABLE_1["PreciseSEATP"],
    ):
        bits[:] = 0
        ray_hierarchy.trace_shadow(soup_of(triangles), query, bits, 2, None, None, options)
        np.testing.assert_array_equal(bits, plain)
    assert unpack(plain, 3).any() and not unpack(plain, 3).all()
    for first, rest in picked:
        assert len(first) == 30
        np.testing.assert_array_equal(np.sort(np.concatenate([first, rest])), np.arange(120))


def test_the_rules_choose_what_they_say(monkeypatch):
    monkeypatch.setattr(triangle_traversal, "SHARE", 0.34)
    near_small = np.array([[0.0, 0, 1], [0.1, 0, 1], [0, 0.1, 1]])
    far_huge = np.array([[0.0, 0, 100], [30, 0, 100], [0, 30, 100]])
    edge_on = np.array([[0.0, 0, 3], [0, 0, 9], [8, 0, 9]])
    broad = np.array([[0.0, 0, 5], [3, 0, 5], [0, 3, 5]])
    triangles = triangles_of([near_small, far_huge, edge_on, broad])
    query = points_query(triangles, _under(5), at.PointLight((0, 0, 0)), 1)
    (beam,) = beams_of(query)
    first = {name: occluders_first(soup_of(triangles), beam, 1, rule)[0].tolist() for name, rule in RULES.items()}
    assert first == {"area": [1], "solid angle": [3], "nearest": [0]}


@pytest.mark.parametrize("n", [0, 1, 2, 63, 64])
def test_occluders_of_few_triangles(n):
    triangles, query = on_surfaces(1, "point", (4, 4), n=80)
    soup = soup_of(triangles)
    soup = Soup(soup.corners[:n], soup.ids[:n])
    first, rest = occluders_first(soup, beams_of(query)[0], 2)
    assert len(first) == n // 64 and len(first) + len(rest) == n


def test_threads_share_a_hierarchy():
    """The bits are the same, and dead rays stay dead, for any thread that finds them."""
    triangles, query = lit(3, "point", "all around", 1.0, 2000, 11)
    truth = met_by(query, triangles.vertices.reshape(-1, 9)).any(0)[:, :1]
    for options in (FASTEST_RAY_HIERARCHY, RayHierarchyOptions(nodes=Cones, early_accept=True, sorted=True)):
        for threads in (1, 2, 3):
            bits = np.zeros((1, 2000, 1), np.uint64)
            ray_hierarchy.trace_shadow(soup_of(triangles), query, bits, threads, None, None, options)
            np.testing.assert_array_equal(unpack(bits, 1)[0], truth)
    assert 0 < truth.mean() < 1
