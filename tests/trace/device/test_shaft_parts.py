"""Parts of tiles on devices: each receiver is in one of them, and tiles are cut where the CPU cuts them."""

import numpy as np
import pytest

from antumbra.kernels.jit import kernel
from antumbra.kernels.simd import as_i32, ptr, ptr_at
from antumbra.query.receivers import FREE, NOTHING
from antumbra.scene.lights import QuadLight
from antumbra.trace.device import shaft_parts
from antumbra.trace.device.device_tracer import DeviceTracer
from antumbra.trace.device.device_traversal import PARTS
from antumbra.trace.device.shaft_parts import PART, parts_bytes, suits_shafts, tiles_of, whole_squares
from antumbra.trace.tile import RECEIVER_FLOATS, Tile, coherent_part
from beam_scenes import on_surfaces
from devices import DEVICES, opened
from hierarchies import points_query, triangles_of

ROOM = triangles_of(np.eye(3)[None])


@pytest.fixture(scope="module", params=DEVICES)
def tracer(request):
    return DeviceTracer(opened(request.param))


def picture_of(points, sides=None, ids=None, light=None):
    """A query of receivers in an (h, w, 3) array; sides, ids: (h, w)."""
    h, w, _ = points.shape
    light = QuadLight((0, 9, 0), (1, 0, 0), (0, 0, 1)) if light is None else light
    query = points_query(ROOM, points.reshape(-1, 3), light, 2)
    sides = np.full((h, w), FREE, np.int8) if sides is None else sides.astype(np.int8)
    ids = np.full((h, w), -1, np.int32) if ids is None else ids.astype(np.int32)
    faces = np.full((h, w), -1, np.int32)
    return query._replace(origins=points.astype(np.float32), sides=sides, faces=faces, ids=ids)


def parts_on(tracer, query, first=0, receivers=None):
    """[(index of the first receiver of the tile, bits of the part)] that a device finds."""
    receivers = query.sides.size - first if receivers is None else receivers
    tiles, spp = tiles_of(query, first, receivers), query.samples.shape[1]
    block = tracer.launches.block("parts", parts_bytes(tiles), "parts")
    tiles, work = tiles._replace(parts=block.address), tracer._work(first * spp, receivers * spp, 0)
    tracer.launches.block("counts", 0, "").fill()
    tracer.launches.launch("find_parts", (tracer._sample_buffers(None, query, 1), work, tiles), tiles.n)
    n = tiles.n + int(tracer._counts()[PARTS])
    parts = block.read(np.empty((n, PART), np.int32))
    return [(first + at, lanes) for at, lanes in parts.tolist() if lanes]


def members(query, at, lanes):
    """The receivers of a part."""
    (h, w), k = query.sides.shape, np.flatnonzero(lanes >> np.arange(16) & 1)
    return (at + k if h == 1 else at + (k >> 2) * w + (k & 3)).tolist()


@pytest.mark.parametrize("shape", [(1, 1), (1, 100), (3, 5), (33, 70), (70, 33), (5, 1)])
def test_each_receiver_is_in_one_part(tracer, shape):
    rng = np.random.default_rng(1)
    sides = np.where(rng.random(shape) < 0.3, NOTHING, FREE)
    sides[0, 0] = FREE
    query = picture_of(rng.normal(size=(*shape, 3)), sides)
    found = [i for part in parts_on(tracer, query) for i in members(query, *part)]
    assert sorted(found) == np.flatnonzero(sides.ravel() != NOTHING).tolist()


@pytest.mark.parametrize("first, receivers", [(0, 70), (70, 300), (85, 33), (600, 1)])
def test_a_chunk_has_its_receivers_only(tracer, first, receivers):
    query = picture_of(np.random.default_rng(2).normal(size=(33, 70, 3)))
    found = [i for part in parts_on(tracer, query, first, receivers) for i in members(query, *part)]
    assert sorted(found) == list(range(first, first + receivers))


@kernel
def _coherent_part(receivers, lanes, light):
    p = ptr(receivers)
    ids = as_i32(ptr_at(p, 48))
    return coherent_part(Tile(0, p, p, ids, p, ids, p, p, p, p, p, p, p), lanes, light)


def parts_on_cpu(query, light):
    """The parts of each tile of a picture whose sides are multiples of 4, as the CPU cuts them."""
    (h, w), out = query.sides.shape, []
    for y in range(0, h, 4):
        for x in range(0, w, 4):
            receivers, left = np.zeros(RECEIVER_FLOATS, np.float32), 0xFFFF
            receivers[:48] = query.origins[y : y + 4, x : x + 4].reshape(16, 3).T.ravel()
            receivers.view(np.int32)[48:64] = query.ids[y : y + 4, x : x + 4].ravel()
            while left:
                out.append((y * w + x, _coherent_part(receivers, left, np.float32(light))))
                left &= ~out[-1][1]
    return out


def test_tiles_are_cut_where_the_cpu_cuts_them(tracer):
    rng, shape = np.random.default_rng(3), (16, 24)
    places = rng.normal(size=(2, 3))[rng.integers(0, 2, shape)] + rng.normal(size=(*shape, 3)) * 1e-3
    places[:4, :4] = (0.5, 0.5, 0.5)  # one point
    ids = rng.integers(-1, 2, shape)
    ids[4:8] = 1  # tiles on one triangle
    query = picture_of(places, ids=ids)
    light = tiles_of(query, 0, query.sides.size).light
    found = parts_on(tracer, query)
    assert 0.0 < light < 1.0 and sorted(found) == sorted(parts_on_cpu(query, light))
    sizes = np.bitwise_count(np.array([lanes for _, lanes in found]))
    assert sizes.max() == 16 and 1 < sizes.mean() < 12


def test_chunks_end_between_squares_if_they_are_so_large():
    query = picture_of(np.zeros((70, 33, 3)))
    assert whole_squares(33 * 32 * 2 + 5, query) == 33 * 64 and whole_squares(100, query) == 100
    assert whole_squares(100, picture_of(np.zeros((1, 500, 3)))) == 96


def test_wide_strata_and_huge_lamps_do_not_suit_shafts():
    _, narrow = on_surfaces(1, "quad")
    _, sky = on_surfaces(1, "ambient")
    far, near = (np.float32(x) for x in (1e6, 1e-6))
    assert suits_shafts((far,) * 3, narrow) and not suits_shafts((near,) * 3, narrow)
    assert not suits_shafts((far,) * 3, sky)
    assert tiles_of(sky, 0, 10).light == 0.0 and shaft_parts.SQUARE == 8
