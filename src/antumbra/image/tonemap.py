"""Tone mapping of linear light for a screen: exposure, highlight roll-off, sRGB."""

import math
from functools import cache

import numpy as np

LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)
"""Rec. 709 weights of linear red, green and blue."""

PERCENTILE = 97.0  # automatic exposure maps this percentile of the luminance of pixels that see a surface ...
BRIGHT = 0.75  # ... to this share of white: bright, with room above it for highlights
MIDDLE = 0.4  # ... if the median then has at least this share; a darker picture becomes brighter ...
MOST_BRIGHTER = 1.7  # ... by at most this factor, and its highlights roll off, ...
WIDE = 85.0  # ... but this percentile is at most ...
WIDE_AT_MOST = 0.75  # ... this share of white: a wide bright floor keeps its shades
SHOULDER = 0.6  # light below this stays linear; light above it rolls off softly towards white

_TOP = 4.0  # end of the table; the roll-off reaches 8-bit white long before it
_ENTRIES = 1 << 16
_ENOUGH = 1 << 18  # pixels that automatic exposure looks at
_ROWS = 64  # rows that are converted at a time, so that temporaries stay in the cache


def automatic_exposure(image: np.ndarray, seen: np.ndarray) -> float:
    """The exposure that makes a picture bright but not clipped; 1.0 if there is no light.

    Parameters
    ----------
    image : (H, W, 3) float32, linear
    seen : (H, W) bool
        Pixels that count.
    """
    step = math.isqrt(seen.size // _ENOUGH)
    if step > 1 and seen[::step, ::step].any():
        image, seen = image[::step, ::step], seen[::step, ::step]
    with np.errstate(invalid="ignore"):  # pixels that are not finite do not count
        luminance = image[seen] @ LUMINANCE
    luminance = luminance[np.isfinite(luminance) & (luminance > 0.0)]
    if not len(luminance):
        return 1.0
    middle, wide, high = (max(float(v), 1e-30) for v in np.percentile(luminance, (50.0, WIDE, PERCENTILE)))
    exposure = BRIGHT / high
    return exposure * max(1.0, min(MIDDLE / (middle * exposure), WIDE_AT_MOST / (wide * exposure), MOST_BRIGHTER))


def roll_off(x: np.ndarray) -> np.ndarray:
    """Map linear light >= 0 to [0, 1]: unchanged up to `SHOULDER`, then towards 1, with a continuous derivative."""
    room = 1.0 - SHOULDER
    return np.where(x <= SHOULDER, x, 1.0 - room * np.exp(-np.maximum(x - SHOULDER, 0.0) / room))


def linear_to_srgb(x: np.ndarray) -> np.ndarray:
    """Linear light in [0, 1] as sRGB (IEC 61966-2-1)."""
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 0.0031308) ** (1.0 / 2.4) - 0.055)


def to_srgb8(image: np.ndarray, exposure: float) -> np.ndarray:
    """(H, W, 3) uint8 sRGB of linear light times `exposure`, highlights rolled off.

    NaN and negative light are black. A table of 65536 entries approximates the curve. Where the curve is steepest, in
    black, an entry is a fifth of an 8-bit step.
    """
    out = np.empty(image.shape, np.uint8)
    scale = np.float32(min(exposure * (_ENTRIES / _TOP), 3e38))
    with np.errstate(invalid="ignore", over="ignore"):
        for y in range(0, len(image), _ROWS):
            entry = image[y : y + _ROWS] * scale
            np.fmax(entry, np.float32(0.0), out=entry)  # fmax and fmin drop NaN
            np.fmin(entry, np.float32(_ENTRIES - 1), out=entry)
            out[y : y + _ROWS] = _curve()[entry.astype(np.uint16)]
    return out


@cache
def _curve() -> np.ndarray:
    x = (np.arange(_ENTRIES) + 0.5) * (_TOP / _ENTRIES)
    return np.round(255.0 * linear_to_srgb(roll_off(x))).astype(np.uint8)
