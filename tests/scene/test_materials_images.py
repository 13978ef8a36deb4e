"""Decoding of pictures by several threads."""

import io
import warnings
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from PIL import Image

from antumbra.scene.materials import decode_image
from gltf_files import png


def test_threads_leave_the_filters_of_warnings_alone():
    """A race between two `warnings.catch_warnings` would keep the filters of one of them for ever."""
    pixels = np.random.default_rng(0).integers(0, 256, (40, 30, 4)).astype(np.uint8)
    before = list(warnings.filters)
    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(decode_image, [png(pixels)] * 400))
    assert warnings.filters == before and all(np.array_equal(each, pixels) for each in found)


def test_a_picture_of_too_many_pixels_is_refused_without_a_warning():
    stream = io.BytesIO()
    Image.new("1", (10_000, 10_000)).save(stream, "PNG")
    with warnings.catch_warnings(), pytest.raises(ValueError, match="pixels"):
        warnings.simplefilter("error")
        decode_image(stream.getvalue())
