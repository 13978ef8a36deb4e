"""Projected rays: what planes decide about them is right, and the rest is decided exactly."""

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

import antumbra as at
from antumbra.kernels.jit import kernel
from antumbra.kernels.simd import get, ptr, ptr_at, stack_array
from antumbra.query.receivers import FREE
from antumbra.techniques.culling.pre_bvh_culling import Soup, soup_of
from antumbra.techniques.rayhierarchy.box_nodes import Boxes
from antumbra.techniques.rayhierarchy.light_beams import beams_of, view_of
from antumbra.techniques.rayhierarchy.pixel_blocks import rays_by_blocks
from antumbra.techniques.rayhierarchy.projected_rays import meet_projected
from antumbra.techniques.rayhierarchy.ray_hierarchy import trace_shadow
from antumbra.techniques.rayhierarchy.ray_tree import tree_of, tree_pointers
from antumbra.techniques.rayhierarchy.shadow_planes import LANES, NUMBERS
from antumbra.techniques.rayhierarchy.triangle_traversal import BATCH, PAIRS, TraversalOptions, row_at, write_rows
from antumbra.techniques.tracer_options import FASTEST_RAY_HIERARCHY
from antumbra.trace.counters import as_dict, new_counters
from asking import unpack
from beam_scenes import RECEIVERS, beside_a_small_light, lit, on_surfaces
from hierarchies import met_by, points_query, receivers_in, triangles_of
from strength import examples

HOW = TraversalOptions(False, True, 0, True, PAIRS)


@kernel
def _ask(arrays, beam, triangles, rays, how, memory, found, sure, undecided):
    """Ask each leaf about each triangle: bits of the rays that it surely blocks, and of those that are undecided.

    memory, found : scratch memory: the rows of a batch, float32, and a mask for each face, int32
    """
    tree, parts, view, blocks = tree_pointers(arrays), len(arrays.faces), view_of(beam), ptr(rays.blocks)
    soup, slots = Soup(ptr(triangles.corners), ptr(triangles.ids)), stack_array(np.int32, LANES)
    n = len(triangles.corners)
    for first in range(0, n, LANES):
        for lane in range(LANES):
            slots[lane] = min(first + lane, n - 1)
        write_rows(tree, parts, view, soup, ptr(slots), min(n - first, LANES), how, ptr(memory), ptr(found))
        for part in range(parts):
            for lane in range(min(n - first, LANES)):
                if found[part] >> lane & 1 == 0:
                    continue
                row = row_at(ptr_at(memory, part * BATCH * NUMBERS), lane)
                for leaf in range(get(tree.leaves, part), get(tree.leaves, part + 1)):
                    yes, unknown = meet_projected(ptr_at(rays.points, 48 * get(blocks, leaf)), row)
                    sure[first + lane, leaf], undecided[first + lane, leaf] = yes, unknown


def _picture(query, width=8):
    """The query of points as that of a picture, with one sample."""
    shape = -1, width
    return query._replace(
        origins=query.origins.reshape(*shape, 3),
        faces=query.faces.reshape(shape),
        sides=query.sides.reshape(shape),
        ids=query.ids.reshape(shape),
        samples=np.ascontiguousarray(query.samples[:, :1]),
    )


def _check(triangles, query):
    """Check what planes decide, and the answers; return the beam, the triangles, and (4, n) counts of each one's rays.

    The rays counted are those that it surely meets, those undecided, those that it meets, and all.
    """
    (beam,), soup = beams_of(query), soup_of(triangles)
    bits, truth = np.zeros((*query.sides.shape, 1), np.uint64), met_by(query, triangles.vertices.reshape(-1, 9))[..., 0]
    rays = rays_by_blocks(query, beam, bits, 1, projected=True)
    tree, n = tree_of(Boxes, beam, rays, 1), len(soup.corners)
    parts, shape = len(tree.faces), (n, len(rays.blocks))
    memory, found = np.zeros(parts * BATCH * NUMBERS, np.float32), np.zeros(parts, np.int32)
    sure, undecided = np.zeros(shape, np.int32), np.zeros(shape, np.int32)
    _ask(tree, beam, soup, rays, HOW, memory, found, sure, undecided)
    ids = receivers_in(rays)
    yes, unknown = ((of[..., None] >> np.arange(16) & 1).astype(bool)[:, ids >= 0] for of in (sure, undecided))
    met = truth[soup.ids][:, ids[ids >= 0]]
    assert not (yes & ~met).any() and not (yes & unknown).any()
    assert not (met & ~yes & ~unknown).any()
    trace_shadow(soup, query, bits, 2, None, None, FASTEST_RAY_HIERARCHY)
    lanes = ids[ids >= 0]
    np.testing.assert_array_equal(unpack(bits, 1)[..., 0].reshape(-1)[lanes], truth[:, lanes].any(0))
    return beam, soup.corners, np.array([rays.sum(1) for rays in (yes, unknown, met, np.ones_like(met))])


@examples(150)
@given(
    seed=st.integers(0, 2**32 - 1),
    receivers=st.sampled_from(list(RECEIVERS)),
    scale=st.sampled_from([1.0, 1.0, 1e-6, 1e-3, 1e3, 1e6, 1e-36, 1e-30, 1e-20, 1e20, 1e30, 3e33]),
)
def test_planes_decide_no_ray_wrongly(seed, receivers, scale):
    triangles, query = lit(seed, "point", receivers, scale)
    _check(triangles, _picture(query))


@examples(100)
@given(seed=st.integers(0, 2**32 - 1))
def test_corners_next_to_the_light(seed):
    triangles, query = beside_a_small_light(seed)
    beams = beams_of(picture := _picture(query))
    if len(beams) == 1 and beams[0].radius == 0.0:
        _check(triangles, picture)


def _solid(beam, corners):
    """Whether triangles, (n, 9) float32, span a volume with the light that rounding does not hide."""
    a, b, c = np.moveaxis(corners.astype(np.float64).reshape(-1, 3, 3) - beam.apex, 1, 0)
    size = np.abs([b - a, c - b, a - c]).max((0, 2))
    volume = np.abs((np.cross(b - a, c - a) * a).sum(1))
    return volume > 2.0**-10 * size * size * np.abs([a, b, c]).max((0, 2))


@pytest.mark.parametrize("receivers, share", [("a wide cone", 0.9), ("all around", 0.9), ("a plane", 0.7)])
def test_planes_decide_nearly_all(receivers, share):
    """Nearly all rays are decided without an exact test, unless the triangle is degenerate as seen from the light.

    Receivers in a plane through the light lie in the planes of many edges, and need exact tests.
    """
    total = np.zeros(4, np.int64)
    for seed in range(12):
        beam, corners, counts = _check(*_seeded(seed, receivers))
        total += counts[:, _solid(beam, corners)].sum(1)
    yes, unknown, met, asked = total
    assert yes > share * met > 100 and unknown < 0.03 * asked


def _seeded(seed, receivers):
    triangles, query = lit(seed, "point", receivers, 1.0)
    return triangles, _picture(query)


@pytest.mark.parametrize("shape", [(13, 18), (4, 4), (9, 3)])
@pytest.mark.parametrize("cull_faces", [0, 1, -1])
@pytest.mark.parametrize("threads", [1, 3])
def test_pictures_of_surfaces(shape, cull_faces, threads):
    """Receivers lie on the triangles that are tested, which do not block their own rays; culled faces block none."""
    some = []
    for seed in range(6):
        triangles, query = on_surfaces(seed, "point", shape, spp=1, cull_faces=cull_faces)
        (plain, bits), tally = np.zeros((2, *shape, 1), np.uint64), new_counters()
        options = FASTEST_RAY_HIERARCHY._replace(blocks=False, sorted=True)
        trace_shadow(soup_of(triangles), query, plain, threads, None, None, options)
        trace_shadow(soup_of(triangles), query, bits, threads, tally, None, FASTEST_RAY_HIERARCHY)
        np.testing.assert_array_equal(bits, plain)
        assert as_dict(tally)["triangle_tests"] > 0
        some.append(unpack(bits, 1).mean())
    assert 0.0 < np.mean(some) < 1.0


def test_a_receiver_at_the_light_and_others_too_close_to_it_to_project():
    triangles = triangles_of(np.random.default_rng(1).normal(size=(20, 3, 3)))
    points = np.zeros((16, 3), np.float32)
    points[1:6, 0] = 1e-40, -1e-39, 1e-35, 1e-31, 1e-29
    points[6:] = np.random.default_rng(2).normal(size=(10, 3)) * 1e-3
    query = _picture(points_query(triangles, points, at.PointLight((0, 0, 0)), 1), 4)
    assert (query.sides == FREE).all()
    _check(triangles, query)
