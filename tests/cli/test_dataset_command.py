"""``antumbra dataset``: its answers, its options and its errors. tests/datasets has what the files hold."""

import json

import numpy as np
import pytest
from PIL import Image

SCENE = "procedural:atrium?triangles=2000"
SMALL = "--size", "24x16", "--spp", "2"


def test_a_data_set_and_its_sheet(cli, tmp_path):
    made = cli(
        "dataset", SCENE, "-o", "set", "--orbit", 2, "--random", 1, *SMALL, "--contact-sheet", "sheet.png", "--json"
    ).json()
    assert {k: made[k] for k in ("folder", "frames", "lights", "rendered", "finished", "complete")} == {
        "folder": "set", "frames": 3, "lights": 1, "rendered": 3, "finished": 0, "complete": True,
    }  # fmt: skip
    assert sorted(p.name for p in (tmp_path / "set" / "frames").glob("*.exr")) == [f"000{k}.exr" for k in range(3)]
    with Image.open(tmp_path / "sheet.png") as image:
        assert image.width > 500
    again = cli("dataset", SCENE, "-o", "set", "--orbit", 2, "--random", 1, *SMALL)
    assert again.code == 0 and "3 were finished" in again.out


def test_cameras_and_lights_are_in_the_order_of_the_options(cli, tmp_path):
    cameras = "--camera", 0, "--camera", "0,2,5:0,1,0:45", "--orbit", 1
    lights = "--light", "point:0,3,0", "--light", 0, "--ao", "inf@0.5", "--random-lights", 1
    assert cli("dataset", SCENE, "-o", "set", *cameras, *lights, *SMALL).code == 0
    found = json.loads((tmp_path / "set" / "manifest.json").read_text())
    assert [f["made"] for f in found["frames"]] == ["given", "given", "orbit"]
    camera = found["frames"][1]["camera"]
    assert (camera["position"], camera["vfov"], camera["width"], camera["height"]) == ([0, 2, 5], 45, 24, 16)
    lights = found["settings"]["lights"]
    assert [light["type"] for light in lights[:3]] == ["PointLight", "QuadLight", "AmbientOcclusion"]
    assert lights[3] == {"layer": "Light003", "drawn": "frame"}
    assert lights[2]["radius"] is None and lights[2]["intensity"] == 0.5


def test_ambient_light_comes_besides_the_scenes_lights(cli, tmp_path):
    assert cli("dataset", SCENE, "-o", "set", "--ao", "2", *SMALL).code == 0
    lights = json.loads((tmp_path / "set" / "manifest.json").read_text())["settings"]["lights"]
    assert [light["type"] for light in lights] == ["QuadLight", "AmbientOcclusion"]


def test_shards_say_what_is_missing(cli):
    first = cli("dataset", SCENE, "-o", "set", "--orbit", 2, "--shard", "1/2", *SMALL)
    assert first.code == 0 and "(shard 1/2)" in first.out and "other shards" in first.out
    second = cli("dataset", SCENE, "-o", "set", "--orbit", 2, "--shard", "0/2", *SMALL)
    assert second.code == 0 and "other shards" not in second.out


OPTIONS = {
    "-o": ["set", "./set"], "--random": ["3"], "--orbit": ["2"], "--random-lights": ["2"], "--seed": ["7", "07"],
    "--size": ["24x16"], "--spp": ["2"], "--light": ["point:0,3,0"], "--sampler": ["sobol"], "--time": ["0", "0.0"],
    "--lights-per": ["frame"],
}  # fmt: skip
"""Option -> its value, in spellings that mean the same."""


@pytest.mark.parametrize("seed", range(3))
def test_shards_in_any_order_of_their_options_are_the_whole(cli, tmp_path, seed):
    rng = np.random.default_rng(seed)

    def words(output):
        """The command with its options, and the scene among them, in a random order and random spellings."""
        parts = [[SCENE]]
        for name, values in OPTIONS.items():
            value = values[rng.integers(len(values))].replace("set", output)
            joined = name.startswith("--") and rng.random() < 0.5
            parts.append([f"{name}={value}"] if joined else [name, value])
        return ["dataset", *(word for k in rng.permutation(len(parts)) for word in parts[k])]

    assert cli(*words("whole")).code == 0
    for k in rng.permutation(4):
        given = words("set")
        place = int(rng.integers(1, 2))
        done = cli(*given[:place], "--shard", f"{k}/4", *given[place:])
        assert done.code == 0, done.err
    names = sorted(p.relative_to(tmp_path / "whole") for p in (tmp_path / "whole").rglob("*") if p.is_file())
    assert len(names) == 5 * (2 + 3) + 1
    for name in names:
        assert (tmp_path / "whole" / name).read_bytes() == (tmp_path / "set" / name).read_bytes(), name
    assert json.loads((tmp_path / "set" / "manifest.json").read_text())["complete"]


def test_quiet(cli):
    assert cli("dataset", SCENE, "-o", "set", *SMALL, "-q") == (0, "", "")


def test_other_settings_need_overwrite(cli):
    assert cli("dataset", SCENE, "-o", "set", *SMALL).code == 0
    cli("dataset", SCENE, "-o", "set", "--size", "24x16", "--spp", 4).refused("set", "spp 2, not 4", "--overwrite")
    assert cli("dataset", SCENE, "-o", "set", "--size", "24x16", "--spp", 4, "--overwrite").code == 0


@pytest.mark.parametrize(
    "arguments, words",
    [
        (("-o", "no/such/set"), ("does not exist",)),
        (("-o", "file"), ("is a file",)),
        (("-o", "set", "--shard", "4/4"), ("--shard", "0/4")),
        (("-o", "set", "--size", "0"), ("--size",)),
        (("-o", "set", "--camera", "1,2"), ("--camera 1,2",)),
        (("-o", "set", "--camera", "7"), ("no camera 7",)),
        (("-o", "set", "--light", "bulb:1"), ("--light", "bulb")),
        (("-o", "set", "--orbit", "-1"), ("--orbit",)),
        (("-o", "set", "--contact-sheet", "s.jpg"), ("s.jpg", ".png")),
        (("-o", "set", "--max-memory", "much"), ("--max-memory",)),
        ((), ("--output",)),
    ],
)
def test_bad_arguments_are_one_line_and_make_no_folder(cli, tmp_path, arguments, words):
    (tmp_path / "file").write_text("mine")
    cli("dataset", SCENE, *arguments).refused(*words)
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_an_interruption_says_how_to_go_on(cli, monkeypatch):
    from antumbra.datasets.dataset_files import DatasetFolder

    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(DatasetFolder, "write", interrupted)
    stopped = cli("dataset", SCENE, "-o", "set", *SMALL)
    assert stopped.code == 130 and "run the same command again to continue" in stopped.err
