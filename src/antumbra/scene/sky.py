"""Skies: light from every direction, from an environment map (Radiance .hdr or OpenEXR) or a daylight model.

A sky lights the scene and is the background of pictures.
"""

import os
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ..checks import as_array, choice, flag, number, path_of, unit_vectors, whole_number
from ..errors import InputError
from ..files import checked_file, without_output
from .camera import axes
from .light_lists import N_SETS, LightList
from .lights import DIRECTIONAL, MAX_SPP, LightPatch, check_distance

# --- Environment maps in files: Radiance .hdr and OpenEXR -------------------------------------------------------------


ENVIRONMENT_SUFFIXES = (".hdr", ".exr")
_MOST_PIXELS = 1 << 27


def read_environment(path: Path) -> np.ndarray:
    """The (h, w, 3) float64 linear radiance of a map.

    Raises
    ------
    InputError
        If the file is missing, of another kind or damaged, or holds no finite positive light.
    """
    checked_file(path, path.name)
    readers = {".hdr": _read_hdr, ".exr": _read_exr}
    if path.suffix.lower() not in readers:
        raise InputError(f"{path.name}: a sky is read from one of {', '.join(ENVIRONMENT_SUFFIXES)}; convert it")
    try:
        with without_output():
            image = readers[path.suffix.lower()](path)
    except Exception as error:  # libraries raise various exceptions for bad files
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise InputError(f"{path.name}: cannot be read ({reason}); is the file damaged?") from error
    if not np.isfinite(image).all() or (image < 0.0).any():
        raise InputError(f"{path.name}: holds light that is negative or not finite; a sky must have neither")
    return image.astype(np.float64)


def _read_exr(path: Path) -> np.ndarray:
    import OpenEXR

    with OpenEXR.File(str(path), separate_channels=True) as file:
        channels = file.channels()
        missing = [name for name in "RGB" if name not in channels]
        if missing:
            raise ValueError(f"it has no channel {missing[0]}")
        return np.stack([channels[name].pixels for name in "RGB"], -1)


def _read_hdr(path: Path) -> np.ndarray:
    """RGBE pixels, plain or with run lengths."""
    data = path.read_bytes()
    header, blank, rest = data.partition(b"\n\n")
    size, _, rest = rest.partition(b"\n")
    words = size.split()
    if not header.startswith((b"#?RADIANCE", b"#?RGBE")) or not blank or len(words) != 4:
        raise ValueError("no Radiance picture")
    if words[0] != b"-Y" or words[2] != b"+X":
        raise ValueError("its rows do not run from top to bottom and left to right")
    h, w = int(words[1]), int(words[3])
    if not 0 < h * w <= _MOST_PIXELS:
        raise ValueError(f"{w}x{h} pixels")
    rgbe = _rows(np.frombuffer(rest, np.uint8), h, w).astype(np.float64)
    return np.where(rgbe[..., 3:] > 0, (rgbe[..., :3] + 0.5) * np.exp2(rgbe[..., 3:] - 136.0), 0.0)


def _rows(data: np.ndarray, h: int, w: int) -> np.ndarray:
    """(h, w, 4) uint8: the pixels of the rows."""
    if not (8 <= w < 32768 and data[:4].tolist() == [2, 2, w >> 8, w & 255]):
        return data[: 4 * h * w].reshape(h, w, 4)
    out, at = np.empty((h, 4, w), np.uint8), 0
    for row in out:
        if data[at : at + 4].tolist() != [2, 2, w >> 8, w & 255]:
            raise ValueError("a row does not begin with its length")
        at += 4
        for part in row:
            x = 0
            while x < w:
                n = int(data[at])
                run = n - 128 if n > 128 else n
                if not 0 < run <= w - x:
                    raise ValueError("a run is longer than its row")
                part[x : x + run] = data[at + 1] if n > 128 else data[at + 1 : at + 1 + run]
                at, x = at + (2 if n > 128 else 1 + run), x + run
    return out.transpose(0, 2, 1)


# --- A sky: light from everywhere, from an environment map, and the background of pictures ----------------------------


_HEIGHT = 64  # rows of the maps of the soft daylight and of colours
_ZENITH, _HORIZON, _GROUND = np.array([[0.46, 0.63, 0.92], [0.92, 0.94, 0.97], [0.60, 0.59, 0.57]])
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
_LONGEST = 1e18  # of a direction: float32 holds its square
_STEP = (np.sqrt(5.0) - 1.0) / 2.0  # of the golden ratio: with (i + 0.5) / n, it fills the square evenly


@dataclass(frozen=True, eq=False)
class Sky(LightList):
    """A distant environment: it lights the scene from all directions, and is seen where a picture shows no surface.

    It is sampled as a list of `count` distant lights of equal power, drawn from the environment by importance. So the
    visibility of each light is exact. In pictures the lights are dealt to the 16 sample sets: each pixel tests a
    sixteenth of them. The filter of `render` averages the sets.

    It is a whole sphere, and what lies below the horizon is part of it. So `visibility` of a uniform sky from an open
    floor is 0.5: of the lights of equal power, half are below. For the share of the sky that points see, there is
    `sky_view`.

    image : None, (3,) or (h, w, 3) float, or a path
        None: a soft daylight, bluish above and grey below the horizon. A colour is a uniform sky. An array is an
        equirectangular map of linear radiance: its first row is the zenith, its middle column is the direction -z
        (if z points up: +y), and columns to the right lie to the right. A path names such a map: .hdr or .exr.
    up : "y", "z" or None
        The axis that points to the zenith. None: the one that points up in the scene.
    turn : float
        Degrees by which the map is turned around this axis, counter-clockwise seen from above.
    count : int
        Number of lights, 1 to 16384; a multiple of 16 wastes none. The irradiance of default pictures is off by 3 % on
        average with 256 lights, and by half of this with 512; small pictures are less accurate (see docs/lights.md).
    """

    image: Any = None
    up: str | None = field(default=None, kw_only=True)
    turn: float = field(default=0.0, kw_only=True)
    count: int = field(default=256, kw_only=True)
    interleave: bool = field(default=True, kw_only=True)
    map: np.ndarray = field(init=False, repr=False)

    def __post_init__(self):
        choice(self.up, "Sky up", ("y", "z", None))
        number(self.turn, "Sky turn (degrees)")
        flag(self.interleave, "Sky interleave")
        whole_number(self.count, "Sky count", 1, MAX_SPP * (N_SETS if self.interleave else 1))
        object.__setattr__(self, "map", _map_of(self.image))
        self._check()

    @cached_property
    def _drawn(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return _draw(self.map, self.count)

    @cached_property
    def points(self) -> np.ndarray:
        """(count, 3) float64: unit vectors towards the lights, the samples (a, b, c)."""
        return self._drawn[0] @ self._frame

    @property
    def intensities(self) -> np.ndarray:
        """(count,) float64: lux of each light, times `intensity`."""
        return self._drawn[1]

    @property
    def colours(self) -> np.ndarray:
        """(count, 3) float64: the colour of each light, of luminance 1, times `colour`."""
        return self._drawn[2]

    def upright(self, up):
        return self if self.up else replace(self, image=self.map, up=up).named(self.name)

    def patch(self, origin, reach):
        check_distance(reach, "Sky", "make the scene smaller")
        u, v, w = reach * np.eye(3)
        return LightPatch(DIRECTIONAL, np.zeros(3), u, v, w, 0.0)

    def radiance(self, directions: np.ndarray) -> np.ndarray:
        """(..., 3) float32: linear radiance seen along directions ((..., 3) float, world, any length), bilinear."""
        directions = as_array(directions, "directions")
        if directions.ndim < 1 or directions.shape[-1] != 3:
            raise InputError(f"directions must have shape (..., 3), not {directions.shape}")
        if directions.dtype != np.float32 and not (np.abs(directions) < _LONGEST).all():
            directions = unit_vectors(directions, "direction")
        x, y, z = np.moveaxis(directions.astype(np.float32), -1, 0)
        # not `@`: threads of BLAS stay busy for a tenth of a second, whatever `threads` a caller asked for
        right, upward, back = (x * a + y * b + z * c for a, b, c in self._frame.astype(np.float32))
        h, w = self.map.shape[:2]
        down = np.arctan2(np.hypot(right, back), upward) * np.float32(h / np.pi) - np.float32(0.5)
        found = np.empty((*down.shape, 3), np.float32)
        if self._level:
            for c in range(3):
                found[..., c] = np.interp(down, np.arange(h), self._tinted[:, 0, c])
            return found
        across = (np.arctan2(right, -back) * np.float32(0.5 / np.pi) + np.float32(0.5)) * w - np.float32(0.5)
        y, x = np.floor(down), np.floor(across)
        fy, fx = (down - y)[..., None], (across - x)[..., None]
        rows = [np.clip(y + k, 0, h - 1).astype(np.int32) for k in (0, 1)]
        columns = [(x.astype(np.int32) + k) % w for k in (0, 1)]
        (a, b), (c, d) = ([self._tinted[r, k] for k in columns] for r in rows)
        return (a + fx * (b - a)) * (1 - fy) + (c + fx * (d - c)) * fy

    @cached_property
    def _level(self) -> bool:
        """Whether all columns of the map are the same, so that radiance depends on the height alone."""
        return bool((self.map == self.map[:, :1]).all())

    @cached_property
    def _tinted(self) -> np.ndarray:
        return (self.map * (self.intensity * np.asarray(self.colour))).astype(np.float32)

    @cached_property
    def _frame(self) -> np.ndarray:
        """(3, 3) float64: the rows are the map's right, upward and backward axes in the world."""
        right, upward, back = axes(self.up or "y")
        turn = np.radians(self.turn)
        turned = np.cos(turn) * right - np.sin(turn) * back
        return np.stack([turned, upward, np.cross(turned, upward)])


def _map_of(image) -> np.ndarray:
    """The (h, w, 3) float64 map of the argument `image` of `Sky`."""
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


def _daylight() -> np.ndarray:
    """A clear sky, brighter towards the horizon, over a grey ground."""
    height = np.cos(np.pi * (np.arange(_HEIGHT) + 0.5) / _HEIGHT)[:, None]  # sine of the elevation
    above = _HORIZON + (_ZENITH - _HORIZON) * np.clip(height, 0.0, 1.0) ** 0.6
    share = np.clip(-height / 0.35, 0.0, 1.0)
    below = _HORIZON + (_GROUND - _HORIZON) * share * share * (3.0 - 2.0 * share)
    return np.where(height >= 0.0, above, below)[:, None]


def _draw(image: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """`count` lights of a map, in its frame: unit directions (n, 3), lux (n,), and colours (n, 3) of luminance 1.

    Rows are drawn by their power, and then columns by theirs, from the points of a sequence that fills the square. So
    all lights have the same power. A black map gives lights of intensity 0.
    """
    h, w = image.shape[:2]
    edges = np.cos(np.pi * np.arange(h + 1) / h)
    solid = (2.0 * np.pi / w) * (edges[:-1] - edges[1:])[:, None]  # solid angle of a texel
    power = (image @ _LUMINANCE) * solid
    total = power.sum()
    if not total > 0.0:
        power, total = np.broadcast_to(solid, (h, w)), 0.0
    a, b = (((np.arange(count) + 0.5) / count), (0.5 + _STEP * np.arange(count)) % 1.0)
    y, fy = _inverted(power.sum(1)[None], np.zeros(count, int), a)
    x, fx = _inverted(power, y, b)
    cosine = edges[y] + fy * (edges[y + 1] - edges[y])
    angle = 2.0 * np.pi * ((x + fx) / w - 0.5)
    sine = np.sqrt(np.maximum(1.0 - cosine * cosine, 0.0))
    colour = image[y, x]
    luminance = (colour @ _LUMINANCE)[:, None]
    colour = np.divide(colour, luminance, out=np.ones_like(colour), where=luminance > 0.0)
    directions = np.stack([sine * np.sin(angle), cosine, -sine * np.cos(angle)], 1)
    return directions, np.full(count, total / count), colour


def _inverted(weights: np.ndarray, row: np.ndarray, share: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(index, fraction within it) where the running sum of a row of weights reaches a share of its total."""
    sums = np.concatenate([np.zeros((len(weights), 1)), np.cumsum(weights, 1)], 1)
    sums /= np.where(sums[:, -1:] > 0.0, sums[:, -1:], 1.0)  # black rows are never drawn
    index = np.empty(len(row), int)
    for r in np.unique(row):
        own = row == r
        index[own] = np.searchsorted(sums[r], share[own], "right") - 1
    index = np.clip(index, 0, weights.shape[1] - 1)
    low, high = sums[row, index], sums[row, index + 1]
    return index, np.clip((share - low) / np.where(high > low, high - low, 1.0), 0.0, 1.0)
