"""Any damage is found, when a store is opened or a chunk is checked, and reported in one line."""

import json
import os
import zlib

import numpy as np
import pytest
from hypothesis import HealthCheck, given
from hypothesis import strategies as st

import antumbra as at
from antumbra.store import store_file
from antumbra.store.store_file import open_store
from antumbra.store.store_format import (
    COUNTS,
    HEADER,
    HEADER_CRC,
    MAGIC,
    NODE_BYTES,
    PAGE,
    TABLE,
    meta_from_json,
    meta_to_json,
    pages,
)
from bvh_scenes import terrain
from stores import CHUNK, built, soup_scene
from strength import examples


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """(path for a damaged copy, the bytes of the store)."""
    store = built(tmp_path_factory.mktemp("damage"), soup_scene(terrain(600)), chunk=2 * CHUNK)
    assert len(store) > 3
    return store.path, store.path.read_bytes()


def found(path) -> str:
    """The error of opening and checking a file; "" if there is none."""
    try:
        with open_store(path) as store:
            for k in range(len(store)):
                store.check(k)
    except at.InputError as error:
        assert "\n" not in str(error) and str(error).startswith(path.name)
        return str(error)
    return ""


def test_an_intact_store(whole):
    path, data = whole
    path.write_bytes(data)
    assert found(path) == ""


@examples(150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(share=st.floats(0, 1, exclude_max=True), bit=st.integers(0, 7))
def test_any_bit(whole, share, bit):
    check_flip(whole, int(share * len(whole[1])), bit)


@pytest.mark.parametrize("place", [*range(0, 60, 3), 100, HEADER_CRC, PAGE - 1, PAGE, -1, -300])
def test_bits_that_matter(whole, place):
    check_flip(whole, place % len(whole[1]), 3)


def check_flip(whole, place, bit):
    path, data = whole
    damaged = bytearray(data)
    damaged[place] ^= 1 << bit
    path.write_bytes(damaged)
    said = found(path)
    assert said
    path.write_bytes(data)
    with open_store(path) as store:
        ends = store.chunks.offset + store.chunks.bytes
        k = int(np.searchsorted(ends, place, side="right"))
    if place < PAGE:
        assert "header" in said or "not a store" in said
    elif k == len(ends):
        assert "directory" in said
    else:
        assert f"chunk {k} of {len(ends)} (bytes " in said


@examples(60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(share=st.floats(0, 1, exclude_max=True))
def test_cut_anywhere(whole, share):
    path, data = whole
    kept = int(share * len(data))
    path.write_bytes(data[:kept])
    said = found(path)
    assert "empty" in said if kept == 0 else "not a store" in said if kept < len(MAGIC) else "is cut short" in said


def with_header(data, **changes) -> bytes:
    """The store with other words in its header, and a correct checksum."""
    names = "magic", "version", "complete", "size", "place", "length", "crc"
    words = dict(zip(names, HEADER.unpack_from(data))) | changes
    header = HEADER.pack(*words.values()).ljust(HEADER_CRC, b"\0")
    return header + zlib.crc32(header).to_bytes(4, "little") + data[PAGE:]


def with_meta(data, **changes) -> bytes:
    """The store with other metadata, and correct checksums: as another release might write it."""
    *_, place, length, _ = HEADER.unpack_from(data)
    directory = data[place : place + length]
    k, m, size = COUNTS.unpack_from(directory)
    start = COUNTS.size + k * TABLE.itemsize + m * NODE_BYTES
    text = json.dumps(json.loads(directory[start : start + size]) | changes).encode()
    changed = COUNTS.pack(k, m, len(text)) + directory[COUNTS.size : start] + text
    changed = changed.ljust(pages(len(changed)), b"\0")
    whole = data[:place] + changed
    return with_header(whole, size=len(whole), length=len(changed), crc=zlib.crc32(changed))


def test_metadata_that_are_written_again_are_read(whole):
    path, data = whole
    path.write_bytes(with_meta(data, name="again"))
    assert found(path) == "" and at.load(path).name == "again"


@pytest.mark.parametrize(
    "change, words",
    [
        (
            lambda d: with_header(d, version=1),
            "version 1, and this antumbra reads versions 2 to 4; build it again",
        ),
        (
            lambda d: with_header(d, version=5),
            "version 5, and this antumbra reads versions 2 to 4; upgrade antumbra, or build",
        ),
        (lambda d: with_meta(d, seasons=4), "does not know; upgrade antumbra, or build it again"),
        (lambda d: with_meta(d, lights=[{"type": "Lava", "colour": [1, 1, 1]}]), "does not know; upgrade antumbra"),
        (lambda d: with_meta(d, lights=[{"colour": [1, 1, 1]}]), "does not know; upgrade antumbra"),
        (lambda d: with_header(d, complete=0), "not finished; build it again"),
        (lambda d: bytes(PAGE) + d[PAGE:], "not finished; build it again"),
        (lambda d: bytes(100), "not finished; build it again"),
        (lambda d: d + b"x", "after its end"),
        (lambda d: b"glTF" + d[4:], "is not a store; make one by antumbra build"),
        (lambda d: b"", "the file is empty"),
    ],
    ids=[
        "older",
        "later",
        "later field",
        "later light",
        "no type",
        "incomplete",
        "no header",
        "zeros",
        "longer",
        "another kind",
        "empty",
    ],
)
def test_what_is_no_whole_store(whole, change, words):
    path, data = whole
    path.write_bytes(change(data))
    assert words in found(path)
    with pytest.raises(at.InputError, match=words.partition(";")[0]):
        at.load(path)


def test_a_light_that_could_not_be_read_again_is_refused_when_it_is_written(whole):
    path, data = whole
    path.write_bytes(data)
    meta = open_store(path).meta
    again = meta_from_json(meta_to_json(meta._replace(lights=[at.PointLight((1, 2, 3))])))
    assert again.lights[0].position.tolist() == [1, 2, 3]
    with pytest.raises(
        at.InputError, match=r"cannot save the scene's Sky; replace it by AmbientOcclusion, .* or Sphere"
    ):
        meta_to_json(meta._replace(lights=[at.Sky()]))


def test_no_file(tmp_path):
    assert "no such file" in found(tmp_path / "none.antumbra")
    (tmp_path / "folder.antumbra").mkdir()
    assert "not a regular file" in found(tmp_path / "folder.antumbra")


def test_damage_after_the_store_was_opened(whole):
    """`check` reads a chunk again, also if the file shrinks meanwhile."""
    path, data = whole
    path.write_bytes(data)
    with open_store(path) as store:
        last = len(store) - 1
        place = int(store.chunks.offset[last])
        store.check(last)
        with path.open("r+b") as stream:
            stream.seek(place + 90)
            stream.write(bytes([data[place + 90] ^ 4]))
        with pytest.raises(at.InputError, match=rf"chunk {last} of .* is damaged; copy the file again"):
            store.check(last)
        with path.open("r+b") as stream:
            stream.truncate(place + 100)
        with pytest.raises(at.InputError, match=rf"chunk {last} of .* is cut short; copy the file again"):
            store.check(last)
        store.check(0)
    path.write_bytes(data)


def test_a_chunk_is_checked_when_it_is_first_read_and_again_once_the_file_has_changed(whole, monkeypatch):
    path, data = whole
    path.write_bytes(data)
    checked, check = [], store_file.chunk_fault
    monkeypatch.setattr(store_file, "chunk_fault", lambda *chunk: checked.append(1) or check(*chunk))
    with open_store(path) as store:
        for k in (0, 0, 1, 0, 1):
            store.chunk(k)
        assert len(checked) == 2
        place = int(store.chunks.offset[0]) + 90
        for byte in (data[place] ^ 4, data[place]):
            with path.open("r+b") as stream:
                stream.seek(place)
                stream.write(bytes([byte]))
            os.utime(path, ns=(0, 10**18 + byte))  # clocks of file systems are coarse
            if byte == data[place]:
                store.chunk(0)
            else:
                with pytest.raises(at.InputError, match=r"chunk 0 of .* is damaged; copy the file again"):
                    store.chunk(0)
        assert len(checked) == 3
        store.chunk(1)
        assert len(checked) == 4
