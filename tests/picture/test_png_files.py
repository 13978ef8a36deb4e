"""PNG files are legal, hold the pixels exactly, and do not depend on threads."""

import io
import struct
import zlib

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from PIL import Image, PngImagePlugin

from antumbra.kernels import parallel
from antumbra.picture.png_files import FAST, SMALL, STRIP_BYTES, png_file


def chunks_of(data):
    """The chunks of a PNG file, with their checksums verified: [(name, contents)]."""
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    at, chunks = 8, []
    while at < len(data):
        (length,) = struct.unpack_from(">I", data, at)
        name, contents = data[at + 4 : at + 8], data[at + 8 : at + 8 + length]
        assert struct.unpack_from(">I", data, at + 8 + length) == (zlib.crc32(name + contents),)
        chunks.append((name, contents))
        at += 12 + length
    return chunks


def unfiltered(data):
    """(h, w, c): the pixels of a PNG file with the filters "sub" and "up"; and the filter of each row."""
    chunks = dict(chunks_of(data))
    width, height, bits, colour, *rest = struct.unpack(">2I5B", chunks[b"IHDR"])
    assert rest == [0, 0, 0]
    channels = {0: 1, 2: 3, 6: 4}[colour]
    pixel = channels * bits // 8
    # zlib verifies the Adler-32 checksum
    rows = np.frombuffer(zlib.decompress(chunks[b"IDAT"]), np.uint8).reshape(height, 1 + width * pixel)
    out = np.zeros((height + 1, width + 1, pixel), np.uint8)
    for y, row in enumerate(rows):
        differences = row[1:].reshape(width, pixel)
        if row[0] == 1:
            out[y + 1, 1:] = np.cumsum(differences, axis=0, dtype=np.uint8)
        else:
            out[y + 1, 1:] = differences + out[y, 1:]
    return out[1:, 1:].copy().view(">u2" if bits == 16 else np.uint8).reshape(height, width, channels), rows[:, 0]


IMAGES = st.tuples(
    st.integers(1, 40), st.integers(1, 40), st.sampled_from([1, 3, 4]), st.sampled_from([np.uint8, np.uint16])
).flatmap(lambda s: hnp.arrays(s[3], s[:3], elements=st.integers(0, np.iinfo(s[3]).max)))


@given(image=IMAGES, strip=st.integers(1, 300), level=st.sampled_from([FAST, SMALL]))
def test_pixels_are_exact(image, strip, level):
    data = png_file(image, level=level, strip_bytes=strip)
    np.testing.assert_array_equal(unfiltered(data)[0], image)
    if image.dtype == np.uint8:
        with Image.open(io.BytesIO(data)) as read:
            np.testing.assert_array_equal(np.asarray(read).reshape(image.shape), image)


def test_rows_take_the_filter_with_smaller_differences():
    y, x = np.mgrid[:200, :300]
    stripes = np.where(y < 100, 3 * x, 5 * y).astype(np.uint8)  # equal down a column, then along a row
    pixels, filters = unfiltered(png_file(stripes))
    np.testing.assert_array_equal(pixels[..., 0], stripes)
    assert set(filters[1:100].tolist()) == {2} and set(filters[101:].tolist()) == {1} == {int(filters[0])}


def test_a_file_does_not_depend_on_threads(monkeypatch):
    image = np.random.default_rng(2).integers(0, 9, (300, 500, 3), np.uint8)
    files = set()
    for threads in (1, 2, 7):
        monkeypatch.setattr(parallel, "thread_count", lambda _, n=threads: n)
        files.add(png_file(image))
    assert len(files) == 1 and len(files.pop()) > STRIP_BYTES


def test_strips_cost_little():
    """A file of many strips is hardly larger than one that Pillow writes as a whole."""
    y, x = np.mgrid[:600, :600]
    waves = np.stack([128 + 100 * np.sin(x / 40 + k) * np.cos(y / 50) for k in range(3)], -1)
    image = (waves + np.random.default_rng(3).normal(0, 1, waves.shape)).astype(np.uint8)
    stream = io.BytesIO()
    Image.fromarray(image).save(stream, "PNG", compress_level=1)
    assert image.nbytes > 8 * STRIP_BYTES
    assert len(png_file(image)) < 1.15 * len(stream.getvalue())


def test_texts_and_colour_space():
    image, text = np.zeros((2, 3, 3), np.uint8), "a note, 日本, \n" + "x" * 1000
    data = png_file(image, {"antumbra": text, "Title": ""})
    with Image.open(io.BytesIO(data)) as read:
        assert isinstance(read, PngImagePlugin.PngImageFile)
        assert read.text == {"antumbra": text, "Title": ""} and read.info["srgb"] == 0
    assert [name for name, _ in chunks_of(data)] == [b"IHDR", b"sRGB", b"iTXt", b"iTXt", b"IDAT", b"IEND"]
    assert [name for name, _ in chunks_of(png_file(image, is_srgb=False))] == [b"IHDR", b"IDAT", b"IEND"]
