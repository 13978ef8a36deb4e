"""Scenes named `example:NAME`, in Python as on the command line."""

import os
from pathlib import Path

import numpy as np
import pytest

import antumbra as at
from antumbra.base.errors import InputError
from antumbra.formats.example_files import EXAMPLES, scene_path


@pytest.mark.parametrize("name", EXAMPLES)
def test_names_of_examples_are_their_files(name):
    assert scene_path(f"example:{name}") == at.examples.file_of(name) and at.examples.file_of(name).is_file()
    assert scene_path(Path(f"example:{name}")) == at.examples.file_of(name)


def test_other_names_are_paths():
    assert scene_path("a/example:temple") == Path("a/example:temple")
    assert scene_path(Path("temple")) == Path("temple")


@pytest.mark.skipif(os.name == "nt", reason="file names have no colons there")
@pytest.mark.parametrize("name", ["example:mine.obj", "./example:mine.obj", "procedural:mine.obj"])
def test_files_whose_names_begin_as_those_of_examples_are_read(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    Path(name).write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    assert at.load(name).n_triangles == at.load(Path(name)).n_triangles == 1
    Path("example:mill").mkdir()
    assert at.load("example:mill").name == "mill" and at.load("example:mill").n_triangles > 1
    with pytest.raises(InputError, match="no example scene"):
        at.load("example:" + 300 * "a")


def test_functions_take_the_name_of_an_example():
    mill = at.load("example:mill")
    assert mill.name == "mill" and (mill.triangles().vertices == at.examples.mill().triangles().vertices).all()
    point, sun = [[0.0, 30.0, 0.0]], at.DirectionalLight(direction=(0.0, -1.0, 0.0))
    assert (at.visibility("example:mill", point, sun).fraction == 1).all()
    assert np.array_equal(at.Engine("example:mill").occluded(point, (0, -1, 0)), [True])
    change = at.scene_change("example:temple", add=[("example:temple", (4.0, 0.0, 0.0))])
    assert change.after.n_triangles == 2 * at.examples.temple().n_triangles


@pytest.mark.filterwarnings("ignore:mill. is animated")
def test_a_store_takes_the_name_of_an_example(tmp_path):
    at.build_store(["example:mill"], tmp_path / "mill.antumbra")
    assert at.load(tmp_path / "mill.antumbra").n_triangles == at.examples.mill().n_triangles


def test_a_bake_keeps_the_file_of_an_example(tmp_path):
    at.bake("example:mill", tmp_path / "mill.glb", spp=4)
    assert at.load(tmp_path / "mill.glb").duration == at.examples.mill().duration


@pytest.mark.parametrize(
    "scene, words",
    [
        ("example:tempel", "no example scene 'tempel'; did you mean 'temple'"),
        ("example:", "no example scene ''; choose one of hills, mill"),
        ("example:mill?animation=a", "no example scene 'mill\\?animation=a'"),
        ("procedural:city?triangles=9k", 'in Python, call at.procedural\\("city", triangles, seed\\)'),
        ("", "name a file"),
    ],
)
def test_wrong_names(scene, words):
    with pytest.raises(InputError, match=words):
        at.load(scene)
