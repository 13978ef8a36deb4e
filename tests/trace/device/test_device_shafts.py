"""Shafts on devices: they meet the boxes that their segments meet, and are right about what they miss or cover."""

from typing import NamedTuple

import numpy as np
import pytest

from antumbra.bvh.nodes import aligned_empty
from antumbra.kernels.device import thread_index
from antumbra.kernels.jit import kernel
from antumbra.kernels.simd import f32_at, get, i32_at, put
from antumbra.kernels.toolchain.device_code import DeviceKernel
from antumbra.trace.device.device_shafts import Ends, cull_triangle, enter_boxes, shaft_of
from antumbra.trace.device.device_traversal import TRIANGLE, TreeBuffers, filter_triangle
from devices import DEVICES, launch, opened

F, N, WORDS = np.float32, 3000, 6


class Pairs(NamedTuple):
    """Addresses of shafts, and of what is certain for each and its node and triangle."""

    ends: int  # float32, 13 per shaft: the bounds of both ends, and the shortest direction
    verdicts: int  # int32, WORDS per shaft: left, right, left first, miss, cover, fits
    n: int


@kernel
def _test_pairs(tree, pairs, facing):
    k = thread_index()
    if k < pairs.n:
        p, out = f32_at(pairs.ends), i32_at(pairs.verdicts)
        at = 13 * k
        ends = Ends(
            (get(p, at), get(p, at + 1), get(p, at + 2)), (get(p, at + 3), get(p, at + 4), get(p, at + 5)),
            (get(p, at + 6), get(p, at + 7), get(p, at + 8)), (get(p, at + 9), get(p, at + 10), get(p, at + 11)),
            get(p, at + 12),
        )  # fmt: skip
        shaft = shaft_of(tree, ends)
        left, right, left_first = enter_boxes(f32_at(tree.nodes), k, shaft)
        triangle, _ = filter_triangle(tree.triangles, k)
        v = cull_triangle(shaft, triangle, facing)
        put(out, WORDS * k, np.int32(left))
        put(out, WORDS * k + 1, np.int32(right))
        put(out, WORDS * k + 2, np.int32(left_first))
        put(out, WORDS * k + 3, v.miss)
        put(out, WORDS * k + 4, v.cover)
        put(out, WORDS * k + 5, np.int32(shaft.fits))


_TEST = DeviceKernel(_test_pairs, (TreeBuffers(0, 0, (F(1), F(1), F(1))), Pairs(0, 0, 0), 0))


class Case(NamedTuple):
    """Shafts of 16 segments each, and a node and a triangle for each of them."""

    o: np.ndarray  # (N, 16, 3) float32
    l: np.ndarray  # likewise
    nodes: np.ndarray  # (N, 16) float32
    triangles: np.ndarray  # (N, 3, 3) float32


def made(scale, seed=1):
    """Shafts of all widths; boxes and triangles beside them and within; some flat, and some along an axis."""
    rng = np.random.default_rng(seed)
    o = rng.normal(size=(N, 1, 3)) + rng.normal(size=(N, 16, 3)) * 10.0 ** rng.uniform(-6, 0, (N, 1, 1))
    l = rng.normal(size=(N, 1, 3)) * 3 + rng.normal(size=(N, 16, 3)) * 10.0 ** rng.uniform(-6, 0, (N, 1, 1))
    l[::5, :, 0] = o[::5, :, 0]
    o[1::5] = o[1::5, :1]
    t = rng.random((N, 1, 1))
    on = (o + t * (l - o))[:, 0]
    nodes = aligned_empty((N, 16), "f4")
    nodes[:] = 0
    for side in range(2):
        centre = on + rng.normal(size=(N, 3)) * 10.0 ** rng.uniform(-3, 0.5, (N, 1))
        half = np.abs(rng.normal(size=(N, 3))) * 10.0 ** rng.uniform(-4, 0, (N, 1)) * (rng.random((N, 3)) < 0.8)
        nodes[:, side:12:4], nodes[:, side + 2 : 12 : 4] = (centre - half) * scale, (centre + half) * scale
    corners = rng.normal(size=(N, 3, 3)) * 10.0 ** rng.uniform(-2, 1.5, (N, 1, 1))
    corners += (on + rng.normal(size=(N, 3)) * 10.0 ** rng.uniform(-3, 0, (N, 1)) - corners.mean(1))[:, None]
    return Case((o * scale).astype(F), (l * scale).astype(F), nodes, (corners * scale).astype(F))


def verdicts(device, case, facing=0):
    """(N, WORDS) int: what a device finds."""
    o, l = case.o, case.l
    shortest = np.abs(l - o).max(2).min(1)
    ends = np.concatenate([o.min(1), o.max(1), l.min(1), l.max(1), shortest[:, None]], 1).astype(F)
    words = np.zeros((N, TRIANGLE), F)
    for k in range(3):
        words[:, 4 * k : 4 * k + 3] = case.triangles[:, k]
    sent = [device.upload(np.ascontiguousarray(each)) for each in (case.nodes, words, ends, np.zeros((N, WORDS), "i4"))]
    reach = (np.abs(case.nodes[:, :12]).max(),) * 3
    tree = TreeBuffers(sent[0].address, sent[1].address, reach)
    launch(device, _TEST, (tree, Pairs(sent[2].address, sent[3].address, N), facing), N)
    return sent[3].read(np.empty((N, WORDS), np.int32))


def meets_box(case, side):
    """(N,) bool: whether a segment surely meets a box of its node, in float64."""
    o, d = case.o.astype(float), case.l.astype(float) - case.o
    low, high = (case.nodes[:, side + k : 12 : 4].astype(float)[:, None] for k in (0, 2))
    with np.errstate(all="ignore"):
        a, b = (low - o) / d, (high - o) / d
    inside = (o >= low) & (o <= high)
    near = np.where(d == 0, np.where(inside, -np.inf, np.inf), np.minimum(a, b)).max(2)
    far = np.where(d == 0, np.where(inside, np.inf, -np.inf), np.maximum(a, b)).min(2)
    return (np.maximum(near, 0) <= np.minimum(far, 1)).any(1)


def meets_triangle(case):
    """((N, 16) bool: whether the segment meets its triangle, (N, 16): the sign of d . n), in float64."""
    o, d = case.o.astype(float), case.l.astype(float) - case.o
    a, p, q = (
        v[:, None].astype(float)
        for v in (case.triangles[:, 0], *np.diff(case.triangles[:, [0, 1, 0, 2]], axis=1)[:, ::2].swapaxes(0, 1))
    )
    a = a - o
    n, r = np.cross(p, q), np.cross(d, a)
    e2, e1, dn, t = (p * r).sum(2), -(q * r).sum(2), (d * n).sum(2), (a * n).sum(2)
    e0 = dn - e1 - e2
    same = ((e0 > 0) & (e1 > 0) & (e2 > 0)) | ((e0 < 0) & (e1 < 0) & (e2 < 0))
    return same & (t * dn > 0) & (np.abs(t) < np.abs(dn)), np.sign(dn)


@pytest.fixture(scope="module", params=DEVICES)
def device(request):
    return opened(request.param)


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
def test_no_box_that_a_segment_meets_is_missed_and_most_others_are(device, scale):
    case = made(scale)
    found, met = verdicts(device, case), np.stack([meets_box(case, side) for side in range(2)], 1)
    assert (found[:, :2] >= met).all() and (found[:, 5] == 1).all()
    assert 0.2 < met.mean() < 0.8 and found[~met[:, 0], 0].mean() < 0.4


@pytest.mark.parametrize("facing", [0, 1, -1])
@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
def test_a_shaft_is_right_about_what_it_misses_and_covers(device, scale, facing):
    case = made(scale)
    found, (hit, sign) = verdicts(device, case, facing), meets_triangle(case)
    if facing:
        hit &= sign != facing
    miss, cover = found[:, 3] != 0, found[:, 4] != 0
    assert not hit[miss].any() and hit[cover].all()
    assert miss[~hit.any(1)].mean() > 0.5 and cover.sum() > 100 // (1 + abs(facing)) and (miss & cover).sum() == 0


@pytest.mark.parametrize("scale", [1e-14, 1e13])
def test_a_shaft_beyond_float32_meets_all_boxes_and_decides_nothing(device, scale):
    found = verdicts(device, made(scale))
    assert (found[:, :2] == 1).all() and (found[:, 3:] == 0).all()
