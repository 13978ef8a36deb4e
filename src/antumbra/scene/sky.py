"""Skies: distant light from all directions, from an environment map (Radiance .hdr or OpenEXR) or a daylight model.

A `Sky` lights the scene as a list of directional lights drawn from its map by importance sampling, and it is the
background of pictures.
"""

import os
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.checks import as_array, choice, flag, number, path_of, unit_vectors, whole_number
from ..base.errors import InputError
from ..base.extras import import_extra
from ..base.files import checked_file, without_output
from ..base.memory import check_reading
from ..base.pickles import without_cached
from ..kernels.elementary import cos, exp2, power, sin
from ..kernels.small_matrices import dot, product, tangents_of
from .camera import axes
from .light_lists import N_SETS, LightList
from .lights import DIRECTIONAL, MAX_SPP, Light, LightPatch, check_distance
from .rough_mirrors import ROUGHNESSES, mirror_cone

# --- Environment map files: Radiance .hdr and OpenEXR -----------------------------------------------------------------


ENVIRONMENT_SUFFIXES = (".hdr", ".exr")
_PIXEL_BYTES = 100  # of memory while a map is read: as stored, as float64, and while these are combined
_CHANNEL_BYTES = 8  # of memory per pixel for each channel of an EXR file
_LEAST_ROW, _LONGEST_RUN = 4, 127  # of run-length encoded rows: bytes before the runs, and pixels


def read_environment(path: Path) -> np.ndarray:
    """The linear radiance of an environment map file, (h, w, 3) float64.

    Raises
    ------
    InputError
        If the file is missing, damaged or of another format, or holds light that is negative or not finite.
    """
    checked_file(path, path.name)
    readers = {".hdr": _read_hdr, ".exr": _read_exr}
    if path.suffix.lower() not in readers:
        raise InputError(f"{path.name}: a sky must be one of {', '.join(ENVIRONMENT_SUFFIXES)}; convert it")
    if path.suffix.lower() == ".exr":
        import_extra("OpenEXR", path.name, "exr")
    try:
        with without_output():
            image = readers[path.suffix.lower()](path)
    except InputError:
        raise
    except Exception as error:  # libraries raise various exceptions for bad files
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise InputError(f"{path.name}: cannot be read ({reason}); is the file damaged?") from error
    if not np.isfinite(image).all() or (image < 0.0).any():
        raise InputError(f"{path.name}: holds light that is negative or not finite; a sky must have neither")
    return image.astype(np.float64)


def _read_exr(path: Path) -> np.ndarray:
    import OpenEXR

    with OpenEXR.File(str(path), header_only=True) as file:
        (x0, y0), (x1, y1) = (np.asarray(corner, np.float64) for corner in file.header()["dataWindow"])
        _check_size(x1 - x0 + 1.0, y1 - y0 + 1.0, path, len(file.header().get("channels", ())))
    with OpenEXR.File(str(path), separate_channels=True) as file:
        channels = file.channels()
        missing = [name for name in "RGB" if name not in channels]
        if missing:
            raise ValueError(f"it has no channel {missing[0]}")
        return np.stack([channels[name].pixels for name in "RGB"], -1)


def _read_hdr(path: Path) -> np.ndarray:
    """The radiance in a Radiance file of RGBE pixels, plain or run-length encoded."""
    data = path.read_bytes()
    header, blank, body = data.partition(b"\n\n")
    size, _, body = body.partition(b"\n")
    words = size.split()
    if not header.startswith((b"#?RADIANCE", b"#?RGBE")) or not blank or len(words) != 4:
        raise ValueError("not a Radiance picture")
    if words[0] != b"-Y" or words[2] != b"+X":
        raise ValueError("its rows do not run from top to bottom and left to right")
    h, w = int(words[1]), int(words[3])
    if h <= 0 or w <= 0 or h * (_LEAST_ROW + 8 * -(-w // _LONGEST_RUN)) > len(body) < 4 * h * w:
        raise ValueError(f"{w}x{h} pixels do not fit in {len(body)} bytes")
    _check_size(float(w), float(h), path)
    rgbe = _rows(np.frombuffer(body, np.uint8), h, w).astype(np.float64)
    return np.where(rgbe[..., 3:] > 0, (rgbe[..., :3] + 0.5) * exp2(rgbe[..., 3:] - 136.0), 0.0)


def _check_size(w: float, h: float, path: Path, channels: int = 0) -> None:
    size = w * h * (_PIXEL_BYTES + _CHANNEL_BYTES * channels)
    check_reading(size, f"{path.name}: an image of {w:.0f} x {h:.0f} pixels", path.stat().st_size)


def _rows(data: np.ndarray, h: int, w: int) -> NDArray[np.uint8]:
    """(h, w, 4) uint8: the RGBE pixels, with run-length encoded rows expanded."""
    if not (8 <= w < 32768 and data[:4].tolist() == [2, 2, w >> 8, w & 255]):
        return data[: 4 * h * w].reshape(h, w, 4)
    out, at = np.empty((h, 4, w), np.uint8), 0
    for row in out:
        if data[at : at + 4].tolist() != [2, 2, w >> 8, w & 255]:
            raise ValueError("a row does not begin with its length")
        at += 4
        for channel in row:
            x = 0
            while x < w:
                n = int(data[at])
                run = n - 128 if n > 128 else n
                if not 0 < run <= w - x:
                    raise ValueError("a run is longer than its row")
                channel[x : x + run] = data[at + 1] if n > 128 else data[at + 1 : at + 1 + run]
                at, x = at + (2 if n > 128 else 1 + run), x + run
    return out.transpose(0, 2, 1)


# --- Skies ------------------------------------------------------------------------------------------------------------


_HEIGHT = 64  # rows of the built-in maps (soft daylight and uniform colours)
_ZENITH, _HORIZON, _GROUND = np.array([[0.46, 0.63, 0.92], [0.92, 0.94, 0.97], [0.60, 0.59, 0.57]])
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
_LONGEST = 1e18  # length of a direction whose square float32 still holds
_STEP = (np.sqrt(5.0) - 1.0) / 2.0  # the golden ratio's fraction: (i + 0.5) / n and i * _STEP fill the square evenly


def _check_count(count: int, interleave: bool) -> None:
    flag(interleave, "Sky interleave")
    whole_number(count, "Sky count", 1, MAX_SPP * (N_SETS if interleave else 1))


@dataclass(frozen=True, eq=False)
class Sky(LightList):
    """A distant environment that lights the scene from all directions, and the background where no surface is visible.

    The environment is importance-sampled as a list of `count` distant lights of equal power, each with exact
    visibility. In pictures, the lights are distributed over the 16 sample sets, so that each pixel tests a sixteenth of
    them, and the filter of `render` averages the sets.

    The environment is a full sphere, including everything below the horizon. The `visibility` of a uniform sky from an
    open floor is therefore 0.5: half of the lights, which have equal power, are below it. Use `sky_view` for the
    visible fraction of the sky above the horizon.

    image : None, (3,) or (h, w, 3) float, or a path
        None: soft daylight, bluish above the horizon and grey below. A colour: a uniform sky. An array: an
        equirectangular map of linear radiance with the zenith in its first row and the direction -z (+y if z points up)
        in its middle column; columns further right lie further to the right. A path: the .hdr or .exr file of such a
        map.
    up : "y", "z" or None
        The axis that points to the zenith. None: the scene's up axis.
    turn : float
        Rotation of the map around this axis in degrees, counter-clockwise seen from above.
    count : int
        Number of lights, 1 to 16384; multiples of 16 waste none. The mean error of the irradiance in default pictures
        is 3 % with 256 lights and half of that with 512; small pictures are less accurate (see docs/lights.md).

    Examples
    --------
    >>> overcast = at.Sky((0.8, 0.9, 1.0), intensity=10_000, count=512)
    >>> overcast.radiance([0, 1, 0])
    array([ 8000.,  9000., 10000.], dtype=float32)
    """

    image: Any = None
    up: str | None = field(default=None, kw_only=True)
    turn: float = field(default=0.0, kw_only=True)
    count: int = field(default=256, kw_only=True)
    interleave: bool = field(default=True, kw_only=True)
    map: np.ndarray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        choice(self.up, "Sky up", ("y", "z", None))
        number(self.turn, "Sky turn (degrees)")
        _check_count(self.count, self.interleave)
        object.__setattr__(self, "map", _map_of(self.image))
        self._check()

    def __getstate__(self) -> dict[str, Any]:
        return without_cached(self)

    @cached_property
    def _map_lights(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return _sample_map(self.map, self.count, self.seed)

    @cached_property
    def points(self) -> NDArray[np.float64]:
        """(count, 3) float64: unit vectors towards the lights, the samples (a, b, c)."""
        return product(self._map_lights[0], self.axes)

    @property
    def intensities(self) -> NDArray[np.float64]:
        """(count,) float64: lux of each light, times `intensity`."""
        return self._map_lights[1]

    @property
    def colours(self) -> NDArray[np.float64]:
        """(count, 3) float64: the colour of each light, of luminance 1, times `colour`."""
        return self._map_lights[2]

    def upright(self, up: str) -> Light:
        return self if self.up else replace(self, image=self.map, up=up).named(self.name)

    def resampled(self, count: int, interleave: bool = True) -> "Sky":
        """The same sky as `count` lights. The map is shared: no file is read again. `InputError`: as for `Sky`."""
        _check_count(count, interleave)
        sky = copy(self)  # without cached lights, as a pickle
        object.__setattr__(sky, "count", count)
        object.__setattr__(sky, "interleave", interleave)
        return sky

    def patch(self, origin: NDArray[np.float64], reach: float) -> LightPatch:
        check_distance(reach, "Sky", "make the scene smaller")
        u, v, w = reach * np.eye(3)
        return LightPatch(DIRECTIONAL, np.zeros(3), u, v, w, 0.0)

    def radiance(self, directions: np.ndarray) -> NDArray[np.float32]:
        """(..., 3) float32: linear radiance along directions, bilinear between pixels of the image.

        directions : (..., 3) float, world, any length
        """
        directions = as_array(directions, "directions")
        if directions.ndim < 1 or directions.shape[-1] != 3:
            raise InputError(f"directions must have shape (..., 3), not {directions.shape}")
        if directions.dtype != np.float32 and not (np.abs(directions) < _LONGEST).all():
            directions = unit_vectors(directions, "direction")
        x, y, z = np.moveaxis(directions.astype(np.float32), -1, 0)
        # Not `@`: BLAS threads would spin for a tenth of a second, regardless of the caller's `threads`
        right, upward, back = (x * a + y * b + z * c for a, b, c in self.axes.astype(np.float32))
        h, w = self.map.shape[:2]
        down = _angle(np.sqrt(right * right + back * back), upward) * np.float32(h / np.pi) - np.float32(0.5)
        out = np.empty((*down.shape, 3), np.float32)
        if self._level:
            for c in range(3):
                out[..., c] = np.interp(down, np.arange(h), self._scaled_map[:, 0, c])
            return out
        across = (_angle(right, -back) * np.float32(0.5 / np.pi) + np.float32(0.5)) * w - np.float32(0.5)
        y, x = np.floor(down), np.floor(across)
        fy, fx = (down - y)[..., None], (across - x)[..., None]
        rows = [np.clip(y + k, 0, h - 1).astype(np.int32) for k in (0, 1)]
        columns = [(x.astype(np.int32) + k) % w for k in (0, 1)]
        (a, b), (c, d) = ([self._scaled_map[r, k] for k in columns] for r in rows)
        result: NDArray[np.float32] = (a + fx * (b - a)) * (1 - fy) + (c + fx * (d - c)) * fy
        return result

    @property
    def is_daylight(self) -> bool:
        """Whether the map is the built-in soft daylight."""
        return np.array_equal(self.map, _daylight())

    @cached_property
    def _level(self) -> bool:
        """Whether all columns of the map are equal, so that radiance depends on the elevation alone."""
        return bool((self.map == self.map[:, :1]).all())

    @cached_property
    def _scaled_map(self) -> np.ndarray:
        return (self.map * (self.intensity * np.asarray(self.colour))).astype(np.float32)

    @property
    def radiance_map(self) -> NDArray[np.float32]:
        """(h, w, 3) float32: the map times intensity and colour, of one column if all are equal."""
        return np.ascontiguousarray(self._scaled_map[:, :1]) if self._level else self._scaled_map

    @cached_property
    def blurred(self) -> tuple["Sky", ...]:
        """The sky as surfaces of the roughnesses `ROUGHNESSES` mirror it."""
        if self._level and (self.map == self.map[:1]).all():
            return (self,) * len(ROUGHNESSES)
        return (self, *(self._with_map(blurred_map(self.map, r)) for r in ROUGHNESSES[1:]))

    def _with_map(self, image: np.ndarray) -> "Sky":
        sky = copy(self)
        object.__setattr__(sky, "map", image)
        return sky

    @cached_property
    def axes(self) -> NDArray[np.float64]:
        """(3, 3) float64: the map's right, up and backward axes in world space, as rows."""
        right, upward, back = axes(self.up or "y")
        turn = np.radians(self.turn)
        sideways = cos(turn) * right - sin(turn) * back
        return np.stack([sideways, upward, np.cross(sideways, upward)])


def _map_of(image: object) -> np.ndarray:
    """The (h, w, 3) float64 map for the argument `image` of `Sky`."""
    if image is None:
        return _daylight()
    if isinstance(image, (str, os.PathLike)):
        return read_environment(path_of(image, "Sky image"))
    array = as_array(image, "Sky image").astype(np.float64)
    if array.shape == (3,):
        array = np.broadcast_to(array, (_HEIGHT, 1, 3))
    if array.ndim != 3 or array.shape[2] != 3 or not array.size:
        raise InputError(f"Sky image must be a colour (3,), or a map (h, w, 3), not {array.shape}")
    if not (np.isfinite(array).all() and (array >= 0.0).all()):
        raise InputError("Sky image must be finite and not negative")
    return array


_BLURRED = 32  # rows of blurred maps
_BLUR_RAYS = 256  # of each of their texels


def blurred_map(image: np.ndarray, roughness: float) -> NDArray[np.float64]:
    """(32, 64, 3) float64, or (32, 1, 3) if all columns are equal: the map as rough surfaces mirror it.

    Each texel is the mean over a GGX lobe around its direction, which is seen and reflected perpendicularly, weighted
    by the cosine [Karis 2013].
    """
    image = _shrunk(image, 2 * _BLURRED)
    level = (image == image[:, :1]).all()
    h, w = _BLURRED, 1 if level else 2 * _BLURRED
    down, across = np.pi * (np.arange(h) + 0.5) / h, 2.0 * np.pi * ((np.arange(w) + 0.5) / w - 0.5)
    sine = sin(down)[:, None]
    middle = np.stack(
        [sine * sin(across), np.broadcast_to(cos(down)[:, None], (h, w)), -sine * cos(across)], -1
    ).reshape(-1, 3)
    i = np.arange(_BLUR_RAYS)
    cone = mirror_cone(roughness, np.stack([(i + 0.5) / _BLUR_RAYS, _STEP * i % 1.0], -1))
    source, out, (u, v) = Sky(image, up="y"), np.zeros((h * w, 3)), tangents_of(middle)
    for rays in np.split(cone[:, :, None, None], _BLUR_RAYS // 16):
        out += (rays[:, 2] * source.radiance(rays[:, 0] * u + rays[:, 1] * v + rays[:, 2] * middle)).sum(0)
    return np.asarray((out / cone[:, 2].sum()).reshape(h, w, 3))


def _shrunk(image: np.ndarray, rows: int) -> np.ndarray:
    """A map of at most so many rows and twice as many columns: means over blocks."""
    for axis, most in ((0, rows), (1, 2 * rows)):
        if (n := image.shape[axis]) > most:
            edges = np.arange(most) * n // most
            counts = np.diff(np.append(edges, n)).reshape((-1, 1, 1) if axis == 0 else (1, -1, 1))
            image = np.add.reduceat(image, edges, axis) / counts
    return image


def _angle(y: NDArray[np.float32], x: NDArray[np.float32]) -> NDArray[np.float32]:
    """``atan2(y, x)`` in float32, within 5e-7, with the same bits everywhere [Moshier 1989]."""
    one, quarter = np.float32(1.0), np.float32(np.pi / 4.0)
    across, up = np.abs(x), np.abs(y)
    large, small = np.maximum(across, up), np.minimum(across, up)
    middle = small > large * np.float32(0.41421356)  # beyond 22.5 degrees
    t = np.where(middle, small - large, small)
    t /= np.maximum(np.where(middle, small + large, large), np.float32(1e-30))
    z = t * t
    p = z * np.float32(8.05374449538e-2) - np.float32(1.38776856032e-1)
    p = (p * z + np.float32(1.99777106478e-1)) * z - np.float32(3.33329491539e-1)
    angle = np.where(middle, quarter, np.float32(0.0)) + (p * z + one) * t
    angle = np.where(up > across, 2 * quarter - angle, angle)
    angle = np.where(x < 0, 4 * quarter - angle, angle)
    out: NDArray[np.float32] = np.copysign(angle, y)
    return out


def _daylight() -> NDArray[np.float64]:
    """A clear sky, brighter towards the horizon, over a grey ground."""
    height = cos(np.pi * (np.arange(_HEIGHT) + 0.5) / _HEIGHT)[:, None]  # sine of the elevation
    above = _HORIZON + (_ZENITH - _HORIZON) * power(np.clip(height, 0.0, 1.0), 0.6)
    share = np.clip(-height / 0.35, 0.0, 1.0)
    below = _HORIZON + (_GROUND - _HORIZON) * share * share * (3.0 - 2.0 * share)
    out: NDArray[np.float64] = np.where(height >= 0.0, above, below)[:, None]
    return out


def with_rays(light: Light, spp: int) -> Light:
    """The light with at least as many rays from each pixel as others have: a sky of more distant lights, if need be."""
    if not isinstance(light, Sky) or not light.interleave:
        return light
    return light.resampled(max(light.count, N_SETS * spp))


def sky_directions(count: int, up: str) -> NDArray[np.float64]:
    """(count, 3) float64: unit vectors on Vogel's spiral lifted to the hemisphere, each for an equal share of sky."""
    i = np.arange(count)
    height, angle = (i + 0.5) / count, i * np.pi * (3.0 - np.sqrt(5.0))
    width = np.sqrt(1.0 - height * height)
    east, north = width * cos(angle), width * sin(angle)
    return np.stack([east, north, height] if up == "z" else [east, height, -north], axis=1)


def _sample_map(image: np.ndarray, count: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """`count` lights of a map, in its frame: unit directions (n, 3), lux (n,), and colours (n, 3) of luminance 1.

    Inverse-transform sampling of the marginal row power and then of the conditional column power, at the points of a
    low-discrepancy sequence, which a seed other than 0 shifts at random. All lights therefore have equal power. A black
    map gives lights of intensity 0.
    """
    h, w = image.shape[:2]
    edges = cos(np.pi * np.arange(h + 1) / h)
    solid = (2.0 * np.pi / w) * (edges[:-1] - edges[1:])[:, None]  # solid angle of a texel
    power = dot(image, _LUMINANCE) * solid
    total = power.sum()
    if not total > 0.0:
        power, total = np.broadcast_to(solid, (h, w)), 0.0
    shift = np.random.default_rng(seed).random(2) if seed else (0.5, 0.5)
    a, b = (((np.arange(count) + shift[0]) / count), (shift[1] + _STEP * np.arange(count)) % 1.0)
    y, fy = _invert_cumulative(power.sum(1)[None], np.zeros(count, int), a)
    x, fx = _invert_cumulative(power, y, b)
    cosine = edges[y] + fy * (edges[y + 1] - edges[y])
    angle = 2.0 * np.pi * ((x + fx) / w - 0.5)
    sine = np.sqrt(np.maximum(1.0 - cosine * cosine, 0.0))
    colour = image[y, x]
    luminance = dot(colour, _LUMINANCE)[:, None]
    colour = np.divide(colour, luminance, out=np.ones_like(colour), where=luminance > 0.0)
    directions = np.stack([sine * sin(angle), cosine, -sine * cos(angle)], 1)
    return directions, np.full(count, total / count), colour


def _invert_cumulative(weights: np.ndarray, row: np.ndarray, share: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(index, fraction within it) where the cumulative sum of a row of weights reaches a share of its total."""
    sums = np.concatenate([np.zeros((len(weights), 1)), np.cumsum(weights, 1)], 1)
    sums /= np.where(sums[:, -1:] > 0.0, sums[:, -1:], 1.0)  # black rows are never sampled
    index = np.empty(len(row), int)
    for r in np.unique(row):
        members = row == r
        index[members] = np.searchsorted(sums[r], share[members], "right") - 1
    index = np.clip(index, 0, weights.shape[1] - 1)
    low, high = sums[row, index], sums[row, index + 1]
    return index, np.clip((share - low) / np.where(high > low, high - low, 1.0), 0.0, 1.0)
