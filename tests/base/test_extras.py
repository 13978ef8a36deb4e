"""Optional packages: those that are there are imported, the others get a cure."""

import json
import sys

import pytest

import antumbra as at
from antumbra.base.errors import InputError
from antumbra.base.extras import import_extra


def test_a_package_that_is_there_is_imported():
    assert import_extra("json", "--json", "none") is json


def test_a_missing_package_is_named_with_its_extra():
    with pytest.raises(InputError, match=r"--crs needs no_such_package: pip install 'antumbra\[gis\]'"):
        import_extra("no_such_package.crs", "--crs", "gis")


SCENE = at.Scene.from_arrays([[[0, 0, 0], [0, 2, 1], [1, 1, 0]]])
EXTRA_OF = {"OpenEXR": "exr", "scipy": "bake", "xatlas": "bake"}


@pytest.mark.parametrize(
    "package, words",
    [
        ("OpenEXR", "render procedural:atrium?triangles=1000 --size 8 -o a.exr"),
        ("OpenEXR", "render procedural:atrium?triangles=1000 --size 8 --sky sky.exr"),
        ("OpenEXR", "dataset procedural:atrium?triangles=1000 -o folder --size 8x8"),
        ("scipy", "bake box.glb -o a.glb --texture 64 --uv 0"),
        ("xatlas", "bake box.glb -o a.glb --texture 64"),
    ],
)
def test_commands_name_the_extra_before_they_work(package, words, cli, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "sky.exr").write_bytes(b"v/1\x01")
    cli("scenes", "atrium", "--triangles", "1000", "-o", "box.glb")
    monkeypatch.setitem(sys.modules, package, None)
    cli(*words.split()).refused(f"needs {package}", f"pip install 'antumbra[{EXTRA_OF[package]}]'")
    assert {path.name for path in tmp_path.iterdir()} <= {"sky.exr", "box.glb", "folder"}


def test_functions_name_the_extra(monkeypatch, tmp_path):
    matrix = at.visibility_matrix(SCENE, [[0.0, 3, 0], [1, 3, 0]])
    frame = at.render(SCENE, SCENE.default_camera(8, 8), spp=1)
    assert matrix.sparse().nnz == matrix.counts.sum() > 0
    monkeypatch.setitem(sys.modules, "scipy", None)
    monkeypatch.setitem(sys.modules, "OpenEXR", None)
    with pytest.raises(InputError, match=r"a sparse matrix needs scipy: pip install 'antumbra\[sparse\]'"):
        matrix.sparse()
    with pytest.raises(InputError, match=r"an \.exr file needs OpenEXR: pip install 'antumbra\[exr\]'"):
        frame.save(tmp_path / "a.exr")
    with pytest.raises(InputError, match=r"an \.exr file needs OpenEXR"):
        at.dataset(SCENE, tmp_path / "folder")
    assert not list(tmp_path.iterdir())
