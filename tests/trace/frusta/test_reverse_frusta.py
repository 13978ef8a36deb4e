"""Fans, the frusta from points on the light to the receivers of several tiles: none that meets a box is missed."""

from typing import NamedTuple

import numpy as np

from antumbra.kernels.jit import F32Ptr, I32Ptr, kernel
from antumbra.kernels.simd import as_i32, ptr, ptr_at
from antumbra.kernels.vec3 import rows
from antumbra.trace.frusta.reverse_frusta import (
    FAN_FLOATS,
    add_to_reverse_frusta,
    close_reverse_frusta,
    reverse_frusta_at,
    reverse_frusta_in_box,
    unblocked_rays,
)
from antumbra.trace.shafts import box_at


class Receivers(NamedTuple):
    """What fans read of a tile."""

    origins: F32Ptr
    faces: I32Ptr


@kernel
def _make_fans(origins, faces, low, high, memory):
    fans = reverse_frusta_at(ptr(memory))
    for k in range(16):
        add_to_reverse_frusta(fans, k, Receivers(ptr_at(ptr(origins), 48 * k), ptr_at(ptr(faces), 16 * k)))
    close_reverse_frusta(fans, rows(ptr(low), 0, 16), rows(ptr(high), 0, 16))


@kernel
def _fans_in_box(memory, points, bounds):
    return reverse_frusta_in_box(reverse_frusta_at(ptr(memory)), ptr(points), box_at(ptr(bounds)))


@kernel
def _unblocked(dead, r):
    return unblocked_rays(as_i32(ptr(dead)), r)


def fans(rng):
    """(receivers (16 tiles, 3, 16 fans), their faces, memory of the fans)."""
    origins = rng.uniform(-1, 1, (16, 3, 16)).astype(np.float32)
    faces, memory = rng.integers(0, 99, (16, 16)).astype(np.int32), np.zeros(FAN_FLOATS, np.float32)
    _make_fans(origins, faces, origins.min(0), origins.max(0), memory)
    return origins, faces, memory


def test_fans_hold_one_receiver_of_each_tile():
    origins, faces, memory = fans(np.random.default_rng(1))
    np.testing.assert_array_equal(memory[: 16 * 48].reshape(16, 3, 16), origins.transpose(2, 1, 0))
    held = memory[16 * 48 : 16 * 48 + 256].view(np.int32).reshape(16, 16)
    np.testing.assert_array_equal(held, faces.T)


def test_no_fan_that_meets_a_box_is_missed():
    rng, found, missed = np.random.default_rng(2), 0, 0
    origins, _, memory = fans(rng)
    points = (rng.uniform(-4, 4, (3, 16)) + np.array([[0], [8], [0]])).astype(np.float32)
    for _ in range(500):
        middle, half = rng.uniform((-4, 0, -4), (4, 8, 4)).astype(np.float32), rng.uniform(0.02, 0.5, 3)
        half = half.astype(np.float32)
        bounds = np.array([*middle, 0, *half, 0], np.float32)
        told = _fans_in_box(memory, points, bounds) >> np.arange(16) & 1 != 0
        d, p = (origins - points).astype(float), points.astype(float)
        t = np.stack([(middle - half)[:, None] - p, (middle + half)[:, None] - p])[:, None] / d
        met = np.maximum(t.min(0).max(1), 0) <= np.minimum(t.max(0).min(1), 1)  # (tiles, fans)
        assert told[met.any(0)].all()
        found, missed = found + met.any(0).sum(), missed + (~told).sum()
    assert found > 100 and missed > 1000


def test_unblocked_rays_of_a_fan():
    dead = np.random.default_rng(3).integers(0, 1 << 16, 16).astype(np.int32)
    for r in range(16):
        assert _unblocked(dead, r) == sum(1 << k for k in range(16) if not dead[k] >> r & 1)
