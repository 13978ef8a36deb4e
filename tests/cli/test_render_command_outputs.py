"""Several outputs of one picture, in every format, and what an EXR file has that was written from Python."""

import json
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from PIL import Image

import antumbra as at
from antumbra.picture.image_files import note_of
from moving_square import write


def channels(path):
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {name: channel.pixels for name, channel in file.channels().items()}


def test_a_picture_is_written_in_every_format_that_is_named(render, tmp_path):
    told = render("--spp", 4, "--json", "-o", "a.exr", "-o", "a.png", "-o", "b.png").json()
    assert told["output"] == "a.exr" and told["outputs"] == ["a.exr", "a.png", "b.png"] and told["exposure"] > 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.exr", "a.png", "b.png"]
    render("--spp", 4, "-o", "alone.exr"), render("--spp", 4, "-o", "alone.png")
    assert Path("a.exr").read_bytes() == Path("alone.exr").read_bytes()
    assert Path("a.png").read_bytes() == Path("b.png").read_bytes() == Path("alone.png").read_bytes()


def test_the_summary_names_all_pictures(render):
    assert "a.exr, a.png" in render("--spp", 1, "-o", "a.exr", "-o", "a.png").out


def test_frames_are_written_in_every_format_and_resume(cli, tmp_path):
    write(tmp_path / "moving")
    words = ["render", "moving", "--size", 16, "--spp", 1, "--frames", "0:1", "--fps", 1, "--json"]
    many = [*words, "-o", "f.#.exr", "-o", "f.#.png"]
    lines = [json.loads(line) for line in cli(*many).out.splitlines()]
    assert [line["outputs"] for line in lines] == [
        ["f.0.exr", "f.0.png"],
        ["f.1.exr", "f.1.png"],
        ["f.#.exr", "f.#.png"],
    ]
    assert "light.sun.R" in channels("f.1.exr") and Image.open("f.1.png").size == (16, 16)
    pictures = {path: path.read_bytes() for path in tmp_path.glob("f.*")}
    again = [json.loads(line) for line in cli(*many).out.splitlines()]
    assert again[-1]["finished"] == [0, 1] and again[-1]["exposure"] == lines[-1]["exposure"] > 0
    Path("f.1.png").unlink()
    assert json.loads(cli(*many).out.splitlines()[-1])["rendered"] == [1]
    assert {path: path.read_bytes() for path in tmp_path.glob("f.*")} == pictures
    cli(*words, "-o", "alone.#.png")
    assert Path("alone.1.png").read_bytes() == Path("f.1.png").read_bytes()


def test_shards_of_several_outputs_are_joined(render, cli):
    words = "--spp", 4, "-o", "a.exr", "-o", "a.png"
    for k in (1, 0):
        assert render(*words, "--shard", f"{k}/2").code == 0
    assert cli("merge", "a.shards").code == 0
    render("--spp", 4, "-o", "whole.exr", "-o", "whole.png")
    for suffix in (".exr", ".png"):
        assert Path(f"a{suffix}").read_bytes() == Path(f"whole{suffix}").read_bytes()


def test_what_cannot_be_written_together_is_refused(cli, tmp_path):
    write(tmp_path / "moving"), (tmp_path / "other").mkdir()
    frames = ["render", "moving", "--frames", "0:1"]
    cli(*frames, "-o", "a.mp4", "-o", "a.#.png").refused("a.mp4", "only output", "leave the other --output out")
    cli(*frames, "-o", "a.#.png", "-o", "other/a.#.exr").refused("other/a.#.exr", "one folder")
    cli("render", "moving", "-o", "a.png", "-o", "./a.png").refused("a.png", "named twice")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["moving", "other"]


# --- From Python ------------------------------------------------------------------------------------------------------


def test_exr_from_python_has_the_channels_and_settings_of_the_command(cli, tmp_path):
    write(tmp_path / "moving")
    view = "--camera", "0,6,0.1:0,0,0", "--light", "sphere:0,4,0:0.3@50", "--ground", "off", "--size", "24"
    assert cli("render", "moving", *view, "--spp", 4, "--seed", 5, "--no-ambient", "-o", "a.exr").code == 0
    camera = at.Camera((0, 6, 0.1), (0, 0, 0), width=24, height=24)
    light = at.SphereLight((0, 4, 0), 0.3, intensity=50)
    frame = at.render("moving", camera, light, spp=4, seed=5, ambient=False, filter=True, layers=True)
    frame.save("b.exr")
    a, b = channels("a.exr"), channels("b.exr")
    assert a.keys() == b.keys() and {"light.sphere.R", "albedo.R", "object.id"} < a.keys()
    for name in a:
        np.testing.assert_array_equal(a[name], b[name], name)
    of_command, of_python = (json.loads(note_of(Path(name))) for name in ("a.exr", "b.exr"))
    assert of_python == {name: of_command[name] for name in of_python}
    assert of_command.keys() - of_python.keys() == {"scene", "up", "vpl", "behind"}
    assert of_python["seed"] == 5 and of_python["camera"]["position"] == [0, 6, 0.1] and of_python["ambient"] is False
    assert of_python["lights"][0]["type"] == "SphereLight"


def floor_frame(light, **options):
    scene = at.Scene.from_arrays(np.array([[(-9, 0, -9), (0, 0, 9), (9, 0, -9)]], float), colours=np.full((1, 3), 0.5))
    camera = at.Camera((0, 3, 0), (0, 0, 0), up=(0, 0, 1), vfov=40, width=16, height=16)
    return at.render(scene, camera, light, **options)


def test_an_image_without_ambient_light_has_the_closed_form_of_its_lamp():
    """Base colour 0.5 times irradiance / pi; the inverse square law gives the irradiance."""
    lamp = at.PointLight((0.5, 2, 0.25), intensity=30.0)
    frame = floor_frame(lamp, ambient=False)
    place = frame.gbuffer.position.astype(float) + frame.gbuffer.origin
    to_lamp = np.array(lamp.position) - place
    distance = np.linalg.norm(to_lamp, axis=-1)
    expected = 0.5 / np.pi * 30.0 * to_lamp[..., 1] / distance**3
    np.testing.assert_allclose(frame.image, np.repeat(expected[..., None], 3, 2), rtol=2e-6)
    assert (frame.ambient == 0).all()
    usual = floor_frame(lamp)
    assert usual.ambient.min() > 0 and (usual.image > 1.05 * frame.image).all()


def test_without_ambient_light_the_layers_add_up_to_the_image():
    lights = [at.PointLight((0.5, 2, 0.25), intensity=30.0), at.DirectionalLight((0.2, -1, 0), intensity=2.0)]
    frame = floor_frame(lights, ambient=False, layers=True)
    np.testing.assert_allclose(sum(frame.layers.lights), frame.image, rtol=1e-6)


def test_shadows_are_black_without_ambient_light(render):
    frame = floor_frame(at.PointLight((0, -2, 0)), ambient=False)  # below the floor
    assert (frame.image == 0).all()


def test_ambient_occlusion_needs_ambient_light(render):
    with pytest.raises(at.InputError, match="AmbientOcclusion dims; leave one of them out"):
        floor_frame([at.PointLight((0, 2, 0)), at.AmbientOcclusion()], ambient=False)
    render("--ao", 2, "--no-ambient").refused("ambient=False", "AmbientOcclusion")
