import json
import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import antumbra as at
from antumbra.cli import picture_spec, render_command
from antumbra.cli.arguments import FrameSequence, parse_frames
from antumbra.cli.console import ProgressDisplay
from antumbra.picture.image_files import note_of
from antumbra.picture.renderer import Renderer
from gltf_files import Gltf
from moving_square import FACES, FLOOR, write


@pytest.fixture
def moving(tmp_path):
    return write(tmp_path / "moving")


@pytest.fixture
def film(cli, moving):
    """Renders frames 0 to 3, one a second, to f.##.png with 4 rays; further arguments are added."""

    def run(*arguments, numbers="0:3"):
        view = "--size", "24", "--camera", "0,6,0.1:0,0,0", "--light", "sphere:0,4,0:0.3@50"
        usual = {"-o": "f.##.png", "--spp": 4}
        words = [word for name, value in usual.items() if name not in arguments for word in (name, value)]
        return cli("render", moving, *view, "--frames", numbers, "--fps", 1, *words, *arguments)

    return run


def lines(outcome, code=0) -> list[dict]:
    assert outcome.code == code, outcome
    return [json.loads(line) for line in outcome.out.splitlines()]


def states(outcome, code=0) -> list[str]:
    return [line["state"] for line in lines(outcome, code) if "state" in line]  # not the whole, not an error


def pictures(folder="."):
    return {name: open(name, "rb").read() for name in sorted(os.listdir(folder)) if name.startswith("f.")}


def test_each_frame_states_how_many_follow(film, monkeypatch):
    expected, expect = [], Renderer.expect
    monkeypatch.setattr(Renderer, "expect", lambda self, n: expected.append(n) or expect(self, n))
    lines(film("--json"))
    assert expected == [4, 3, 2, 1]


def test_every_frame_is_the_picture_of_its_moment(film, cli, moving):
    *told, total = lines(film("--json"))
    assert list(pictures()) == ["f.00.png", "f.01.png", "f.02.png", "f.03.png"]
    assert [line["time"] for line in told] == [0, 1, 2, 3] and [line["frame"] for line in told] == [0, 1, 2, 3]
    assert {line["exposure"] for line in told} == {total["exposure"]} and total["rendered"] == [0, 1, 2, 3]
    assert told[0]["rays"] > 0 and told[0]["timings"]["trace"] > 0 and total["timings"]["trace"] > 0
    seen = set()
    for line in told:
        alone = cli(
            "render", moving, "--size", 24, "--camera", "0,6,0.1:0,0,0", "--light", "sphere:0,4,0:0.3@50", "--spp", 4,
            "--time", line["time"], "--exposure", repr(told[0]["exposure"]), "-o", "alone.png",
        )  # fmt: skip
        assert alone.code == 0
        with Image.open("alone.png") as one, Image.open(line["output"]) as other:
            assert (np.asarray(one) == np.asarray(other)).all()
            seen.add(np.asarray(one).tobytes())
    assert len(seen) == 4


def test_numbers_and_moments():
    assert list(parse_frames("0:4").numbers) == [0, 1, 2, 3, 4] and parse_frames("0:4").fps == 24
    assert list(parse_frames("3:8:2").numbers) == [3, 5, 7] and list(parse_frames("7:7").numbers) == [7]
    assert FrameSequence(range(1), 24.0).time(12) == 0.5
    assert str(render_command.numbered(Path("a#/f.###.v##.png"), 7)) == os.path.join("a#", "f.###.v07.png")
    assert render_command.numbered(Path("f#.exr"), 123).name == "f123.exr"


def test_the_end_of_the_animation_is_held_and_said(film):
    done = film("--json", numbers="2:5")
    assert [line["time"] for line in lines(done)[:-1]] == [2, 3, 3, 3]
    assert "ends after 3 s" in done.err and done.err.count("\n") == 1
    made = [np.asarray(Image.open(f"f.0{k}.png")) for k in (3, 4, 5)]
    assert (made[0] == made[1]).all() and (made[0] == made[2]).all()
    assert film("--quiet", "--overwrite", numbers="2:5") == (0, "", "")


def test_finished_frames_are_not_rendered_again(film):
    assert states(film("--json", numbers="0:1")) == ["rendered"] * 2
    before = pictures()
    assert states(film("--json")) == ["finished", "finished", "rendered", "rendered"]
    os.remove("f.00.png")
    assert states(film("--json", "--threads", 1, "--plan", "bsah+multifrusta")) == ["rendered"] + ["finished"] * 3
    assert {name: pictures()[name] for name in before} == before
    told = film()
    assert told.code == 0 and "0 rendered, 4 were finished" in told.out
    assert states(film("--json", "--overwrite")) == ["rendered"] * 4


def test_other_settings_are_other_pictures(film):
    for option, name in ((("--spp", 8), "spp"), (("--exposure", 2), "exposure"), (("--up", "z"), "up")):
        film("--quiet")
        other = film("--json", *option)
        assert states(other) == ["rendered"] * 4
        assert f"f.00.png exists, with other settings ({name}" in other.err and other.err.count("\n") == 1
        assert states(film("--json", *option)) == ["finished"] * 4
    assert film("--quiet", "--spp", 8) == (0, "", "")


def test_another_scene_means_other_pictures(film, moving):
    film("--quiet")
    moments = np.load(moving / "frames.npy")
    np.save(moving / "frames.npy", moments + np.float32(0.25))
    other = film("--json")
    assert states(other) == ["rendered"] * 4 and "(scene" in other.err


@pytest.mark.parametrize("content", [b"", b"\x89PNG\r\n\x1a\n", b"no picture"])
def test_files_that_are_no_frames_of_ours_are_replaced(film, content):
    with open("f.01.png", "wb") as file:
        file.write(content)
    done = film("--json")
    assert states(done) == ["rendered"] * 4 and "f.01.png exists, not from an animation" in done.err
    with Image.open("f.01.png") as image:
        assert image.size == (24, 24) and json.loads(note_of(Path("f.01.png")))["spp"] == 4


def test_all_frames_have_the_exposure_of_the_first(film, monkeypatch):
    chosen = iter((2.0, 7.0, 9.0))
    monkeypatch.setattr("antumbra.picture.image_files.frame_exposure", lambda frame: next(chosen))
    assert [line["exposure"] for line in lines(film("--json", numbers="1:3"))] == [2.0] * 4
    # Frame 0 now comes before finished frames, as after a failure. It gets their exposure.
    done = film("--json")
    assert [line["exposure"] for line in lines(done)] == [2.0] * 5
    assert states(done) == ["rendered", *["finished"] * 3]
    assert [line["exposure"] for line in lines(film("--json", "--overwrite"))] == [7.0] * 5
    assert states(film("--json", numbers="2:3")) == ["finished"] * 2
    assert [line["exposure"] for line in lines(film("--json", "--exposure", 3))] == [3.0] * 5


def test_a_frame_that_fails_is_named_and_the_others_go_on(film, moving):
    write(moving, bad=[1])
    done = film("--json")
    told = lines(done, code=2)
    assert states(done, code=2) == ["rendered", "failed", "rendered", "rendered"]
    assert (told[-1]["rendered"], told[-1]["failed"]) == ([0, 2, 3], [1])
    assert done.err.startswith("antumbra: frame 1: ") and "vertex 5" in done.err and done.err.count("\n") == 1
    assert "vertex 5" in told[1]["reason"] and list(pictures()) == ["f.00.png", "f.02.png", "f.03.png"]
    again = film()
    assert again.code == 2 and "3 were finished, 1 failed (1)" in again.out
    assert film("--quiet").err.startswith("antumbra: frame 1: ")


def test_a_full_disk_fails_the_frame(film, monkeypatch, tmp_path):
    from antumbra.picture import image_files

    write_png, calls = image_files.write_png, []

    def full_once(*arguments):
        calls.append(arguments)
        if len(calls) == 2:
            raise OSError(28, "No space left on device")
        write_png(*arguments)

    monkeypatch.setattr(image_files, "write_png", full_once)
    done = film("--json")
    assert states(done, code=2) == ["rendered", "failed", "rendered", "rendered"]
    assert done.err.startswith("antumbra: frame 1: f.01.png: ") and "No space left" in done.err
    assert sorted(os.listdir(tmp_path)) == ["f.00.png", "f.02.png", "f.03.png", "moving"]


def test_a_bug_in_one_frame_is_told_and_the_others_go_on(film, monkeypatch):
    shot = picture_spec.PictureSpec.shot

    def stumbling(self, scene, renderer, time, *more):
        return shot(self, scene, renderer, time, *more) if time != 2 else 1 / 0

    monkeypatch.setattr(picture_spec.PictureSpec, "shot", stumbling)
    done = film("--json")
    assert states(done, code=1) == ["rendered", "rendered", "failed", "rendered"]
    assert "frame 2: unexpected ZeroDivisionError" in done.err and "--debug" in done.err
    with pytest.raises(ZeroDivisionError):
        film("--debug")


def test_interrupting_leaves_finished_frames_and_says_so(film, monkeypatch, tmp_path):
    parts = ProgressDisplay.parts

    def interrupt(self, text, count, index, of):
        if index < 2:
            return parts(self, text, count, index, of)
        raise KeyboardInterrupt

    monkeypatch.setattr(ProgressDisplay, "parts", interrupt)
    done = film()
    assert (done.code, done.out) == (130, "")
    assert done.err.splitlines() == [
        "antumbra: 2 of 4 frames are finished; run the same command again to continue",
        "antumbra: interrupted",
    ]
    assert sorted(os.listdir(tmp_path)) == ["f.00.png", "f.01.png", "moving"]
    monkeypatch.undo()
    os.chdir(tmp_path)
    assert states(film("--json")) == ["finished", "finished", "rendered", "rendered"]


def test_one_renderer_and_one_scene_for_all_frames(film, monkeypatch):
    made = []
    monkeypatch.setattr(at, "Renderer", lambda *args, **more: made.append(Renderer(*args, **more)) or made[-1])
    assert film("--quiet").code == 0 and len(made) == 1


@pytest.mark.parametrize("rays", ["last-frame", "2,last-frame,bounce", "all"])
def test_rays_that_a_builder_is_shown_change_no_bit(film, rays):
    film("--quiet", "--plan", "bsah+single")
    wanted = pictures()
    *told, total = lines(film("--json", "--overwrite", "--plan", "srdh+single", "--srdh-rays", rays))
    assert [line["state"] for line in told] == ["rendered"] * 4 and pictures() == wanted
    assert total["srdh_rays"]["last_frame"] is ("last-frame" in rays) and len(set(wanted.values())) == 4
    assert states(film("--json", "--plan", "srdh+single", "--srdh-rays", "3")) == ["finished"] * 4


def test_exr_frames_are_finished_too(film):
    more = "--json", "-o", "f.##.exr"
    *told, total = lines(film(*more))
    assert total["exposure"] is None and {line["exposure"] for line in told} == {None}
    assert states(film(*more)) == ["finished"] * 4 and states(film(*more, "--exposure", 2)) == ["finished"] * 4
    assert states(film(*more, "--spp", 8)) == ["rendered"] * 4


def test_cameras_and_lights_of_the_file_move(cli, tmp_path):
    made = Gltf()
    made.node(mesh=made.mesh(made.primitive(np.array(FLOOR, np.float32), FACES[:2].astype(np.uint16))))
    camera = made.node(camera=made.add("cameras", type="perspective", perspective={"yfov": 0.8, "znear": 0.1}))
    made.json["extensionsUsed"] = ["KHR_lights_punctual"]
    made.json["extensions"] = {"KHR_lights_punctual": {"lights": [{"type": "point", "intensity": 3.0}]}}
    light = made.node(extensions={"KHR_lights_punctual": {"light": 0}})
    made.animate(camera, "translation", [0, 1], [[0, 1, 4], [2, 1, 4]])
    made.animate(light, "translation", [0, 1], [[0, 3, 0], [0, 5, 0]])
    told = lines(cli("render", made.write(tmp_path), "--size", 16, "--frames", "0:24:12", "--json"))[:-1]
    assert [line["output"] for line in told] == ["made.0000.png", "made.0012.png", "made.0024.png"]
    assert [line["camera"]["position"][0] for line in told] == [0, 1, 2]
    assert [line["lights"][0]["position"][1] for line in told] == [3, 4, 5]


def test_what_people_are_told(film):
    done = film()
    for word in ("f.00.png to f.03.png", "4 rendered", "moving", "exposure", "trace", "save", "at most", "mean of"):
        assert word in done.out, done.out
    assert done.err == ""


@pytest.mark.parametrize(
    "arguments, words",
    [
        (("--frames", "5"), ["--frames", "FIRST:LAST"]),
        (("--frames", "5:2"), ["5:2", "FIRST <= LAST"]),
        (("--frames", "0:5:0"), ["STEP >= 1"]),
        (("--frames", "-1:5"), ["--frames"]),
        (("--frames", "0:5", "--time", "1"), ["--time", "k / fps"]),
        (("--frames", "0:5", "--fps", "0"), ["--fps is 0"]),
        (("--frames", "0:5", "--fps", "nan"), ["--fps is nan"]),
        (("--frames", "0:5", "-o", "f.png"), ["f.png", "f.####.png"]),
        (("--frames", "0:5", "-o", "none/f.####.png"), ["none", "does not exist"]),
        (("--frames", "0:5", "-o", "f.####.jpg"), ["f.####.jpg", ".png, .exr, .mp4"]),
        (("--frames", "0:5", "-o", "f.####"), [".png, .exr, .mp4"]),
        (("--frames", "0:5", "--camera", "9"), ["no camera 9"]),
        (("--frames", "0:5", "--light", "9"), ["no light 9"]),
        (("-o", "f.####.png"), ["f.####.png", "--frames"]),
        (("--fps", "24"), ["--fps", "--frames"]),
        (("--plan", "srdh+single", "--srdh-rays", "last-frame"), ["last-frame", "--frames"]),
        (("--frames", "0:5", "--srdh-rays", "last-frame"), ["auto", "is ray-guided"]),
    ],
)
def test_bad_options(render, tmp_path, arguments, words):
    render(*arguments).refused(*words)
    assert os.listdir(tmp_path) == []
