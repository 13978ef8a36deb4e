"""Pictures of textures: decoding with checks, and mip levels in linear light."""

import io
import threading
import warnings

import numpy as np

from .colour import BYTE_TO_LINEAR

FORMATS = ("PNG", "JPEG", "WEBP", "BMP", "TGA")
MAX_PIXELS = 1 << 26
SMALL_PIXELS = 1 << 22
PIXELS_PER_BYTE = 2048  # a picture that is not small and has more is a decompression bomb

LINEAR = BYTE_TO_LINEAR.astype(np.float32)
"""(256,) float32: the linear light of sRGB bytes."""

_OPENING = threading.Lock()  # of pictures: filters of warnings belong to all threads, and a race would keep ours

_STEPS = 1 << 16  # entries of the table from linear light to sRGB bytes: the darkest byte has twenty


def decoded(data: bytes, side: int | None = None) -> np.ndarray:
    """(h, w, 4) uint8: a picture of one of `FORMATS`. `side`: a large JPEG may come smaller, but not below this.

    Raises ValueError, with the reason, if the picture cannot be decoded or is unreasonably large.
    """
    try:
        with _opened(data) as image:
            _check_size(image.size, len(data))
            if side is not None:
                image.draft("RGB", (side, side))
            return rgba_of(image)
    except Exception as error:  # Pillow's decoders raise a dozen kinds of errors on damaged files
        raise ValueError(str(error) or type(error).__name__) from error


def _opened(data: bytes):
    """A Pillow image, whose pixels are not read yet. Pillow's warnings of large pictures are errors."""
    from PIL import Image

    with _OPENING, warnings.catch_warnings():
        warnings.simplefilter("error", Image.DecompressionBombWarning)
        return Image.open(io.BytesIO(data), formats=FORMATS)


def rgba_of(image) -> np.ndarray:
    """(h, w, 4) uint8, contiguous: the pixels of a Pillow image; of 16 bits a channel the higher byte."""
    if image.mode.startswith("I"):
        high = (np.asarray(image).astype(np.int64) >> 8).clip(0, 255).astype(np.uint8)
        return np.dstack([high, high, high, np.full_like(high, 255)])
    return np.array(image.convert("RGBA"))


def linear_of(pixels: np.ndarray) -> np.ndarray:
    """(h, w, 4) float32: sRGB bytes as linear light in [0, 1], and alpha."""
    out = pixels.astype(np.float32) / np.float32(255.0)
    out[..., :3] = LINEAR[pixels[..., :3]]
    return out


def mip_levels(pixels: np.ndarray, has_alpha: bool = False) -> list[np.ndarray]:
    """Means of a picture ((h, w, 4) uint8) over 2 x 2, 4 x 4 ... texels, as linear float32, down to a single texel.

    An odd number of texels is halved by the exact means of areas. With `has_alpha`, colours count by their alpha, so
    that those of holes do not bleed into leaves.
    """
    if pixels.shape[:2] == (1, 1):
        return []
    whole = len(pixels) if len(pixels) % 2 else _STRIP
    strips = (linear_of(pixels[y : y + whole]) for y in range(0, len(pixels), whole))
    weighted = np.concatenate([_quartered(_times_alpha(strip) if has_alpha else strip) for strip in strips])
    levels = [weighted]
    while weighted.shape[:2] != (1, 1):
        weighted = _quartered(weighted)
        levels.append(weighted)
    return [_by_alpha(level) for level in levels] if has_alpha else levels


_STRIP = 256  # rows that become linear light at a time, sixteen times the memory of their bytes
_LEAST = np.float32(1.0 / 255.0)  # weight of a texel without alpha, so that an empty picture has a mean


def _times_alpha(linear: np.ndarray) -> np.ndarray:
    out = linear.copy()
    out[..., 3] += _LEAST
    out[..., :3] *= out[..., 3:]
    return out


def _by_alpha(weighted: np.ndarray) -> np.ndarray:
    out = weighted.copy()
    out[..., :3] /= out[..., 3:]
    out[..., 3] -= _LEAST
    return out


def _quartered(picture: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(_halved(_halved(picture).swapaxes(0, 1)).swapaxes(0, 1))


def _halved(rows: np.ndarray) -> np.ndarray:
    """Means of pairs of rows. Of an odd number, 2 k + 1, k means of 2 + 1/k rows each."""
    n, k = len(rows), len(rows) // 2
    if n % 2 == 0:
        return (rows[0::2] + rows[1::2]) * np.float32(0.5)
    if n == 1:
        return rows
    i = np.arange(k, dtype=np.float32).reshape(-1, 1, 1)
    weights = np.float32(1.0 / n)
    return ((k - i) * rows[0:-1:2] + k * rows[1::2] + (i + 1) * rows[2::2]) * weights


def bytes_of(linear: np.ndarray) -> np.ndarray:
    """(h, w, 4) uint8: the inverse of `linear_of`."""
    shown = np.clip(linear, 0.0, 1.0)
    out = (shown * np.float32(255.0) + np.float32(0.5)).astype(np.uint8)
    out[..., :3] = _TO_BYTE[(shown[..., :3] * np.float32(_STEPS - 1) + np.float32(0.5)).astype(np.uint16)]
    return out


def _byte_table() -> np.ndarray:
    """(65536,) uint8: the nearest sRGB byte of linear light."""
    edges = (BYTE_TO_LINEAR[1:] + BYTE_TO_LINEAR[:-1]) / 2.0
    return np.searchsorted(edges, np.arange(_STEPS) / (_STEPS - 1)).astype(np.uint8)


_TO_BYTE = _byte_table()


def _check_size(size: tuple[int, int], n_bytes: int) -> None:
    pixels = size[0] * size[1]
    if pixels > MAX_PIXELS or pixels > max(SMALL_PIXELS, PIXELS_PER_BYTE * n_bytes):
        raise ValueError(f"{size[0]}x{size[1]} pixels in {n_bytes} bytes are too many")
