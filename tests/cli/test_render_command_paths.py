"""`--path`: frames are the pictures of the cameras along a path, in memory and in a store, and of shards too."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import antumbra as at
from antumbra.cli.picture_spec import RenderArguments

KEYS = [
    {"time": 0, "position": [30, 20, 30], "target": [0, 2, 0]},
    {"time": 2, "position": [-30, 24, 30], "target": [0, 2, 8], "vfov": 40},
]
CAMERAS = "30,20,30:0,2,0:60", "0,22,30:0,2,4:50", "-30,24,30:0,2,8:40"
PICTURE = "--size", "24x16", "--spp", 2, "--light", "sun:1,-2,0.5@50000", "--exposure", "2e-4", "--quiet"


@pytest.fixture(scope="module")
def scenes(tmp_path_factory):
    """A small city, in memory and in a store."""
    store = tmp_path_factory.mktemp("path") / "city.antumbra"
    at.build_store(at.procedural("city", triangles=4000), store, chunk=256)
    return {"memory": "procedural:city?triangles=4k", "store": str(store)}


@pytest.fixture
def walk(tmp_path):
    path = tmp_path / "walk.json"
    path.write_text(json.dumps({"keys": KEYS}))
    return path


def pixels(name):
    with Image.open(name) as image:
        return np.asarray(image)


def frames(cli, scene, walk, *more, numbers="0:2"):
    return cli("render", scene, "--frames", numbers, "--fps", 1, "--path", walk, "-o", "f.#.png", *PICTURE, *more)


@pytest.mark.parametrize("kind", ["memory", "store"])
def test_frames_are_the_pictures_of_the_cameras_along_the_path(cli, scenes, walk, kind):
    done = frames(cli, scenes[kind], walk, numbers="0:3")
    assert done.code == 0 and "the animation ends" not in done.err  # a quiet run
    for k, camera in enumerate(CAMERAS):
        assert cli("render", scenes["memory"], "--camera=" + camera, "-o", "one.png", *PICTURE).code == 0
        assert (pixels(f"f.{k}.png") == pixels("one.png")).all()
    assert (pixels("f.3.png") == pixels("f.2.png")).all() and (pixels("f.1.png") != pixels("f.2.png")).any()


def test_finished_frames_are_kept_until_the_path_changes(cli, scenes, walk):
    report = lambda: [json.loads(line) for line in frames(cli, scenes["store"], walk, "--json").out.splitlines()]
    *told, _ = report()
    assert [line["time"] for line in told] == [0, 1, 2] and {line["state"] for line in told} == {"rendered"}
    assert {line["state"] for line in report()[:-1]} == {"finished"}
    walk.write_text(json.dumps({"keys": [KEYS[0], KEYS[1] | {"vfov": 41}]}))
    assert [line["state"] for line in report()[:-1]] == ["finished", "rendered", "rendered"]


def test_shards_render_their_frames_of_a_path(cli, scenes, walk):
    for share in ("0/2", "1/2"):
        assert frames(cli, scenes["store"], walk, "--shard", share).code == 0
    shared = [pixels(f"f.{k}.png") for k in range(3)]
    assert frames(cli, scenes["store"], walk, "--overwrite").code == 0
    assert all((pixels(f"f.{k}.png") == picture).all() for k, picture in enumerate(shared))


@pytest.mark.parametrize(
    "options, words",
    [
        (["--camera", "top", "--frames", "0:2", "-o", "f.#.png"], "--path and --camera both place the camera"),
        (["-o", "f.png"], "--path belongs to --frames"),
    ],
)
def test_options_that_a_path_excludes(cli, scenes, walk, options, words):
    done = cli("render", scenes["memory"], "--path", walk, *options)
    assert done.code == 2 and words in done.err and done.err.count("\n") == 1


def test_a_path_on_which_a_frame_has_no_camera_is_refused_before_any_frame(cli, scenes, walk):
    walk.write_text(json.dumps({"keys": [KEYS[0], {"time": 2, "position": [0, 2, 0], "target": [30, 20, 30]}]}))
    done = frames(cli, scenes["store"], walk)
    assert done.code == 2 and "walk.json: at 1 s, camera target is at the camera position" in done.err
    assert done.err.count("\n") == 1 and not [name for name in os.listdir() if name.startswith("f.")]


def test_the_file_of_a_path_is_read_before_the_scene():
    with pytest.raises(at.InputError, match=r"none.json"):
        RenderArguments("no scene", frames="0:1", camera_path=Path("none.json")).options()
