import json
import os
import re
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from PIL import Image

import antumbra as at
from antumbra.cli.console import ProgressDisplay
from antumbra.cli.picture_report import light_text
from antumbra.cli.picture_spec import ROOM_LIGHT
from gltf_files import png


def pixels(path):
    with Image.open(path) as image:
        return np.asarray(image)


def test_a_picture_and_a_summary(render, tmp_path):
    done = render("--spp", 4)
    assert done.code == 0
    assert os.listdir(tmp_path) == ["antumbra.png"]
    assert pixels("antumbra.png").shape == (32, 32, 3) and pixels("antumbra.png").std() > 1.0
    for word in (
        "antumbra.png",
        "atrium",
        "triangles",
        "32x32",
        "rectangular light of 2.2 x 2.267 (1 cd)",
        "(4 per pixel and light)",
        "auto: lbvh+",
        "trace",
        "save",
    ):
        assert word in done.out, done.out
    assert "uncertain" not in done.out


def test_the_summary_says_that_textures_are_missing(cli, tmp_path):
    (tmp_path / "a.mtl").write_text("".join(f"newmtl m{i}\nmap_Kd lost{i}.png\n" for i in range(3)))
    faces = "".join(f"usemtl m{i}\nf 1/1 2/2 3/3\n" for i in range(3))
    vertices = "v 0 0 0\nv 0 0 1\nv 1 0 0\nvt 0 0\nvt 1 0\nvt 0 1\n"
    (tmp_path / "a.obj").write_text(f"mtllib a.mtl\n{vertices}{faces}")
    done = cli("render", "a.obj", "--size", 16, "--spp", 1)
    notes = [line for line in done.out.splitlines() if line.startswith("note ")]
    assert done.code == 0 and len(notes) == 1, done.out
    assert "lost0.png" in notes[0] and "shown in pink" in notes[0] and "2 more of this kind" in done.out


def test_the_summary_as_json(render):
    told = render("--json", "--counters", "--spp", 4, "-o", "x.exr").json()
    assert told["output"] == "x.exr" and told["exposure"] is None
    assert told["scene"]["name"] == "atrium" and told["scene"]["notes"] == []
    assert told["camera"]["width"] == 32 and len(told["camera"]["position"]) == 3
    assert [light["type"] for light in told["lights"]] == ["QuadLight"]
    assert (told["spp"], told["plan"], told["gbuffer"], told["threads"]) == (4, "auto", "auto", None)
    assert told["ran"].startswith("lbvh+") and [choice["rays"] for choice in told["choices"]] == [told["rays"]]
    tree = told["tree"]
    assert (tree["culler"], tree["builder"], tree["why"]) == (None, "lbvh", "too few rays for a better tree")
    assert told["rays"] == 4 * told["seen"] == told["counters"]["rays"] > 0
    assert 0.0 < told["lit"][0] < 1.0
    assert {"evaluate", "gbuffer", "build", "trace", "shade", "total"} <= told["timings"].keys()
    assert min(told["load"], told["save"], told["mrays_per_second"]) > 0.0
    assert told["uncertain_fraction"] == told["counters"]["uncertain"] / told["counters"]["triangle_tests"] < 1e-2


@pytest.mark.parametrize("size", ["8x8", "64x48"])
def test_the_choices_of_a_picture_are_listed_with_their_reasons(cli, size):
    """However few its rays are: pictures of up to 256 rays are not worth a choice of strategy."""
    done = cli("render", "procedural:atrium?triangles=2000", "--spp", 1, "--size", size, "--explain-plan")
    rows = [line.split() for line in done.out.splitlines()]
    (tree,) = [row for row in rows if row[:1] == ["tree"]]
    (query,) = [row for row in rows if row[:1] == ["quad"]]
    assert done.code == 0 and "lbvh" in tree and "too few rays for a better tree" in " ".join(tree)
    assert (" ".join(query[3:5]) == "few rays") == (size == "8x8")


def test_cull_faces(render):
    both, back = (render("--spp", 1, "--json", *more).json() for more in ((), ("--cull-faces", "back")))
    assert both["cull_faces"] is None and back["cull_faces"] == "back"
    assert back["lit"][0] >= both["lit"][0]


def test_json_without_counters(render):
    told = render("--json").json()
    assert told["counters"] is None and told["uncertain_fraction"] is None
    assert told["output"] == "antumbra.png" and told["exposure"] > 0.0


def test_counters_for_people(render):
    told = render("--counters").out
    assert "triangle tests" in told and "repeated in float64" in told


def test_filter_and_adaptive_sampling_for_people(render):
    told = render("--filter", "--adaptive", "--spp", 4).out
    assert "(4 per pixel and light, 16 where refined)" in told and "% of the pixels" in told
    assert "refined" not in render("--filter").out


def test_filter_and_adaptive_sampling_as_json(render):
    plain, told = render("--json").json(), render("--json", "--filter", "--adaptive-spp", 32).json()
    assert (plain["filter"], plain["adaptive"], plain["refined"]) == (True, None, None)
    assert (told["filter"], told["adaptive"]) == (True, 32)
    assert 0.0 < told["refined"] < 1.0 and told["rays"] > plain["rays"] and told["seen"] == plain["seen"]
    assert render("--json", "--adaptive", "--spp", 500, size="4x4").json()["adaptive"] == 1024


def test_quiet(render):
    assert render("--quiet") == (0, "", "")
    assert render("-q", "--json").json()["output"] == "antumbra.png"


def test_the_same_arguments_give_the_same_file_however_it_is_computed(render):
    plain = render("-o", "a.png")
    assert plain.code == 0
    for name, more in [
        ("b", ()),
        ("c", ("--threads", 1)),
        ("d", ("--gbuffer", "rays")),
        ("e", ("--counters", "--threads", 3)),
    ]:
        assert render("-o", f"{name}.png", *more).code == 0
        assert (pixels(f"{name}.png") == pixels("a.png")).all(), more


@pytest.mark.parametrize(
    "option",
    [
        ("--spp", "2"),
        ("--sampler", "sobol"),
        ("--sampler", "halton"),
        ("--bounce", "3"),
        ("--no-filter",),
        ("--preset", "draft"),
        ("--sky", "white"),
        ("--adaptive",),
        ("--no-antialias",),
        ("--exposure", "0.001"),
        ("--camera", "0,1,0:1,1,0"),
    ],
)
def test_options_that_change_the_picture(render, option):
    assert render("-o", "a.png").code == render("-o", "b.png", *option).code == 0
    assert (pixels("a.png") != pixels("b.png")).any()


def test_the_seed_reaches_the_scene(render):
    for seed in (0, 1):
        assert render("-o", f"{seed}.png", scene=f"procedural:atrium?triangles=2k&seed={seed}").code == 0
    assert (pixels("0.png") != pixels("1.png")).any()


def test_exr_and_png_hold_what_the_library_renders(render):
    assert render("-o", "a.exr").code == 0
    assert render("-o", "a.png").code == 0
    scene = at.procedural("atrium", triangles=2000)
    frame = at.render(scene, scene.cameras[0].resized(32, 32), filter=True)
    with OpenEXR.File("a.exr", separate_channels=True) as file:
        channels = {name: channel.pixels for name, channel in file.channels().items()}
    assert (channels["shadow.quad"] == frame.visibility[0]).all() and 0.0 < frame.visibility[0].mean() < 1.0
    assert (channels["depth.Z"] == frame.gbuffer.depth).all()
    assert (channels["R"] == frame.image[..., 0]).all()
    frame.save("b.png")
    assert (pixels("a.png") == pixels("b.png")).all()


def test_lights_and_cameras_reach_the_frame(render):
    told = render(
        "--json", "--light", "point:0,3,0@5", "--light", "0", "--light", "sun:0,-1,0.2", "--camera", "-1,1,0:1,1,0:40"
    ).json()
    assert [light["type"] for light in told["lights"]] == ["PointLight", "QuadLight", "DirectionalLight"]
    assert told["lights"][0]["position"] == [0, 3, 0] and told["lights"][0]["intensity"] == 5
    assert len(told["lit"]) == 3 and told["rays"] == (1 + 16 + 16) * told["seen"]
    assert told["camera"]["position"] == [-1, 1, 0] and told["camera"]["vfov"] == 40


def test_ambient_occlusion_comes_on_top_of_the_lights(render):
    told = render("--json", "--ao", "0.5@2", "-o", "a.png").json()
    assert [light["type"] for light in told["lights"]] == ["QuadLight", "AmbientOcclusion"]
    assert told["lights"][1]["radius"] == 0.5 and told["lights"][1]["intensity"] == 2
    everything = render("--json", "--ao", "inf", "-o", "b.png").json()
    assert everything["lights"][1]["radius"] is None
    assert 0 < everything["lit"][1] < told["lit"][1] < 1
    assert (pixels("a.png") != pixels("b.png")).any()


def test_photons_become_lights(render):
    told = render("--json", "--vpl", 100).json()
    light = told["lights"][1]
    assert light["type"] == "PointLights" and light["interleave"] and 20 < light["count"] <= 100
    assert told["rays"] == told["seen"] * (16 + -(-light["count"] // 16))
    assert "16 + " in render("--vpl", 100).out


def test_light_bounces(render):
    done = render("--bounce", 3, "-o", "a.png")
    assert "3 bounces per pixel" in done.out
    told = render("--bounce", 3, "-o", "b.png", "--json", "--plan", "bsah+single", "--threads", 1).json()
    assert told["bounce"] == 3 and 17 * told["seen"] < told["rays"] <= 19 * told["seen"]
    assert [light["type"] for light in told["lights"]] == ["QuadLight"]
    assert (pixels("a.png") == pixels("b.png")).all()
    assert render("--bounce", 3, "--sampler", "halton:full", "-o", "b.png").code == 0
    further = render("--bounce", 3, "--bounces", 2, "-o", "c.png")
    assert "3 paths of 2 bounces per pixel" in further.out
    assert (pixels("a.png") != pixels("b.png")).any()


def test_a_file_is_rendered_to_its_own_name(render, square_obj, tmp_path):
    told = render("--json", scene=square_obj).json()
    assert told["output"] == "square.png" and told["scene"]["triangles"] == 2
    assert [light["type"] for light in told["lights"]] == ["DirectionalLight", "Sky"] and 0 < told["seen"] < 32 * 32
    assert sorted(os.listdir(tmp_path)) == ["square.obj", "square.png"]


def test_straight_down_is_a_view(render, square_obj):
    told = render("--json", "--camera", "0,1,0:0,0,0:80", "--light", "sun:0,-1,0", scene=square_obj).json()
    assert told["seen"] == 32 * 32 and told["lit"] == [1.0]


def test_up_reaches_the_scene(render, square_obj):
    told = render("--json", "--up", "z", scene=square_obj).json()
    assert told["scene"]["up"] == "z" and told["camera"]["up"] == [0, 0, 1]


def test_an_empty_view_is_said_and_is_no_error(render, square_obj):
    done = render("--camera", "0,1,0:0,2,1", scene=square_obj)
    assert done.code == 0 and "the camera sees no surface" in done.out
    assert pixels("square.png").any()  # the sky
    assert render("--sky", "none", "--camera", "0,1,0:0,2,1", scene=square_obj).code == 0
    assert not pixels("square.png").any()
    told = render("--json", "--camera", "0,1,0:0,2,1", scene=square_obj).json()
    assert (told["seen"], told["rays"], told["lit"], told["mrays_per_second"]) == (0, 0, [None, None], None)


def test_the_final_preset_lights_rooms_and_courtyards_by_bounced_light(cli):
    def bounced(*words):
        told = cli("render", *words, "--size", "8x8", "--json", "-o", "a.png").json()
        return told["bounce"], told["bounce_step"]

    room = "example:room", "--preset", "final", "--spp", "2"
    assert bounced(*room) == (ROOM_LIGHT["bounce"], ROOM_LIGHT["bounce_step"]) == (32, 4)
    assert bounced(*room, "--ao", "1") == bounced(*room[:1]) == (None, 1) and bounced(*room, "--bounce", "3") == (3, 1)
    assert bounced("procedural:atrium?triangles=5000", *room[1:]) == (32, 4)  # below an open sky
    assert bounced("example:mill", *room[1:]) == (None, 1)


def test_presets_set_what_options_do_not(render):
    found = {}
    for preset, more in (("draft", ()), ("final", ()), ("final", ("--spp", 2, "--no-adaptive", "--no-filter"))):
        told = render("--json", "--preset", preset, *more, size="4x4").json()
        found[preset, bool(more)] = told["spp"], told["filter"], told["adaptive"]
    assert found["draft", False] == (4, True, None) and found["final", False] == (64, True, 256)
    assert found["final", True] == (2, False, None)


def test_backgrounds(render, square_obj):
    view = "--camera", "0,3,0:0,0,0"
    assert render("--background", "transparent", *view, "-o", "a.png", scene=square_obj).code == 0
    assert render("--background", "#ff8000", *view, "-o", "b.png", scene=square_obj).code == 0
    clear, orange = (np.asarray(Image.open(name)) for name in ("a.png", "b.png"))
    outside = clear[..., 3] == 0
    assert outside.any() and (clear[~outside][:, 3] == 255).all() and not outside.all()
    assert (orange[outside] == (255, 128, 0)).all()
    assert (orange[~outside] == clear[~outside][:, :3]).all() and clear[~outside][:, :3].any()
    wrong = render("--background", "nocolour", scene=square_obj)
    assert wrong.code == 2 and "--background nocolour: write a colour" in wrong.err


def test_frames_take_a_time(render, tmp_path):
    folder = tmp_path / "moving"
    folder.mkdir()
    square = np.array([[-1, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1]], np.float32)
    np.save(folder / "frames.npy", np.stack([square, square * 2.0]))
    np.save(folder / "faces.npy", np.array([[2, 1, 0], [3, 2, 0]], np.int32))
    (folder / "info.json").write_text('{"times": [0.0, 2.0]}')
    seen = {}
    for time in ("0", "2", "99", "-1"):
        told = render("--json", "--time", time, "--camera", "0,5,0:0,0,0", scene=folder).json()
        assert told["output"] == "moving.png"
        assert told["time"] == min(max(float(time), 0.0), 2.0)
        seen[time] = told["seen"]
    assert seen["0"] == seen["-1"] < seen["2"] == seen["99"]
    assert told["scene"]["duration"] == 2.0


def test_notes_of_the_loader_are_said_once_and_not_as_warnings(render, square_obj, recwarn):
    square_obj.write_text("mtllib none.mtl\n" + square_obj.read_text())
    done = render(scene=square_obj)
    assert done.code == 0 and done.err.count("none.mtl") == 1 and done.err.startswith("antumbra: note: ")
    assert not [w for w in recwarn if "none.mtl" in str(w.message)]
    assert render("--quiet", scene=square_obj) == (0, "", "")


@pytest.mark.parametrize(
    "arguments, words",
    [
        (("--spp", "0"), ["--spp"]),
        (("--spp", "2000"), ["--spp"]),
        (("--spp", "many"), ["--spp"]),
        (("--adaptive-spp", "0"), ["--adaptive-spp"]),
        (("--plan", "magic"), ["magic", "bsah", "single"]),
        (("--plan", "bsah"), ["names no tracer"]),
        (("--srdh-rays", "32"), ["--srdh-rays", "auto"]),
        (("--srdh-rays", "32x32", "--plan", "srdh+single"), ["--srdh-rays 32x32", "16, 32 or all"]),
        (("--sampler", "dice"), ["dice", "sobol"]),
        (("--gbuffer", "guess"), ["--gbuffer", "raster"]),
        (("--threads", "0"), ["--threads"]),
        (("--up", "x"), ["--up"]),
        (("--up", "z"), ["--up and --crs are for files"]),
        (("--time", "noon"), ["--time"]),
        (("--time", "nan"), ["time"]),
        (("--exposure", "0"), ["exposure is 0"]),
        (("--exposure", "nan"), ["exposure is nan"]),
        (("--camera", "9"), ["no camera 9"]),
        (("--camera", "-1"), ["no camera -1"]),
        (("--camera", "here"), ["--camera here"]),
        (("--camera", "0,0,0:0,0,0"), ["target"]),
        (("--camera", "1e300,0,0:0,0,0"), ["camera position"]),
        (("--light", "9"), ["no light 9"]),
        (("--light", "lamp"), ["--light lamp", "sphere:CX,CY,CZ:RADIUS"]),
        (("-o", "a.jpg"), ["a.jpg", ".png, .exr, .mp4"]),
        (("-o", "a"), [".png, .exr, .mp4"]),
        (("-o", "."), ["is a folder"]),
        (("-o", "none/a.png"), ["none", "does not exist"]),
        (("--sop", "3"), ["--sop", "antumbra render --help"]),
        (("--spp",), ["--spp"]),
        (("--ao", "0"), ["--ao 0", "radius"]),
        (("--ao", "near"), ["--ao near", "radius"]),
        (("--ao", "1@-1"), ["--ao 1@-1", "intensity"]),
        (("--ao", "1@1e300"), ["--ao 1@1e300", "intensity", "1e+30"]),
        (("--ao", "-2"), ["--ao -2", "radius"]),
        (("--ao", "nan"), ["--ao nan", "radius"]),
        (("--ao",), ["--ao"]),
        (("--adaptive-spp", "1025"), ["--adaptive-spp", "1024"]),
        (("--adaptive-spp", "nan"), ["--adaptive-spp"]),
        (("--filter=yes",), ["--filter"]),
        (("--vpl", "16385"), ["--vpl", "16384"]),
        (("--vpl", "1.5"), ["--vpl"]),
        (("--vpl", "8", "--ao", "1"), ["--ao", "--vpl", "leave one"]),
        (("--vpl", "8", "--light", "point:1e9,0,0"), ["photons", "move the light nearer"]),
        (("--vpl", "0"), ["--vpl"]),
        (("--bounce", "0"), ["--bounce"]),
        (("--bounce", "1025"), ["--bounce", "1024"]),
        (("--bounce", "8", "--ao", "1"), ["--ao", "--bounce", "leave one"]),
        (("--bounces", "2"), ["--bounces", "--bounce 16"]),
        (("--bounce", "8", "--bounces", "65"), ["--bounces", "64"]),
        (("--bounce", "8", "--vpl", "8"), ["--vpl", "--bounce", "leave one"]),
        (("--sampler", "halton:5"), ["halton:5", "halton:18"]),
        (("another",), ["another"]),
    ],
)
def test_bad_options(render, tmp_path, arguments, words):
    render(*arguments).refused(*words)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("size", ["0x0", "0", "32x", "x", "99999x1", "-3x3"])
def test_bad_sizes(render, size, tmp_path):
    render(size=size).refused("--size", size)
    assert os.listdir(tmp_path) == []


def test_bad_scenes(cli, render, tmp_path):
    (tmp_path / "empty.glb").write_bytes(b"")
    (tmp_path / "broken.glb").write_bytes(b"glTF\2\0\0\0")
    (tmp_path / "picture.jpg").write_bytes(b"x")
    (tmp_path / "folder").mkdir()
    before = sorted(os.listdir(tmp_path))
    for scene in ("none.glb", "empty.glb", "broken.glb", "picture.jpg", "folder"):
        render(scene=scene).refused(scene.removesuffix("x"))
    render(scene="procedural:castle").refused("castle", "atrium")
    render(scene="procedural:").refused("atrium")
    render(scene="procedural:atrium?triangles=few").refused("triangles", "few")
    cli("render", "").refused("SCENE is empty")
    assert sorted(os.listdir(tmp_path)) == before


def test_what_is_wrong_is_said_before_the_scene_is_read(render, monkeypatch):
    monkeypatch.setattr("antumbra.cli.picture_spec.open_scene", lambda *_: pytest.fail("the scene was read"))
    for bad in (
        ("--spp", 0), ("--plan", "x"), ("--sampler", "x"), ("-o", "a.b"), ("-o", "none/a.png"), ("--light", "x"),
        ("--camera", "x"), ("--exposure", -1), ("--srdh-rays", "16"),
    ):  # fmt: skip
        render(*bad).refused()


def test_interrupting_leaves_one_line_and_no_file(render, monkeypatch, tmp_path):
    def interrupt(done, total):
        raise KeyboardInterrupt

    monkeypatch.setattr(ProgressDisplay, "parts", lambda self, text, count: interrupt)
    (tmp_path / "antumbra.png").write_bytes(b"older")
    assert render() == (130, "", "antumbra: interrupted\n")
    assert os.listdir(tmp_path) == ["antumbra.png"] and (tmp_path / "antumbra.png").read_bytes() == b"older"


def test_a_failing_save_leaves_no_file(render, monkeypatch, tmp_path):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("antumbra.picture.image_files.write_png", full)
    render().refused("antumbra.png", "No space left on device")
    assert os.listdir(tmp_path) == []


def test_textures_and_smooth_normals_can_be_left_out(render, tmp_path):
    (tmp_path / "t.png").write_bytes(png(np.random.default_rng(0).integers(0, 256, (8, 8, 3))))
    (tmp_path / "m.mtl").write_text("newmtl paper\nKd 1 1 1\nmap_Kd t.png\n")
    corners = (
        "v -1 0 -1\nv 1 0 -1\nv 1 0 1\nv -1 0 1\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvn -1 1 -1\nvn 1 1 -1\nvn 1 1 1\n"
    )
    faces = "vn -1 1 1\nusemtl paper\nf 3/3/3 2/2/2 1/1/1\nf 4/4/4 3/3/3 1/1/1\n"
    scene = tmp_path / "paper.obj"
    scene.write_text(f"mtllib m.mtl\n{corners}{faces}")
    view = "--camera", "0,2,0:0,0,0:60", "--light", "sun:1,-1,0"
    shown = {}
    for options in ((), ("--no-textures",), ("--no-smooth-normals",), ("--no-textures", "--no-smooth-normals")):
        told = render("--json", *view, *options, scene=scene).json()
        assert told["textures"] == ("--no-textures" not in options)
        assert told["smooth_normals"] == ("--no-smooth-normals" not in options)
        shown[options] = pixels("paper.png")[8:-8, 8:-8]
    pictures = list(shown.values())
    assert all((a != b).any() for i, a in enumerate(pictures) for b in pictures[:i])
    assert len(np.unique(shown["--no-textures", "--no-smooth-normals"].reshape(-1, 3), axis=0)) < 10


@pytest.mark.parametrize(
    "light, text",
    [
        (at.PointLight((0, 1, 0), intensity=50), "point light (50 cd)"),
        (at.QuadLight((0, 3, 0), (2, 0, 0), (0, 0, 2)), "square light of 2 x 2 (1 cd)"),
        (at.QuadLight((0, 3, 0), (2, 0, 0), (0, 0, 1.5)), "rectangular light of 2 x 1.5 (1 cd)"),
        (at.QuadLight((0, 3, 0), (2, 0, 0), (3, 0, 4)), "parallelogram light of 2 x 5 (1 cd)"),
        (at.DiskLight((0, 3, 0), (0, -1, 0), 0.5), "disk light of radius 0.5 (1 cd)"),
        (at.SphereLight((0, 3, 0), 0.2, intensity=10), "sphere light of radius 0.2 (10 cd)"),
        (at.DirectionalLight((0, -1, 0)), "sun of 0.53 degrees (1 lux)"),
        (at.AmbientOcclusion(), "ambient occlusion"),
        (at.AmbientOcclusion(radius=2), "ambient occlusion within 2"),
        (at.Sky(), "sky"),
        (at.PointLights([[0, 3, 0], [1, 3, 0]], interleave=True), "2 point lights"),
        (at.DirectionalLights([[0, -1, 0]]), "1 distant light"),
    ],
    ids=lambda each: type(each).__name__ if isinstance(each, at.Light) else "",
)
def test_lights_are_described_in_words(light, text):
    assert light_text(light) == text


@pytest.fixture
def table(tmp_path):
    """A file with a table top, 2 wide, at y = 1, on one thin leg that reaches down to y = 0."""
    path = tmp_path / "table.obj"
    path.write_text("v -1 1 -1\nv 1 1 -1\nv 1 1 1\nv -1 1 1\nv 0 0 0\nf 3 2 1\nf 4 3 1\nf 5 1 2\n")
    return path


_HIGH = "--camera", "0,8,6:0,0.5,0", "--light", "sun:0.3,-1,0:1@3"


def test_a_scene_stands_on_a_ground_by_default(render, table):
    told = render("--json", *_HIGH, "-o", "a.png", scene=table).json()
    assert told["ground"] == pytest.approx(0.0, abs=1e-3) and told["ground"] < 0.0
    assert render("--json", "--ground", "off", *_HIGH, "-o", "b.png", scene=table).json()["ground"] is None
    assert render("--json", "--ground", "-0.5", *_HIGH, "-o", "c.png", scene=table).json()["ground"] == -0.5
    assert re.search(r"at height 0; \d+ % of the picture shows its shadows", render(*_HIGH, scene=table).out)
    assert "at height -0.52; " in render("--ground", "-0.5200004", *_HIGH, scene=table).out
    a, b, c = (pixels(name).astype(int) for name in ("a.png", "b.png", "c.png"))
    assert (a <= b + 1).all() and (a < b - 20).any() and (a != c).any()


@pytest.mark.parametrize(
    "more", [["--camera", "panorama"], ["--camera", "0.1,0.5,0.1:5,0,0"], ["--camera", "0,-4,0.1:0,0,0"]]
)
def test_pictures_that_show_no_ground(render, table, more):
    outcome = render("--json", *more, "-o", "a.png", scene=table)
    if outcome.json()["ground"] is not None:  # below it, there is nothing to be seen
        assert render(*more, "--ground", "off", "-o", "b.png", scene=table).code == 0
        assert (pixels("a.png") == pixels("b.png")).all()


def test_rooms_have_no_ground(render):
    assert render("--json", "-o", "a.png").json()["ground"] is None


def bare_pictures(cli, scene, *more):
    """The bytes of bare pictures of a scene, of its store, and of its tiles."""
    assert cli("build", scene, "-o", "s.antumbra", "-q").code == 0
    assert cli("build", scene, "-o", "s.tiles", "--tile", 300, "-q").code == 0
    for k, name in enumerate((scene, "s.antumbra", "s.tiles")):
        assert cli("render", name, "-o", f"{k}.png", "--size", "60x45", *more, "-q").code == 0
    return [Path(f"{k}.png").read_bytes() for k in range(3)]


def test_a_store_stands_on_the_ground_of_its_scene(cli, render, table):
    whole, store, tiles = bare_pictures(cli, table, "--adaptive")
    assert whole == store == tiles
    told = [render("--json", *_HIGH, scene=scene).json()["ground"] for scene in (table, "s.antumbra")]
    assert told[0] == told[1] < 0.0
    low = [render("--json", "--ground", "-0.5", *_HIGH, scene=scene).json()["ground"] for scene in (table, "s.tiles")]
    assert low == [-0.5, -0.5]


@pytest.mark.parametrize("preset", ["draft", "final"])
@pytest.mark.parametrize("name", ["atrium", "city", "forest", "cellar"])
def test_bare_pictures_of_a_store_are_those_of_its_scene(cli, name, preset):
    """Rooms are shown from inside, and lit by what bounces in final pictures; models and cities stand on a ground."""
    whole, store, tiles = bare_pictures(cli, f"procedural:{name}?triangles=2000", "--preset", preset)
    assert whole == store == tiles


def test_a_store_of_terrain_has_its_tints(cli):
    whole, store, tiles = bare_pictures(cli, "example:hills")
    assert whole == store == tiles


@pytest.mark.parametrize("text", ["below", "", "nan", "1e40"])
def test_a_ground_that_cannot_be(render, table, text):
    render("--ground", text, scene=table).refused("--ground", "auto, on, off or a height")


def test_all_frames_have_one_ground(render, tmp_path):
    folder = tmp_path / "moving"
    folder.mkdir()
    moments = np.array([[[0, y, 0], [1, y + 1, 0], [0, y + 1, 1]] for y in (0.0, -3.0, 1.0)], np.float32)
    np.save(folder / "frames.npy", moments)
    np.save(folder / "faces.npy", np.array([[0, 1, 2]], np.int32))
    (folder / "info.json").write_text('{"times": [0.0, 1.0, 2.0]}')
    done = render("--frames", "0:2", "--fps", 1, "-o", "f.#.png", "--json", scene=folder)
    told = [json.loads(line) for line in done.out.splitlines()][:3]
    assert [frame["state"] for frame in told] == ["rendered"] * 3
    assert len({frame["ground"] for frame in told}) == 1
    assert told[0]["ground"] == pytest.approx(-3.0, abs=1e-3)
    assert render("--time", 2, "--json", scene=folder).json()["ground"] == pytest.approx(1.0, abs=1e-3)


def test_shadows_are_in_the_alpha(render, table):
    assert render("--background", "transparent", *_HIGH, "-o", "a.png", scene=table).code == 0
    assert render("--background", "white", *_HIGH, "-o", "b.png", scene=table).code == 0
    assert render("--background", "transparent", *_HIGH, "-o", "c.exr", scene=table).code == 0
    clear, white = pixels("a.png").astype(float), pixels("b.png").astype(float)
    with OpenEXR.File("c.exr", separate_channels=True) as file:
        channels = {name: channel.pixels for name, channel in file.channels().items()}
        assert "light lost" in file.header()["background"]
    alpha = clear[..., 3:] / 255.0
    over_white = alpha * clear[..., :3] + (1.0 - alpha) * 255.0
    shadow = (alpha[..., 0] > 0.1) & (alpha[..., 0] < 1.0)
    assert shadow.any() and (clear[shadow][:, :3] == 0).all()
    assert np.abs(over_white - white).mean(-1)[shadow].max() < 25.0  # the shadow is bluish where it is not black
    seen = channels["triangle.id"] != 2**32 - 1
    assert (channels["A"][seen] == 1.0).all() and 0.2 < channels["A"][~seen].max() < 1.0
    luminance = sum(w * channels[f"ground.{c}"] for w, c in zip((0.2126, 0.7152, 0.0722), "RGB"))
    np.testing.assert_allclose(1.0 - luminance[~seen], channels["A"][~seen], atol=1e-5)
