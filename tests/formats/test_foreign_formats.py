"""Files of other trades: each is refused by naming the program that converts it, with words that a shell takes."""

import json
import re
import shlex
from pathlib import Path

import pytest

import antumbra as at
from antumbra.engine.scene_reading import SCENE_SUFFIXES
from antumbra.formats.foreign_formats import FOREIGN_FORMATS, cure_of

SUFFIXES = [suffix for each in FOREIGN_FORMATS for suffix in each.suffixes]
EXPECTED = {
    ".gml": "citygml-tools to-cityjson a.gml",
    ".ifc": "IfcConvert a.ifc a.glb",
    ".las": "pdal translate a.las a.tif --writers.gdal.resolution=1",
    ".laz": "pdal translate a.laz a.tif",
    ".dxf": "Blender",
    ".fbx": "Blender",
    ".usdz": "Blender",
    ".usd": "Blender",
    ".3ds": "assimp export a.3ds a.glb",
    ".dae": "assimp export a.dae a.glb",
    ".kmz": "unzip a.kmz",
    ".b3dm": "3d-tiles-tools b3dmToGlb -i a.b3dm -o a.glb",
    ".gltf.zip": "unzip a.gltf.zip",
    ".hgt": "gdal_translate a.hgt a.tif",
    ".img": "gdal_translate a.img a.tif",
    ".nc": 'gdal_translate NETCDF:"a.nc":NAME a.tif',
    ".skp": "SketchUp",
    ".idf": "geomeppy",
    ".hbjson": "Ladybug Tools",
    ".off": "trimesh.load('a.off').export('a.glb')",
    ".city.json.gz": "gunzip a.city.json.gz",
}


@pytest.fixture(params=[*SUFFIXES, *(each for each in EXPECTED if each not in SUFFIXES)])
def suffix(request):
    return request.param


def test_no_format_is_both_read_and_foreign():
    assert not set(SUFFIXES) & set(SCENE_SUFFIXES) and len(set(SUFFIXES)) == len(SUFFIXES)
    assert all(each == each.lower() and each.startswith(".") for each in SUFFIXES)


def test_a_foreign_file_is_refused_by_naming_what_converts_it(suffix, tmp_path, cli):
    for name in (f"a{suffix}", f"a{suffix.upper()}"):
        (tmp_path / name).write_text("x")
        with pytest.raises(at.InputError) as caught:
            at.load(tmp_path / name)
        told = str(caught.value)
        assert told.startswith(f"{name}: is ") and "not read; " in told and not re.search(r"[{}\n]", told)
        assert EXPECTED.get(suffix, "").lower() in told.lower()
    cli("info", f"a{suffix}").refused(f"a{suffix}: is ")


def test_commands_name_the_file_as_one_word(suffix):
    name = f"my file (1){suffix}"
    said = cure_of(Path(name))
    if command := re.search(
        r": ((citygml-tools|IfcConvert|pdal|assimp|meshio|npx|gdal_translate|ogr2ogr) .*)",
        said.partition("; convert")[2],
    ):
        words = shlex.split(command[1])
        assert [word for word in words if name in word] and not [word for word in words if word.startswith("(1)")]


def test_a_file_that_is_missing_is_missing(suffix, tmp_path):
    with pytest.raises(at.InputError, match="no such file"):
        at.load(tmp_path / f"a{suffix}")


@pytest.mark.parametrize(
    "document, told",
    [
        ({"asset": {"version": "1.0"}, "root": {}}, "a tileset of 3D Tiles, which is not read; name one of its tiles"),
        ({"asset": {"version": "1.1"}}, "a tileset of 3D Tiles"),
        ({"type": "FeatureCollection", "features": []}, "GeoJSON; rename it to a.geojson"),
        ({"type": "Model", "rooms": []}, "a model of Ladybug Tools, which is not read; pass its Face3D"),
        ({"asset": {"version": "2.0"}, "meshes": []}, "glTF; rename it to a.gltf"),
        ({"type": "Topology"}, "not a CityJSON file (its type is 'Topology')"),
    ],
)
def test_other_json_files_are_recognised(document, told, tmp_path):
    (tmp_path / "a.json").write_text(json.dumps(document))
    with pytest.raises(at.InputError, match=re.escape(told)):
        at.load(tmp_path / "a.json")


@pytest.mark.parametrize("read", [at.from_footprints, at.from_trees])
def test_vector_files_of_other_kinds_are_refused_likewise(read, tmp_path):
    (tmp_path / "a.kml").write_text("<kml/>")
    with pytest.raises(
        at.InputError, match=r"^a\.kml: is vector data, which is not read; convert it: ogr2ogr a\.gpkg a\.kml"
    ):
        read(tmp_path / "a.kml")
