"""Base colours: conversion of sRGB to linear light, and mean colours of textures."""

import io
import warnings

import numpy as np

MAX_PIXELS = 1 << 26
SMALL_PIXELS = 1 << 22
PIXELS_PER_BYTE = 2048  # a picture that is not small and has more is a decompression bomb


def srgb_to_linear(value) -> np.ndarray:
    """Convert sRGB in [0, 1] to linear light (IEC 61966-2-1), float64."""
    value = np.asarray(value, np.float64)
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


BYTE_TO_LINEAR = srgb_to_linear(np.arange(256) / 255.0)


def mean_linear(data: bytes) -> np.ndarray:
    """The mean colour ((3,) float64, linear) of an sRGB picture (PNG, JPEG or WebP). Alpha is ignored.

    Raises ValueError, with the reason, if the picture cannot be decoded or is unreasonably large.
    """
    from PIL import Image

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            with Image.open(io.BytesIO(data), formats=("PNG", "JPEG", "WEBP")) as image:
                _check_size(image.size, len(data))
                if max(image.size) > 1024:
                    image.draft("RGB", (256, 256))  # a JPEG is decoded at a fraction of its size
                return mean_of(image)
    except Exception as error:  # Pillow's decoders raise a dozen kinds of errors on damaged files
        raise ValueError(str(error) or type(error).__name__) from error


def mean_of(image) -> np.ndarray:
    """The mean colour ((3,) float64, linear) of a picture that Pillow has opened."""
    counts = np.array(image.convert("RGB").histogram(), np.float64).reshape(3, 256)
    return counts @ BYTE_TO_LINEAR / counts[0].sum()


def _check_size(size: tuple[int, int], n_bytes: int) -> None:
    pixels = size[0] * size[1]
    if pixels > MAX_PIXELS or pixels > max(SMALL_PIXELS, PIXELS_PER_BYTE * n_bytes):
        raise ValueError(f"{size[0]}x{size[1]} pixels in {n_bytes} bytes are too many")
