"""Every registered format: its suffixes, its reader on a file and on damage, its writer."""

import tomllib

import numpy as np
import pytest

import antumbra as at
import city_files
import gis_files
from antumbra.base.errors import InputError
from antumbra.city.city_formats import CITYJSON, FOOTPRINTS, HEIGHTS
from antumbra.engine.scene_loading import load
from antumbra.engine.scene_reading import SCENE_FORMATS, SCENE_SUFFIXES
from antumbra.formats.format_registry import FRAMES, SCENE_WRITERS, format_of, write_scene
from antumbra.generate.procedural_scenes import generate
from engine import test_scene_loading_frames
from formats.test_mesh_files import obj_text, ply_binary, stl_binary
from gltf_files import single
from repository import ROOT

EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]


def sample(suffix, folder):
    """The path of a small scene with a suffix; "": a folder of vertex frames."""
    path = folder / f"a{suffix}"
    if suffix in (".glb", ".gltf"):
        return single().write(folder, path.name)
    if suffix in CITYJSON.suffixes:
        pytest.importorskip("mapbox_earcut", reason="CityJSON needs antumbra[gis]: NOT checked")
        document = city_files.everything()
        return city_files.put(folder, document if suffix == ".json" else city_files.sequence(document), path.name)
    if suffix in HEIGHTS.suffixes:
        return gis_files.write_raster(path, gis_files.hills())
    if suffix in FOOTPRINTS.suffixes:
        return gis_files.write_buildings(path)
    if suffix in (".antumbra", ".tiles"):
        at.build_store(at.procedural("atrium", triangles=2000), path)
        return path
    if suffix == "":
        return test_scene_loading_frames.write(path)
    data = {".obj": obj_text(), ".ply": ply_binary(), ".stl": stl_binary()}[suffix]
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    return path


def test_suffixes_are_unique():
    assert len(set(SCENE_SUFFIXES)) == len(SCENE_SUFFIXES)
    assert all(suffix == suffix.lower() and suffix.startswith(".") for suffix in SCENE_SUFFIXES)
    assert [each for each in SCENE_FORMATS if not each.suffixes] == [FRAMES]


@pytest.mark.parametrize("file_format", SCENE_FORMATS, ids=lambda each: each.name)
def test_extras_exist(file_format):
    assert file_format.extra is None or file_format.extra in EXTRAS
    assert file_format.name and file_format.lost


@pytest.mark.parametrize("suffix", ["", *SCENE_SUFFIXES])
def test_every_format_is_read(suffix, tmp_path):
    path = sample(suffix, tmp_path)
    assert suffix in (format_of(path, SCENE_FORMATS).suffixes or ("",))
    assert load(path).n_triangles > 0
    if suffix:
        path.rename(path.with_suffix(suffix.upper()))
        assert load(path.with_suffix(suffix.upper())).n_triangles > 0


@pytest.mark.parametrize("suffix", SCENE_SUFFIXES)
@pytest.mark.parametrize("data", [b"", b"\x00\xff" * 100, b"{}"], ids=["empty", "noise", "json"])
def test_damaged_files_are_refused(suffix, data, tmp_path):
    path = tmp_path / f"a{suffix}"
    path.write_bytes(data)
    with pytest.raises(InputError) as caught:
        load(path)
    assert str(caught.value).startswith(path.name) and "\n" not in str(caught.value)


@pytest.mark.parametrize("suffix", [suffix for suffix in SCENE_SUFFIXES if suffix not in CITYJSON.suffixes])
def test_only_cityjson_has_levels_of_detail(suffix, tmp_path):
    with pytest.raises(InputError, match=rf"^a\{suffix}: lod is for CityJSON files"):
        load(tmp_path / f"a{suffix}", lod="1")


def test_an_unknown_suffix_is_answered_with_all(tmp_path):
    (tmp_path / "a.zzz").write_bytes(b"Kaydara")
    with pytest.raises(InputError, match=f"use one of {', '.join(SCENE_SUFFIXES)}, or a folder"):
        load(tmp_path / "a.zzz")


def test_the_documentation_of_load_names_all_suffixes():
    assert not [suffix for suffix in SCENE_SUFFIXES if suffix not in at.load.__doc__]


@pytest.mark.parametrize("suffix", SCENE_WRITERS)
def test_what_is_written_is_read(suffix, tmp_path):
    scene = generate("atrium", 2000)
    files = write_scene(scene, "atrium", tmp_path / f"a{suffix}")
    assert sorted(files) == sorted(tmp_path.iterdir())
    read = load(files[0])
    assert read.n_triangles == len(scene.faces)
    np.testing.assert_allclose(read.bounds, [scene.vertices.min(0), scene.vertices.max(0)], atol=1e-5)


@pytest.mark.parametrize("suffix", [".gltf", ".stl", ".json", ".antumbra", ""])
def test_other_formats_are_not_written(suffix, tmp_path):
    *others, last = SCENE_WRITERS
    with pytest.raises(InputError, match=f"{', '.join(others)} or {last}"):
        write_scene(generate("atrium", 2000), "atrium", tmp_path / f"a{suffix}")
    assert not list(tmp_path.iterdir())


def test_the_command_lists_the_registry(cli):
    rows = cli("formats", "--json").json()["formats"]
    assert [row["name"] for row in rows] == [each.name for each in SCENE_FORMATS]
    assert [suffix for row in rows for suffix in row["suffixes"]] == list(SCENE_SUFFIXES)
    assert [suffix for row in rows if row["writes"] for suffix in row["suffixes"]] == list(SCENE_WRITERS)
    assert all(row["reads"] and row["lost"] for row in rows)
    words = " ".join(cli("formats").out.split())
    assert not [suffix for suffix in SCENE_SUFFIXES if suffix not in words]
