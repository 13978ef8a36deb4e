"""Camera paths: keys are met at their times and interpolated in between; whatever is no path is refused in one line."""

import json

import numpy as np
import pytest

import antumbra as at
from antumbra.formats.camera_paths import read_camera_path
from gltf_files import Gltf

KEYS = [
    {"time": 1, "position": [1, 1, 8], "target": [0, 1, 0]},
    {"time": 3, "position": [4, 1, 4], "target": [0, 2, 0], "up": [1, 0, 0], "vfov": 40},
    {"time": 4, "position": [4, 1, 1], "target": [0, 2, 0], "vfov": 20.5},
]
SIZE = 40, 30


def written(tmp_path, keys):
    path = tmp_path / "walk.json"
    path.write_text(keys if isinstance(keys, str) else json.dumps({"keys": keys}))
    return path


def numbers(camera):
    return [*camera.position, *camera.target, *camera.up, camera.vfov]


@pytest.mark.parametrize("up, usual", [("y", [0, 1, 0]), ("z", [0, 0, 1])])
def test_cameras_between_keys_are_interpolated(tmp_path, up, usual):
    path = read_camera_path(written(tmp_path, KEYS))
    rows = [[1, 1, 8, 0, 1, 0, *usual, 60], [4, 1, 4, 0, 2, 0, 1, 0, 0, 40], [4, 1, 1, 0, 2, 0, *usual, 20.5]]
    assert path.duration == 4.0
    for time, row in zip((1, 3, 4), rows):
        camera = path.camera(time, up, SIZE)
        assert numbers(camera) == row and (camera.width, camera.height) == SIZE
    for time, share in ((1.5, 0.25), (2, 0.5)):
        expected = (1 - share) * np.array(rows[0]) + share * np.array(rows[1])
        np.testing.assert_allclose(numbers(path.camera(time, up, SIZE)), expected, rtol=1e-15)
    assert numbers(path.camera(-9, up, SIZE)) == rows[0] and numbers(path.camera(99, up, SIZE)) == rows[2]


@pytest.mark.parametrize(
    "keys, words",
    [
        ("[1, 2]", "must be a JSON object"),
        ("{", "JSON cannot be read"),
        ("{}", "has no keys"),
        ([], "has no keys"),
        ([3], "must be a JSON object"),
        ([KEYS[0] | {"fov": 3}], r"keys\[0\].fov is unknown; a key has time, position, target, up or vfov"),
        ([{"time": 0, "target": [0, 0, 0]}], "position is missing"),
        ([KEYS[0] | {"target": [0, 1]}], "a list of 3 numbers"),
        ([KEYS[0] | {"time": None}], "time is missing"),
        ([KEYS[0] | {"up": ["a", 0, 1]}], "finite number"),
        ([KEYS[1], KEYS[0]], r"keys\[1\].time is 1; it must be later"),
        ([KEYS[0], KEYS[0]], r"keys\[1\].time is 1; it must be later"),
    ],
)
def test_a_file_that_is_no_path_is_refused(tmp_path, keys, words):
    with pytest.raises(at.InputError, match=words) as caught:
        read_camera_path(written(tmp_path, keys))
    assert str(caught.value).startswith("walk.json") and "\n" not in str(caught.value)


@pytest.mark.parametrize("change, words", [({"target": [1, 1, 8]}, "target is at"), ({"vfov": 190}, "vfov")])
def test_a_camera_that_cannot_be_is_refused_with_its_time(tmp_path, change, words):
    path = read_camera_path(written(tmp_path, [KEYS[0] | change]))
    with pytest.raises(at.InputError, match=f"walk.json: at 2.5 s, camera .*{words}"):
        path.camera(2.5, "y", SIZE)


def moving_camera(times=(0.0, 2.0), lens=True):
    made = Gltf()
    made.node(mesh=made.mesh())
    lens = {"camera": made.add("cameras", type="perspective", perspective={"yfov": 0.7, "znear": 0.1})} if lens else {}
    node = made.node(translation=[1, 2, 3], rotation=[0, 0.6, 0, 0.8], **lens)
    if times:
        made.animate(node, "translation", times, [[1, 2, 3], [5, 2, -1]])
    return made


def test_a_gltf_camera_moves_as_in_its_scene(tmp_path):
    file = moving_camera().write(tmp_path)
    path, scene = read_camera_path(file), at.load(file)
    assert path.duration == scene.duration == 2.0
    for time in (0.0, 0.5, 2.0, 7.0):
        camera, same = path.camera(time, "y", SIZE), scene.camera(0, min(time, 2.0))
        assert numbers(camera) == numbers(same) and (camera.width, camera.height) == SIZE
        turned = path.camera(time, "z", SIZE)
        for name in ("position", "target", "up"):
            x, y, z = getattr(camera, name)
            assert getattr(turned, name).tolist() == [x, -z, y]


@pytest.mark.parametrize("made", [moving_camera(times=()), moving_camera(lens=False)], ids=["still", "no camera"])
def test_a_gltf_file_without_a_moving_camera_is_refused(tmp_path, made):
    with pytest.raises(at.InputError, match=r"made.glb: has no camera that moves; animate one, or use --camera"):
        read_camera_path(made.write(tmp_path))


@pytest.mark.parametrize("name, words", [("none.json", "no such file"), ("walk.txt", "is no camera path; give a")])
def test_other_files_are_refused(tmp_path, name, words):
    (tmp_path / "walk.txt").write_text("0 0 0")
    with pytest.raises(at.InputError, match=words):
        read_camera_path(tmp_path / name)
