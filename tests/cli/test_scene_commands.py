import os

import numpy as np
import pytest
from scipy.spatial import cKDTree

import antumbra as at
from antumbra.formats.format_registry import SCENE_WRITERS
from antumbra.generate.procedural_scenes import PROCEDURAL, generate


def test_the_list(cli):
    told = cli("scenes", "--json").json()["scenes"]
    assert [scene["name"] for scene in told] == list(PROCEDURAL)
    assert all(scene["triangles"] > 0 and scene["description"] for scene in told)
    shown = cli("scenes").out
    for scene in told:
        assert scene["name"] in shown and f"{scene['triangles']:,}" in shown


def test_one_scene(cli, tmp_path):
    told = cli("scenes", "atrium", "--triangles", "2k", "--seed", "3", "--json").json()
    made = generate("atrium", 2000, 3)
    assert told["triangles"] == len(made.faces) and told["seed"] == 3 and told["files"] == []
    assert np.allclose(told["bounds"], [made.vertices.min(0), made.vertices.max(0)])
    assert f"{len(made.faces):,} triangles" in cli("scenes", "atrium", "--triangles", "2k", "--seed", "3").out
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("suffix", SCENE_WRITERS)
def test_exported_scenes_read_back_the_same(cli, suffix, tmp_path, recwarn):
    told = cli("scenes", "atrium", "--triangles", "3k", "-o", f"a{suffix}", "--json").json()
    assert sorted(told["files"]) == sorted(os.listdir(tmp_path))
    made, read = generate("atrium", 3000, 0), at.load(f"a{suffix}")
    assert not read.notes and not list(recwarn)
    corners = np.asarray(made.vertices, np.float64)[made.faces].reshape(-1, 9)
    wanted = np.concatenate([corners, np.asarray(made.palette)[made.colour]], axis=1)
    triangles = read.triangles()
    got = np.concatenate([(triangles.vertices + read.origin).reshape(-1, 9), read.colours], axis=1)
    assert got.shape == wanted.shape
    tolerance = np.repeat([1e-6 * np.ptp(corners), 1e-6 if suffix == ".glb" else 0.005], (9, 3))
    if suffix == ".obj":  # whose faces are sorted by colour
        for a, b in ((got, wanted), (wanted, got)):
            distance, _ = cKDTree(a / tolerance).query(b / tolerance, p=np.inf)
            assert distance.max() <= 1.0
    else:
        assert (np.abs(got - wanted) <= tolerance).all()
    assert np.ptp(read.colours, axis=0).max() > 0.1


def test_a_glb_has_the_camera_and_a_light_where_the_scene_has_them(cli):
    assert cli("scenes", "atrium", "--triangles", "2k", "-o", "a.glb").code == 0
    scene, read = at.procedural("atrium", triangles=2000), at.load("a.glb")
    (camera,), (light,) = read.cameras, read.lights
    own = scene.cameras[0]
    assert np.allclose(camera.position, own.position) and camera.vfov == pytest.approx(own.vfov)
    rays, wanted = (c.resized(8, 6).rays(np.zeros(3)) for c in (camera, own))
    for a, b in zip(rays, wanted):
        np.testing.assert_allclose(a, b, atol=1e-6)
    quad = scene.lights[0]
    assert isinstance(light, at.PointLight) and light.intensity == pytest.approx(quad.intensity)
    assert np.allclose(light.position, quad.corner + (quad.u + quad.v) / 2)


def test_exporting_twice_gives_the_same_bytes(cli, tmp_path):
    for suffix in SCENE_WRITERS:
        data = []
        for _ in range(2):
            assert cli("scenes", "cellar", "--triangles", "2k", "-o", f"a{suffix}").code == 0
            data.append((tmp_path / f"a{suffix}").read_bytes())
        assert data[0] == data[1]


@pytest.mark.parametrize(
    "arguments, words",
    [
        (("castle",), ["castle", "atrium"]),
        (("castle", "-o", "a.glb"), ["castle"]),
        (("atrium", "--triangles", "few"), ["--triangles is 'few'"]),
        (("atrium", "--triangles", "0"), ["0"]),
        (("atrium", "--seed", "x"), ["--seed is 'x'"]),
        (("atrium", "-o", "a.png"), [".glb, .obj or .ply"]),
        (("atrium", "-o", "none/a.glb"), ["does not exist"]),
        (("-o", "a.glb"), ["antumbra scenes NAME -o FILE"]),
        (("--triangles", "5k"), ["antumbra scenes NAME"]),
        (("atrium", "city"), ["city"]),
    ],
)
def test_bad_input(cli, tmp_path, arguments, words):
    cli("scenes", *arguments).refused(*words)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("suffix", SCENE_WRITERS)
def test_a_failing_export_leaves_no_file(cli, monkeypatch, tmp_path, suffix):
    real = os.replace

    def full(source, target):
        if os.fspath(target).endswith(suffix):
            raise OSError(28, "No space left on device")
        real(source, target)

    monkeypatch.setattr(os, "replace", full)
    cli("scenes", "atrium", "--triangles", "2k", "-o", f"a{suffix}").refused(f"a{suffix}", "No space left")
    assert os.listdir(tmp_path) == []
