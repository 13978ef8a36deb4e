"""The order of receivers: each receiver with a ray occurs once, and neighbours stay close together."""

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

from antumbra.kernels.jit import kernel
from antumbra.kernels.simd import load16, store
from antumbra.kernels.vec3 import rows
from antumbra.query.receivers import NOTHING
from antumbra.query.shadow_query import segments
from antumbra.techniques.rayhierarchy.leaf_packing import rays_of, unfinished_rays
from antumbra.techniques.rayhierarchy.light_beams import PERSPECTIVE, beams_of
from antumbra.techniques.rayhierarchy.pixel_blocks import rays_by_blocks
from antumbra.techniques.rayhierarchy.ray_leaves import finished_share, write_bits
from antumbra.techniques.rayhierarchy.receiver_order import BITS, cells_of, hilbert, keys_of, on_cube, order_of
from antumbra.trace.counters import as_dict, new_counters
from asking import unpack
from beam_scenes import LIGHTS, lit, on_surfaces
from hierarchies import receivers_in
from strength import examples

SIDE = 1 << 10  # side of the tested part of the grid: the corner where the curve begins


@kernel
def _hilbert(x, y, out):
    for i in range(0, len(x), 16):
        store(out, i, hilbert(load16(x, i), load16(y, i)))


@kernel
def _cube(directions, faces, keys):
    for i in range(0, len(faces), 16):
        face, u, v = on_cube(rows(directions, i, len(faces)))
        store(faces, i, face)
        store(keys, i, keys_of(cells_of(face, u, v)))


def test_the_hilbert_curve_visits_each_cell_once_and_goes_from_neighbour_to_neighbour():
    x, y = (a.ravel().astype(np.int32) for a in np.meshgrid(np.arange(SIDE), np.arange(SIDE)))
    keys = np.empty_like(x)
    _hilbert(x, y, keys)
    order = np.argsort(keys)
    np.testing.assert_array_equal(keys[order], np.arange(SIDE * SIDE))
    steps = np.abs(np.diff(x[order])) + np.abs(np.diff(y[order]))
    assert (steps == 1).all()


def test_faces_go_by_the_major_axis_and_come_first_in_keys():
    rng = np.random.default_rng(1)
    d = rng.normal(size=(3, 4096)).astype(np.float32)
    d[:, :512] = np.round(d[:, :512])
    d[:, (d == 0).all(0)] = 1
    faces, keys = np.empty(4096, np.int32), np.empty(4096, np.int32)
    _cube(d.ravel(), faces, keys)
    depth = np.take_along_axis(d, faces[None] // 2, 0)[0]
    assert (np.abs(depth) == np.abs(d).max(0)).all() and ((depth < 0) == faces % 2).all()
    assert (keys >> 2 * BITS == faces).all() and set(faces) == set(range(6))


def _orders(query, beam, bits, threads):
    """Yield (name, Rays, receivers in order) of all orders of a beam's receivers."""
    for name, sort, ways in ("sorted", True, 16), ("on the screen", False, 4):
        order = order_of(query, beam, bits, sort, threads)
        assert order.starts[0] == 0 and order.starts[-1] == len(order.ids)
        assert (np.diff(order.starts) > 0).all() or not len(order.ids)
        yield name, rays_of(query, beam, order, ways, bits, threads), order.ids[order.ids >= 0]
    if query.sides.shape[0] > 1:
        rays = rays_by_blocks(query, beam, bits, threads)
        yield "by blocks", rays, np.sort(receivers_in(rays)[receivers_in(rays) >= 0])
    if query.sides.shape[0] > 1 and beam.kind == PERSPECTIVE and beam.radius == 0.0 and beam.n_samples == 1:
        rays = rays_by_blocks(query, beam, bits, threads, projected=True)
        yield "projected", rays, np.sort(receivers_in(rays)[receivers_in(rays) >= 0])


def _asking(query, beam):
    """(h, w) bool: whether each receiver has a segment of the beam with a length, above the receiver's surface."""
    above, some = segments(query)[1], slice(beam.first, beam.first + beam.n_samples)
    asks = above[:, :, some].any(2)
    if beam.set >= 0:
        y, x = np.indices(asks.shape)
        asks &= x % 4 + 4 * (y % 4) == beam.set
    if beam.kind == PERSPECTIVE and beam.radius == 0.0:
        asks &= (query.origins != beam.apex).any(2)
    return asks


def _check(query, apart=False, threads=2):
    above = segments(query)[1]
    expected = (query.sides != NOTHING)[..., None] & ~above
    answers = {}
    for beam in beams_of(query, apart):
        asks = np.flatnonzero(_asking(query, beam))
        blank = lambda: np.zeros((*query.sides.shape, -(-query.samples.shape[1] // 64)), np.uint64)
        for name, rays, order in _orders(query, beam, bits := blank(), threads):
            ids = receivers_in(rays)[receivers_in(rays) >= 0]
            np.testing.assert_array_equal(np.sort(ids), asks, err_msg=f"{name}, {beam}")
            np.testing.assert_array_equal(np.sort(order), asks)
            assert rays.starts[0] == 0 and rays.starts[-1] == len(rays.blocks)
            assert (np.diff(rays.starts) > 0).all() or not len(ids)
            answers.setdefault(name, blank())[:] |= bits
    for name, bits in answers.items():
        np.testing.assert_array_equal(unpack(bits, above.shape[2]), expected, err_msg=name)
    return expected


@examples(120)
@given(
    seed=st.integers(0, 2**32 - 1),
    light=st.sampled_from(list(LIGHTS)),
    shape=st.sampled_from([(13, 18), (1, 50), (70, 9), (2, 3)]),
    offset=st.sampled_from([0.0, 0.0, 10.0, 300.0, 5000.0]),
    apart=st.booleans(),
    spp=st.sampled_from([1, 3]),
)
def test_each_receiver_that_asks_is_there_once_and_bits_are_those_of_the_horizon(
    seed, light, shape, offset, apart, spp
):
    _check(on_surfaces(seed, light, shape, offset=offset, spp=spp)[1], apart and light != "interleaved list")


@pytest.mark.parametrize("light", LIGHTS)
def test_receivers_in_the_air_all_ask(light):
    _, query = lit(3, light, "all around", 1.0, 100)
    assert not _check(query).any() or light == "ambient"


def test_a_receiver_at_the_light_below_its_own_horizon():
    """Its segment has no length. Only its own surface blocks it, because the light is not above the surface."""
    for normals in (None, np.tile([0.0, 1, 0], (20, 1))):
        _, query = lit(1, "point", "at the light, and around", 1.0, 20)
        if normals is not None:
            query = query._replace(normals=normals[None], sides=np.ones_like(query.sides))
        (beam,) = beams_of(query)
        assert (query.origins[0] == beam.apex).all(1).any()
        expected = _check(query)
        assert expected[0, 0].any() == (normals is not None)


def test_sorted_by_key_within_faces_and_counted():
    _, query = on_surfaces(5, "point", (40, 50), spp=1)
    (beam,), tally = beams_of(query), new_counters()
    bits = np.zeros((40, 50, 1), np.uint64)
    order = order_of(query, beam, bits, True, 1, tally)
    d = (query.origins.reshape(-1, 3)[order.ids].astype(np.float64) - beam.apex).astype(np.float32)
    n = len(d)
    padded = np.ones((3, -(-n // 16) * 16), np.float32)
    padded[:, :n] = d.T
    faces, keys = np.empty(padded.shape[1], np.int32), np.empty(padded.shape[1], np.int32)
    _cube(padded.ravel(), faces, keys)
    assert (np.diff(keys[:n]) >= 0).all() and len(order.faces) == 6
    for part, face in enumerate(order.faces):
        assert (faces[order.starts[part] : order.starts[part + 1]] == face).all()
    counts = as_dict(tally)
    assert counts["rays"] == (query.sides != NOTHING).sum() > counts["below_horizon"] == bits.sum() > 0


def test_on_the_screen_sixteen_places_are_a_block_of_pixels():
    _, query = on_surfaces(6, "point", (70, 130), spp=1)
    (beam,) = beams_of(query)
    order = order_of(query, beam, np.zeros((70, 130, 1), np.uint64), False, 1)
    ids = order.ids.reshape(-1, 16)
    assert order.placed and len(ids) > 9000 // 16
    for group in ids[(ids >= 0).any(1)]:
        y, x = np.divmod(group[group >= 0], 130)
        assert np.ptp(y // 4) == 0 == np.ptp(x // 4)
        z_order = (x % 2) + 2 * (y % 2) + 4 * (x // 2 % 2) + 8 * (y // 2 % 2)
        assert (np.diff(z_order) > 0).all()


@pytest.mark.parametrize("how", ["sorted", "on the screen", "by blocks"])
def test_what_is_left_after_a_traversal(how):
    rng = np.random.default_rng(8)
    _, query = on_surfaces(8, "quad", (41, 38), spp=3)
    (beam,) = beams_of(query)
    bits = np.zeros((41, 38, 1), np.uint64)
    (rays,) = (rays for name, rays, _ in _orders(query, beam, bits, 1) if name == how)
    before, everyone = receivers_in(rays), (1 << rays.ways) - 1
    some = rng.random(len(rays.dead)) < 0.3
    rays.dead[:] |= np.where(some[:, None], -1, rng.integers(0, 1 << rays.ways, rays.dead.shape))
    rays.dead[:] &= everyone
    write_bits(rays, bits, 1)
    left = unfinished_rays(query, beam, rays, bits, 1)
    alive = np.bitwise_or.reduce(~rays.dead & everyone, 1)[:, None] >> np.arange(rays.ways) & 1
    expected, ids = before[(alive == 1) & (before >= 0)], receivers_in(left)
    np.testing.assert_array_equal(np.sort(ids[ids >= 0]), np.sort(expected))
    assert 0 < len(expected) < (before >= 0).sum()
    assert left.starts[-1] == len(left.blocks) and len(left.faces) == len(left.starts) - 1
    assert left.placed == (how != "sorted") and (len(left.blocks) < len(rays.blocks)) != left.placed
    share = finished_share(rays)
    asked = np.concatenate([rays.dead >> lane & rays.lanes[:, None] >> lane & 1 for lane in range(rays.ways)])
    assert share == pytest.approx(asked.sum() / (3 * (before >= 0).sum()))
    left.dead[:] = -1
    assert not (receivers_in(unfinished_rays(query, beam, left, bits, 1)) >= 0).any()


def test_no_leaf_has_receivers_of_two_faces():
    _, query = lit(9, "point", "all around", 1.0, 300)
    (beam,) = beams_of(query)
    bits = np.zeros((1, 300, 1), np.uint64)
    order = order_of(query, beam, bits, True, 1)
    for ways in (4, 16):
        rays = rays_of(query, beam, order, ways, bits, 1)
        assert rays.starts[-1] == len(rays.dead) and len(rays.faces) == 6
        ids = receivers_in(rays)
        for part, face in enumerate(rays.faces):
            mine = ids[rays.starts[part] : rays.starts[part + 1]]
            np.testing.assert_array_equal(mine[mine >= 0], order.ids[order.starts[part] : order.starts[part + 1]])
            d = query.origins[0, mine[mine >= 0]].astype(np.float64) - beam.apex
            assert (np.abs(d).argmax(1) == face // 2).all()
