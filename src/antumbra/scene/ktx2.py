"""KTX2 images with Basis Universal compression, as in KHR_texture_basisu: ETC1S and UASTC."""

import struct

import numpy as np
from numpy.typing import NDArray

from ..base.extras import import_extra

_MAGIC = b"\xabKTX 20\xbb\r\n\x1a\n"
_SIZE = 20  # offset of the width and the height in the header


def is_ktx2(data: bytes) -> bool:
    """Whether an image is a KTX2 file."""
    return data.startswith(_MAGIC)


def ktx2_size(data: bytes) -> tuple[int, int]:
    """(width, height) in pixels, from the header."""
    width, height = struct.unpack_from("<II", data, _SIZE)
    return width, height


def decode_ktx2(data: bytes) -> NDArray[np.uint8]:
    """(h, w, 4) uint8, contiguous: the largest level of a KTX2 image, rows from the top; alpha is 255 if it has none.

    Raises
    ------
    MissingPackage
        If the library of transcoders is missing.
    ValueError
        If the data are damaged, not compressed by Basis Universal, or not a single two-dimensional image.
    """
    texture = import_extra("opengl_basisu", "a KTX2 image", "compressed").open(data)
    if texture.faces != 1 or texture.layers != 1:
        raise ValueError(f"it has {texture.faces} faces and {texture.layers} layers, not one image")
    return np.ascontiguousarray(texture.transcode("rgba8", level=0).data, np.uint8)
