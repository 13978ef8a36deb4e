"""Small files neither take long nor expand to gigabytes: each bomb is read in a process with limits."""

import os
import resource
import warnings
from pathlib import Path

import pytest

import antumbra as at
from antumbra.city.city_formats import CITYJSON, FOOTPRINTS, HEIGHTS
from antumbra.formats.format_registry import FORMATS, FRAMES, GLB, GLTF, OBJ, PLY, STL
from bombs import BOMBS, MAX_BYTES
from forked import in_child

SECONDS = 40  # of processor time, generous: the slowest takes 3, and those that were mended took minutes
MEMORY = 3 << 30  # bytes of address space beyond that of this process
READERS = {
    "CityJSON": CITYJSON, "OBJ": OBJ, "PLY": PLY, "STL": STL, "frames": FRAMES, "raster": HEIGHTS,
    "footprints": FOOTPRINTS,
}  # fmt: skip
OTHERS = "CityJSONSeq", "MTL", "picture", "sensors", "trees"
LOADED = {"glTF": (GLB, GLTF)} | {name: (each,) for name, each in READERS.items()}


def outcome(read) -> str:
    """Read a bomb within limits: "" or the message of the InputError."""
    sizes = Path("/proc/self/statm")  # of Linux
    pages = int(sizes.read_text().split()[0]) if sizes.exists() else 1 << 22
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + MEMORY,) * 2)
    resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            read()
        except at.InputError as error:
            return str(error)
    return ""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no forks: bombs are NOT defused")
@pytest.mark.parametrize("name", BOMBS)
def test_a_bomb_is_read_or_refused(tmp_path, name):
    read = BOMBS[name](tmp_path)
    assert 0 < sum(path.stat().st_size for path in tmp_path.iterdir()) < MAX_BYTES
    said = in_child(lambda: outcome(read))
    assert said.isprintable()


def test_every_reader_has_a_bomb():
    names = {name.partition(":")[0] for name in BOMBS}
    assert names == {*LOADED, *OTHERS}
    assert {id(each) for formats in LOADED.values() for each in formats} == {id(each) for each in FORMATS}


REFUSED = {
    "CityJSON: a square walked around many times": r'"a" has a polygon that passes 4 points 240,000 times;',
    "CityJSON: one hole repeated": r"passes 7 points 300,004 times",
    "CityJSON: many instances of a template of many triangles": "4,000 instances of templates have 80,000,000 polygons",
    "CityJSON: a chain of objects within one another": "more than 100 CityObjects contain",
    "PLY: many properties": "PLY header has 40,004 lines of property, more than 1,000; export x, y, z",
    "PLY: vertices without properties": "PLY header gives the element 'vertex' no properties; export",
    "PLY: many elements": "PLY header has 20,002 lines of element, more than 1,000",
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_refused_is_named(tmp_path, name):
    with pytest.raises(at.InputError, match=REFUSED[name]):
        BOMBS[name](tmp_path)()


READ = (
    "CityJSON: a corner repeated",
    "CityJSON: many holes",
    "STL: many solids of one name",
    "OBJ: many objects and groups",
)


@pytest.mark.parametrize("name", READ)
def test_what_is_only_unusual_is_read(tmp_path, name):
    BOMBS[name](tmp_path)()
