"""The script that shows the default pictures of all scenes side by side."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gltf_files import TETRAHEDRON, TETRAHEDRON_FACES, single

SCRIPT = Path(__file__).parents[2] / "scripts" / "montage.py"


@pytest.fixture(scope="module")
def montage():
    spec = importlib.util.spec_from_file_location("montage", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def scenes(tmp_path):
    (tmp_path / "gltf").mkdir()
    single(TETRAHEDRON, TETRAHEDRON_FACES).write(tmp_path).rename(tmp_path / "gltf" / "one.glb")
    return tmp_path


def test_scenes_are_those_of_a_folder_and_procedural_ones(montage, scenes):
    (scenes / "hall").mkdir()
    (scenes / "hall" / "scene.glb").touch()
    found = montage.scenes_in(scenes)
    assert list(found)[:2] == ["hall", "one"] and found["atrium"] == "procedural:atrium"
    assert found["hall"] == str(scenes / "hall" / "scene.glb")


def test_each_scene_is_a_tile(montage, scenes, tmp_path):
    out = tmp_path / "all.png"
    (scenes / "gltf" / "one_broken.glb").write_bytes(b"no glTF")
    arguments = [
        str(out),
        "--scenes",
        str(scenes),
        "--only",
        "one",
        "--size",
        "48",
        "--columns",
        "2",
        "--",
        "--spp",
        "1",
    ]
    assert montage.main(arguments) == 1  # one of them cannot be rendered
    picture = np.array(Image.open(out))
    assert picture.shape == (48, 2 * 48 + montage.GAP, 3)
    assert len(np.unique(picture[20:, :48].reshape(-1, 3), axis=0)) > 10
    assert (picture[20:, 52:] == montage.BEHIND).all()
