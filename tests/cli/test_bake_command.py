import numpy as np
import pytest

import antumbra as at
from baked_files import Glb, box, grid, scene_file


@pytest.fixture
def model(tmp_path):
    return scene_file(tmp_path, grid([-1, 0, 1], [-1, 0, 1]), box((-0.5, 0.2, -0.5), (0.5, 1, 0.5)))


def test_a_file_with_occlusion_at_vertices(cli, model, tmp_path):
    told = cli("bake", model, "-o", "out.glb", "--spp", "16", "--json").json()
    assert told["what"] == "ao" and told["attribute"] == "COLOR_0" and told["receivers"] == 17 and told["parts"] == 2
    assert told["rays"] == 17 * 16 and set(told["seconds"]) == {"read", "trace", "write"}
    colours = Glb(tmp_path / "out.glb").attribute("COLOR_0")
    assert colours.shape == (9, 4) and np.ptp(colours[:, 0]) > 0.1
    shown = cli("bake", model, "-o", "out.glb", "--spp", "16").out
    assert "17 vertices (COLOR_0) in 2 parts" in shown and "rays" in shown
    assert cli("bake", model, "-o", "out.glb", "--spp", "4", "--quiet").out == ""


def test_the_command_equals_the_function(cli, model, tmp_path):
    sun, lamp = "sun:0,-1,0.5:1", "point:0,3,0@20"
    assert cli("bake", model, "-o", "a.glb", "--what", "light", "--light", sun, "--light", lamp, "--open-sky", "0.5",
               "--spp", "8", "--exposure", "0.5", "--attribute", "_LIGHT").code == 0  # fmt: skip
    lights = [at.DirectionalLight((0, -1, 0.5), 1.0), at.PointLight((0, 3, 0), intensity=20.0)]
    at.bake(model, tmp_path / "b.glb", "light", lights=[*lights, at.AmbientOcclusion(intensity=0.5)], spp=8,
            exposure=0.5, attribute="_LIGHT")  # fmt: skip
    assert (tmp_path / "a.glb").read_bytes() == (tmp_path / "b.glb").read_bytes()


def test_a_texture_with_an_exr(cli, model, tmp_path):
    pytest.importorskip("xatlas")
    told = cli(
        "bake", model, "-o", "out.glb", "--texture", "64", "--bit-depth", "16", "--exr", "--spp", "4", "--json"
    ).json()
    assert told["images"] == ["out.exr"] and told["attribute"] is None and (tmp_path / "out.exr").exists()
    assert Glb(tmp_path / "out.glb").image().dtype.itemsize == 2
    assert "texels in 2 parts" in cli("bake", model, "-o", "out.glb", "--texture", "64", "--spp", "4").out


def test_other_scenes(cli, square_obj, tmp_path):
    assert cli("bake", square_obj, "-o", "out.glb", "--spp", "4", "--up", "z").code == 0
    np.testing.assert_allclose(at.load(tmp_path / "out.glb").bounds, [[-1, -1, 0], [1, 1, 0]], atol=1e-6)
    assert cli("bake", "procedural:atrium?triangles=2k", "-o", "out.glb", "--what", "sun", "--spp", "1").code == 0


@pytest.mark.parametrize(
    "options, words",
    [
        (["-o", "out.png"], [".glb"]),
        (["-o", "none/out.glb"], ["none", "does not exist"]),
        (["-o", "out.glb", "--vertex", "--texture", "64"], ["--vertex", "--texture"]),
        (["-o", "out.glb", "--open-sky", "1"], ["--open-sky", "--what light"]),
        (["-o", "out.glb", "--what", "gold"], ["gold"]),
        (["-o", "out.glb", "--light", "point:0,1,0"], ["sky"]),
        (["-o", "out.glb", "--bit-depth", "16"], ["texture"]),
        (["-o", "out.glb", "--texture", "64", "--uv", "0"], ["TEXCOORD_0", "atlas"]),
        (["-o", "out.glb", "--attribute", "AO"], ["_AO"]),
        ([], ["-o"]),
    ],
)
def test_refused(cli, model, tmp_path, options, words):
    cli("bake", model, *options).refused(*words)
    assert not (tmp_path / "out.glb").exists()


def test_no_scene(cli):
    cli("bake", "-o", "out.glb").refused("SCENE")
    cli("bake", "none.glb", "-o", "out.glb").refused("none.glb", "no such file")
