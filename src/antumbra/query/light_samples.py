"""Light samples: the sample sets of a light, and the sample points that kernels compute from them.

Sampling is interleaved [Keller and Heidrich 2001], as in multi-frusta tracing [Benthin and Wald 2009, Sec. 4.5]: pixel
(x, y) uses set (x mod 4) + 4 (y mod 4) of 16. Each set is well distributed by itself, and the 16 sets of 4 x 4 pixels
together form one fine set of 16 spp samples.

A seed moves all samples: nets by a random digital shift, which keeps them nets, Halton points by a random shift modulo
1 [Cranley and Patterson 1976], and Sobol points by another scrambling. Each sample is then uniform on its domain, so
the mean over seeds converges to the integral. Seed 0 moves nothing.

The "halton" samplers follow CHC+RT [Mattausch et al. 2015, Sec. 5.3]: all sets are the same Halton sequence, rotated
around the normal by a different angle per set on the hemisphere, and shifted on other domains.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.checks import choice, whole_number
from ..kernels.elementary import cos, sin
from ..kernels.jit import inlined, kernel
from ..scene.light_lists import N_SETS, LightList
from ..scene.lights import AMBIENT, DIRECTIONAL, MAX_SPP, SPHERE, Light, LightPatch
from .sobol_sequence import scrambled_sobol

# --- Light samples in kernels -----------------------------------------------------------------------------------------


class Patch(NamedTuple):
    """A light as seen from one receiver: the points base + a u + b v + c w. All fields are float64 scalars."""

    bx: float
    by: float
    bz: float
    ux: float
    uy: float
    uz: float
    vx: float
    vy: float
    vz: float
    wx: float
    wy: float
    wz: float


@inlined
def patch_at(light, x, y, z, nx, ny, nz):
    """The `Patch` of a LightPatch for a receiver at the float32 point (x, y, z).

    (nx, ny, nz): float64, the receiver's unit normal towards the visible side; only AMBIENT uses it.
    """
    b, u, v, w = light.base, light.u, light.v, light.w
    if light.kind == DIRECTIONAL:
        return Patch(x + b[0], y + b[1], z + b[2], u[0], u[1], u[2], v[0], v[1], v[2], w[0], w[1], w[2])
    if light.kind == SPHERE:
        return tangent_disk(b[0], b[1], b[2], light.radius, np.float64(x), np.float64(y), np.float64(z))
    if light.kind == AMBIENT:
        return hemisphere(np.float64(x), np.float64(y), np.float64(z), nx, ny, nz, light.radius)
    return Patch(b[0], b[1], b[2], u[0], u[1], u[2], v[0], v[1], v[2], w[0], w[1], w[2])


@inlined
def hemisphere(x, y, z, nx, ny, nz, r):
    """A patch around (x, y, z) with u and v perpendicular to the unit vector n and w along it, all of length r."""
    (ux, uy, uz), (vx, vy, vz) = tangents64(nx, ny, nz)
    return Patch(x, y, z, r * ux, r * uy, r * uz, r * vx, r * vy, r * vz, r * nx, r * ny, r * nz)


@inlined
def tangents64(nx, ny, nz):
    """Two unit vectors perpendicular to the float64 unit vector n and to each other [Duff et al. 2017]."""
    s = np.copysign(1.0, nz)
    a = -1.0 / (s + nz)
    b = nx * ny * a
    return (1.0 + s * nx * nx * a, s * b, -s * nx), (b, s + ny * ny * a, -ny)


@kernel
def tangent_disk(cx, cy, cz, radius, x, y, z):
    """The `Patch` of a sphere: the disk inside the circle where the tangent cone from (x, y, z) touches it; float64."""
    nx, ny, nz = x - cx, y - cy, z - cz
    distance = np.sqrt(nx * nx + ny * ny + nz * nz)
    if distance > 0.0:
        nx, ny, nz = nx / distance, ny / distance, nz / distance
    else:
        nx, ny, nz = 0.0, 0.0, 1.0
    if distance > radius:  # the tangent circle lies in front of the centre and is smaller than the great circle
        shift = radius * radius / distance
        cx, cy, cz = cx + shift * nx, cy + shift * ny, cz + shift * nz
        radius *= np.sqrt(1.0 - (radius / distance) ** 2)
    r, ((ux, uy, uz), (vx, vy, vz)) = radius, tangents64(nx, ny, nz)
    return Patch(cx, cy, cz, r * ux, r * uy, r * uz, r * vx, r * vy, r * vz, -0.0, -0.0, -0.0)


@inlined
def sample_point(patch, a, b, c):
    """The float32 light sample (a, b, c) of a patch: (((base + a u) + b v) + c w) in float64, rounded once."""
    # Eq. (1) of docs/design/lights.md, Eq. (3) of docs/design/sampling.md
    return (
        np.float32(((patch.bx + a * patch.ux) + b * patch.vx) + c * patch.wx),
        np.float32(((patch.by + a * patch.uy) + b * patch.vy) + c * patch.wy),
        np.float32(((patch.bz + a * patch.uz) + b * patch.vz) + c * patch.wz),
    )


def sample_ends(light: LightPatch, origins: NDArray[np.float32], sets: NDArray[np.float64]) -> NDArray[np.float32]:
    """(n, m, 3) float32: the samples of receivers 0 to n - 1 in a row, as `sample_point`, with sets (16, m, 3).

    origins : (n, 3) float32; the axes of the light do not depend on them: its kind is not SPHERE or AMBIENT
    """
    of_receivers = sets[np.arange(len(origins)) & 3]
    base = origins[:, None] + light.base if light.kind == DIRECTIONAL else light.base
    a, b, c = (of_receivers[..., k, None] * axis for k, axis in enumerate((light.u, light.v, light.w)))
    ends: NDArray[np.float32] = (((base + a) + b) + c).astype(np.float32)
    return ends


# --- Sample sets ------------------------------------------------------------------------------------------------------


def hammersley(n: int) -> np.ndarray:
    """(n, 2) float64: (i + 1/2) / n and the van der Corput radical inverse of i; n is a power of two."""
    # Eq. (2) of docs/design/sampling.md
    i = np.arange(n, dtype=np.uint64)
    return np.stack([(i + 0.5) / n, _radical_inverse(i, _van_der_corput_rows())], 1)


def larcher_pillichshammer(n: int) -> np.ndarray:
    """(n, 2) float64: (i + 1/2) / n, Larcher-Pillichshammer inverse [Kollig and Keller 2002]; n is a power of two."""
    # Eq. (2) of docs/design/sampling.md
    i = np.arange(n, dtype=np.uint64)
    rows = [0]
    for k in range(32):  # v ^= 2**31 >> ... of Kollig and Keller's listing: v | v >> 1
        rows.append(0x80000000 if k == 0 else rows[-1] >> 1 | 0x80000000)
    return np.stack([(i + 0.5) / n, _radical_inverse(i, rows[1:])], 1)


def _van_der_corput_rows() -> list[int]:
    return [0x80000000 >> k for k in range(32)]


def _radical_inverse(i: NDArray[np.uint64], rows: list[int]) -> NDArray[np.floating]:
    out = np.zeros(len(i), np.uint64)
    for k, row in enumerate(rows):
        out ^= np.where(i >> np.uint64(k) & np.uint64(1), np.uint64(row), np.uint64(0))
    return (out + 0.5) / 2.0**32


def halton(n: int) -> np.ndarray:
    """(n, 2) float64 in (0, 1): radical inverses of 1 to n, in base 2 and base 3; any n."""
    i = np.arange(1, n + 1)
    return np.stack([_radical_inverse(i.astype(np.uint64), _van_der_corput_rows()), _inverse_in_base_3(i)], 1)


def _inverse_in_base_3(i: NDArray[np.int64]) -> NDArray[np.float64]:
    out, digit = np.zeros(len(i)), 1.0
    while i.any():
        digit /= 3.0
        out, i = out + digit * (i % 3), i // 3
    return out


def _split_net(points: np.ndarray) -> np.ndarray:
    """Split a (16 m, 2) net into sets (16, m, 2), each with one point per elementary cell, in Z order of the m cells.

    The net has 16 points in each cell, ranked by x. Set k takes the point of rank k, after a permutation of ranks that
    changes the rank's high bits, which determine x, from row to row, and its low bits, which determine y in a digital
    net, from column to column. So the projections of each set onto the axes are well distributed too.
    """
    m = len(points) // N_SETS
    bits = m.bit_length() - 1
    nx, ny = 1 << (bits + 1) // 2, 1 << bits // 2
    column, row = (points * (nx, ny)).astype(int).T
    cell = row * nx + column
    order = np.lexsort((points[:, 0], cell)).reshape(m, N_SETS)  # by cell, then by x
    rows = np.arange(m) // nx
    reverse = sum(((rows >> k) & 1) << (3 - k) for k in range(4))
    pick = np.arange(N_SETS)[:, None] ^ reverse ^ (np.arange(m) % nx & 15)  # (16, m)
    sets: NDArray[np.float64] = points[order[np.arange(m), pick]]
    return sets[:, np.argsort(_z_order(np.arange(m) % nx, rows), kind="stable")]


def _z_order(x: NDArray[np.int64], y: NDArray[np.int64]) -> NDArray[np.int64]:
    bits = (((x >> k) & 1) << (2 * k) | ((y >> k) & 1) << (2 * k + 1) for k in range(6))
    return sum(bits, np.zeros_like(x))


def _scrambled_sobol(spp: int, seed: int) -> np.ndarray:
    size = _power_of_two(spp)
    points = scrambled_sobol(N_SETS * size, 2, seed)
    return points.reshape(N_SETS, size, 2)[:, :spp]  # every aligned block is a net, every prefix well distributed


Sampler = Callable[[int, int], NDArray[np.float64]]
"""A function of spp and seed, which returns sample sets on the square, (16, spp, 2)."""

_DIGITS = 2.0**32  # of a coordinate that is shifted


def _shift_of(seed: int) -> NDArray[np.uint64]:
    """(2,) uint64: the 32-bit shift of each coordinate for a seed."""
    return np.random.default_rng(seed).integers(1 << 32, size=2, dtype=np.uint64)


def _digitally_shifted(sets: NDArray[np.float64], cells: int, seed: int) -> NDArray[np.float64]:
    """(16, m, 2) sets in (0, 1), with the binary digits of a random shift added without carry [Owen 2023, ch. 17].

    This permutes the cells, which are then in Z order again.
    """
    digits = np.floor(sets * _DIGITS).astype(np.uint64) ^ _shift_of(seed)
    bits, shifted = cells.bit_length() - 1, (digits + 0.5) / _DIGITS
    column, row = (shifted[0] * (1 << (bits + 1) // 2, 1 << bits // 2)).astype(int).T
    return np.asarray(shifted[:, np.argsort(_z_order(column, row), kind="stable")], np.float64)


def _net(generate: Callable[[int], NDArray[np.float64]]) -> Sampler:
    def sets(spp: int, seed: int) -> NDArray[np.float64]:
        size = _power_of_two(spp)
        split = _split_net(generate(N_SETS * size))
        if spp < size:  # keep a well-distributed subset: cells in bit-reversed Z order
            bits = size.bit_length() - 1
            i = np.arange(size)
            reverse = sum(((i >> k) & 1) << (bits - 1 - k) for k in range(bits))
            split = split[:, np.sort(np.argsort(reverse, kind="stable")[:spp])]
        return _digitally_shifted(split, size, seed) if seed else split

    return sets


_DITHER = np.array([0, 8, 2, 10, 12, 4, 14, 6, 3, 11, 1, 9, 15, 7, 13, 5])
"""The stratum of each set, out of 16: any 2 x 2 pixels contain one stratum from each quarter [Bayer 1973]."""

ROTATIONS: dict[str, float] = {
    "halton": 36.0,
    "halton:0": 0.0,
    "halton:18": 18.0,
    "halton:36": 36.0,
    "halton:full": 360.0,
}
"""Sampler -> largest rotation of its sets on a hemisphere, in degrees; the paper uses 36 for 20 samples."""


def _shifted_halton(degrees: float) -> Sampler:
    """Cranley-Patterson rotation of the Halton sequence on the square, with offsets of up to degrees / 360."""

    def sets(spp: int, seed: int) -> np.ndarray:
        offsets = degrees / 360.0 * larcher_pillichshammer(N_SETS)[_DITHER, None]
        return _wrapped(_shifted(halton(spp), seed) + offsets)

    return sets


def _shifted(points: np.ndarray, seed: int) -> np.ndarray:
    return _wrapped(points + _shift_of(seed) / _DIGITS) if seed else points


def _wrapped(points: np.ndarray) -> np.ndarray:
    return np.maximum(points % 1.0, 2.0**-33)  # never 0: the square is open


def _rotated_halton(n: int, degrees: float, seed: int) -> np.ndarray:
    """(16, n, 3): one Halton sequence on the hemisphere, rotated around the axis by a stratified angle per set."""
    a, b, c = to_domain(_shifted(halton(n), seed), "hemisphere").T
    angle = np.radians(degrees) * ((_DITHER + 0.5) / N_SETS)[:, None]
    x, y = a * cos(angle) - b * sin(angle), a * sin(angle) + b * cos(angle)
    return np.stack([x, y, np.broadcast_to(c, x.shape)], -1)


def _power_of_two(n: int) -> int:
    return 1 << (n - 1).bit_length()


SAMPLERS: dict[str, Sampler] = {
    "larcher-pillichshammer": _net(larcher_pillichshammer),
    "hammersley": _net(hammersley),
    "sobol": _scrambled_sobol,
    **{name: _shifted_halton(degrees) for name, degrees in ROTATIONS.items()},
}


def sample_sets(spp: int, sampler: str = "larcher-pillichshammer", seed: int = 0) -> np.ndarray:
    """(16, spp, 2) float64 in (0, 1): the sample sets of a 4x4 pixel pattern, on the square.

    Parameters
    ----------
    spp : int
        Samples per set, 1 to 1024.
    sampler : str
        A name in `SAMPLERS`.
    seed : int
        The same seed gives the same samples.

    Raises
    ------
    InputError
        On an unknown sampler or spp out of range.
    """
    spp = whole_number(spp, "spp", 1, MAX_SPP)
    choice(sampler, "sampler", SAMPLERS)
    return np.ascontiguousarray(SAMPLERS[sampler](spp, seed))


def light_samples(light: Light, spp: int, sampler: str = "larcher-pillichshammer", seed: int = 0) -> np.ndarray:
    """(16, n, 3) float64, (a, b, c): the sample sets of a light; n = ``light.samples(spp)``.

    The lights of a list are its samples: `LightList.drawn` applies the seed to them.
    """
    choice(sampler, "sampler", SAMPLERS)  # before the lookup among cached sets
    sets = domain_sets(light.samples(whole_number(spp, "spp", 1, MAX_SPP)), sampler, light.domain, seed)
    if isinstance(light, LightList):  # (a, b, c): world position of a near light, direction towards a distant one
        return np.ascontiguousarray(light.points[light.sets])
    return sets


@lru_cache(64)
def domain_sets(n: int, sampler: str, domain: str, seed: int = 0, ray: int = 0) -> np.ndarray:
    """(16, n, 3) float64: the sample sets on a domain, see `to_domain`. Raises the errors of `sample_sets`.

    A seed gives the hemisphere other shifts than light surfaces, and each `ray` along a path other ones: bounced light
    combines their samples, which a common shift would leave correlated for all seeds. The result is cached: do not
    write to it.
    """
    if seed and domain == "hemisphere":
        seed = int(np.random.SeedSequence([seed, 1 + ray]).generate_state(1, np.uint64)[0])
    square = sample_sets(n, sampler, seed)
    if domain == "hemisphere" and sampler in ROTATIONS:
        return _rotated_halton(n, ROTATIONS[sampler], seed)
    return to_domain(square, domain)


def to_domain(square: np.ndarray, domain: str) -> np.ndarray:
    """Map samples (..., 2) of the unit square to points (..., 3) of a light's domain.

    "square": (a, b, 0), unchanged; "disk": radius 1, uniform in area; "point": (0, 0, 0); "hemisphere": the points of
    the disk, projected up to the unit sphere, with cosine density around the axis [Malley's method].
    """
    a, b = _concentric(square) if domain in ("disk", "hemisphere") else (square[..., 0], square[..., 1])
    if domain == "point":
        return np.zeros((*square.shape[:-1], 3))
    height = np.sqrt(np.maximum(1.0 - a * a - b * b, 0.0)) if domain == "hemisphere" else np.zeros_like(a)
    return np.stack([a, b, height], -1)


def _concentric(square: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Map the unit square to the unit disk by Shirley and Chiu's map, which keeps cells compact."""
    x, y = 2.0 * square[..., 0] - 1.0, 2.0 * square[..., 1] - 1.0
    wide = np.abs(x) > np.abs(y)
    r = np.where(wide, x, y)
    with np.errstate(invalid="ignore", divide="ignore"):
        angle = np.where(wide, np.pi / 4 * (y / x), np.pi / 2 - np.pi / 4 * (x / y))
    angle = np.where(r == 0.0, 0.0, angle)
    return r * cos(angle), r * sin(angle)
