"""Selection of a beam's active receivers: those with a sample above their own surface."""

from typing import NamedTuple

import numpy as np

from ..kernels.fields import U64Ptr
from ..kernels.jit import inlined, kernel
from ..kernels.predicate.filters import dot, plane, widest
from ..kernels.simd import (
    bits,
    gather,
    get,
    load16,
    lowest_bit,
    mask_from_bits16,
    popcount,
    ptr,
    put,
    select,
    stack_i32,
    store,
)
from ..kernels.vec import Vec
from ..query.receivers import NOTHING
from ..query.shadow_query import (
    QueryPointers,
    horizon_of,
    is_above,
    patch_of,
    query_pointers,
    sample_of,
    set_bit,
    set_of,
    three_at,
)
from ..trace.counters import BELOW_HORIZON, RAYS, count
from .beams import AROUND, PERSPECTIVE

_SLANT = np.float64(2.0**-16)  # sine of an angle: a distant light must be this far above a plane as a whole
_SHALLOW = np.float64(2.0**-18)  # relative to the light's distance: receivers near a plane are no farther from it
_MORE = np.float64(1.000001)


class ConeSamples(NamedTuple):
    """The samples of a `Beam`."""

    first: int  # the first sample
    count: int  # number of samples
    set: int  # sample set; -1: all sets


class Asking(NamedTuple):
    """A query and its answer bits."""

    query: QueryPointers
    bits: U64Ptr  # uint64 *


@inlined
def asking_of(query, bits):
    """The `Asking` of a ShadowQuery and the array of its answer bits."""
    return Asking(query_pointers(query), ptr(bits))


@kernel
def _light_side(asking, view, face):
    """The side of a triangle's plane that holds all segment ends of the receivers near it; 0: unknown."""
    z = np.float64(0.0)
    if view.kind == AROUND:
        return np.int64(0)
    at = (view.x, view.y, view.z) if view.kind == PERSPECTIVE else (z, z, z)
    p, n, error = plane(asking.query.corners, face, z, z, z)
    length = np.sqrt(dot(n, n)) * _MORE
    if view.kind == PERSPECTIVE:
        to = at[0] - p[0], at[1] - p[1], at[2] - p[2]
        h, slack = dot(n, to), view.radius / view.unit * length + error * widest(to)
    elif view.scale > 64.0 * view.unit * _distance(asking):  # the rounding of ends matters
        return np.int64(0)
    else:
        h, slack = dot(n, view.w), (view.radius + _SLANT) * length + error
    if not abs(h) > slack:
        return np.int64(0)
    return np.int64(1) if h > z else np.int64(-1)


@inlined
def _light_side_again(asking, view, face, last):
    """`_light_side`, cached with its triangle in `last`: adjacent pixels mostly see the same triangle."""
    if get(last, 0) != face:
        put(last, 0, face)
        put(last, 1, _light_side(asking, view, face))
    return get(last, 1)


@inlined
def _distance(asking):
    """The distance of a distant light."""
    base = asking.query.light.base
    return np.sqrt(dot(base, base))


@kernel
def _is_near(asking, view, i):
    """Is a receiver near its triangle's plane? If the plane then parts it from the light, all samples are below."""
    if view.kind == PERSPECTIVE:  # all receivers have the same ends
        return True
    z = np.float64(0.0)
    p, n, error = plane(asking.query.corners, np.int64(get(asking.query.faces, i)), z, z, z)
    o = three_at(asking.query.origins, i)
    to = o[0] - p[0], o[1] - p[1], o[2] - p[2]
    return abs(dot(n, to)) + error * widest(to) < _SHALLOW * _distance(asking) * np.sqrt(dot(n, n))


@kernel
def _asks(asking, samples, i, counters):
    """Does a sample of a beam lie above the receiver's own surface? Sets the bits of the samples below it."""
    patch, horizon, asks = patch_of(asking.query, i), horizon_of(asking.query, i), False
    for s in range(samples.first, samples.first + samples.count):
        l = sample_of(asking.query, patch, i, s)
        if is_above(horizon, l[0], l[1], l[2], asking.query.corners):
            asks = True
        else:
            count(counters, BELOW_HORIZON, 1)
            set_bit(asking.query, asking.bits, i, s)
    return asks


@kernel
def _below(asking, samples, ids, lanes, counters):
    """Set the bits of all samples of a beam for some lanes."""
    count(counters, BELOW_HORIZON, samples.count * popcount(lanes))
    while lanes != 0:
        i = np.int64(get(ids, lowest_bit(lanes)))
        lanes &= lanes - 1
        for s in range(samples.first, samples.first + samples.count):
            set_bit(asking.query, asking.bits, i, s)


@kernel
def _sides_of(asking, samples, ids, lanes, sides):
    """Write the sides of 16 receivers, NOTHING for receivers outside `lanes` or of another sample set."""
    for lane in range(16):
        i = np.int64(get(ids, lane))
        others = samples.set >= 0 and set_of(asking.query, i) != samples.set
        put(sides, lane, NOTHING if others else np.int64(get(asking.query.sides, i)))
    store(sides, 0, select(mask_from_bits16(lanes), load16(sides, 0), np.int32(NOTHING)))


@kernel
def _some_ask(asking, view, samples, ids, lanes, counters):
    """`who_asks` for receivers that their triangle's plane parts from the light, tested one by one."""
    asks, below = np.int64(0), np.int64(0)
    while lanes != 0:
        lane, i = lanes & -lanes, np.int64(get(ids, lowest_bit(lanes)))
        lanes ^= lane
        if _is_near(asking, view, i):
            below |= lane
        elif _asks(asking, samples, i, counters):
            asks |= lane
    _below(asking, samples, ids, below, counters)
    return asks


@kernel
def who_asks(asking, view, samples, ids, lanes, last, counters):
    """Bits of the active receivers among 16: a sample of the beam lies above their surface.

    The answer bits of samples below a receiver's surface are set.

    ids : pointer to 16 int32, indices of the receivers
    lanes : bits of the lanes that have a receiver
    last : pointer to 2 int64, a cache of this function; initialize the first with -1
    """
    scratch = stack_i32(16)
    _sides_of(asking, samples, ids, lanes, scratch)
    sides = load16(scratch, 0)
    valid, asks = bits(sides != np.int32(NOTHING)), np.int64(0)
    count(counters, RAYS, samples.count * popcount(valid))
    faces = gather(asking.query.faces, load16(ids, 0))
    store(scratch, 0, faces)
    while valid != 0:  # receivers on one triangle together
        face, lane, known = np.int64(get(scratch, lowest_bit(valid))), valid & -valid, np.int64(0)
        if face >= 0:
            known = _light_side_again(asking, view, face, last)
        if known == 0:
            valid ^= lane
            asks |= lane if _asks(asking, samples, np.int64(get(ids, lowest_bit(lane))), counters) else np.int64(0)
        else:
            same = valid & bits(faces == np.int32(face))
            valid ^= same
            above = same & bits(sides == np.int32(known))
            asks |= above
            if same != above:
                asks |= _some_ask(asking, view, samples, ids, same & ~above, counters)
    return asks


@inlined
def origins_of(asking, ids):
    """The positions of 16 receivers, a `Vec` of f32x16."""
    at, p = ids * 3, asking.query.origins
    return Vec(gather(p, at), gather(p, at + 1), gather(p, at + 2))
