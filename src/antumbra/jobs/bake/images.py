"""Image files of a bake: PNG with 8 or 16 bits a channel, and EXR."""

import struct
import zlib
from pathlib import Path

import numpy as np

from ...picture.image_files import linear_to_srgb, write_exr

_COLOUR_TYPES = {1: 0, 3: 2, 4: 6}  # of PNG: grey, RGB, RGBA


def encoded(image: np.ndarray, bits: int, srgb: bool) -> np.ndarray:
    """An image (h, w, c) float in [0, 1] as uint8 or uint16; `srgb`: its first three channels are linear light."""
    image = np.clip(image, 0.0, 1.0).astype(np.float64)
    if srgb:
        image[..., :3] = linear_to_srgb(image[..., :3])
    top = (1 << bits) - 1
    return np.round(top * image).astype(np.uint8 if bits == 8 else np.uint16)


def png_of(image: np.ndarray) -> bytes:
    """The PNG file of an image (h, w, 1, 3 or 4) uint8 or uint16. Pillow writes no RGB of 16 bits."""
    h, w, channels = image.shape
    rows = image.astype(image.dtype.newbyteorder(">")).reshape(h, -1).view(np.uint8)
    up = np.diff(rows, axis=0, prepend=np.zeros((1, rows.shape[1]), np.uint8))  # filter 2: less the row above
    data = np.concatenate([np.full((h, 1), 2, np.uint8), up], 1).tobytes()
    head = struct.pack(">IIBBBBB", w, h, 8 * image.itemsize, _COLOUR_TYPES[channels], 0, 0, 0)
    chunks = [(b"IHDR", head), (b"IDAT", zlib.compress(data, 6)), (b"IEND", b"")]
    body = b"".join(struct.pack(">I", len(d)) + k + d + struct.pack(">I", zlib.crc32(k + d)) for k, d in chunks)
    return b"\x89PNG\r\n\x1a\n" + body


def save_exr(image: np.ndarray, path: Path) -> None:
    """Write an image (h, w, 1 or 3) to an EXR file of float32: channel Y, or R, G, B."""
    image = np.ascontiguousarray(image, np.float32)
    channels = {"Y": np.ascontiguousarray(image[..., 0])} if image.shape[-1] == 1 else {"RGB": image}
    write_exr(channels, path, None)
