"""Data sets: what their files hold, and that they end with the same bytes however they were made."""

import hashlib
import json
import os
import re
import shutil
import sys
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from PIL import Image

import antumbra as at
from antumbra.base.option_fields import deciding_fields
from antumbra.datasets import dataset
from antumbra.datasets.dataset_files import contact_sheet
from gltf_files import TETRAHEDRON, TETRAHEDRON_FACES, Gltf
from killed import run, run_killed
from repository import ROOT

SCENE = at.procedural("atrium", triangles=2000)
LIGHTS = [at.QuadLight((-1, 7, -1), (2, 0, 0), (0, 0, 2)), at.DirectionalLight((0.3, -1, 0.2)), at.AmbientOcclusion()]
ASKED = {"orbit": 1, "random": 2, "random_lights": 2, "seed": 7, "size": (24, 16), "spp": 4}


def contents(folder) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def times(folder) -> dict[str, int]:
    return {str(p): p.stat().st_mtime_ns for p in folder.rglob("*") if p.is_file()}


def exr(path) -> dict[str, np.ndarray]:
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {name: channel.pixels for name, channel in file.channels().items()}


def manifest(folder) -> dict:
    return json.loads((folder / "manifest.json").read_text())


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    """A finished data set of `ASKED`."""
    folder = tmp_path_factory.mktemp("sets") / "whole"
    made = at.dataset(SCENE, folder, **ASKED)
    assert made[:6] == (folder, 3, 2, 3, 0, True)
    return folder


def test_each_frame_states_how_many_follow(tmp_path, monkeypatch):
    expected, expect = [], at.Renderer.expect
    monkeypatch.setattr(at.Renderer, "expect", lambda self, n: expected.append(n) or expect(self, n))
    at.dataset(SCENE, tmp_path / "set", **ASKED)
    assert expected == [3, 2, 1]


def test_an_exr_holds_what_a_frame_holds(tmp_path):
    camera = SCENE.cameras[0].resized(40, 24)
    at.dataset(SCENE, tmp_path / "set", [camera], LIGHTS, spp=4)
    frame = at.render(SCENE, camera, LIGHTS, spp=4)
    g, found = frame.gbuffer, exr(tmp_path / "set" / "frames" / "0000.exr")
    wanted = {f"ViewLayer.Combined.{c}": frame.image[..., k] for k, c in enumerate("RGB")}
    wanted |= {"ViewLayer.Combined.A": (g.face >= 0).astype(np.float32), "ViewLayer.Depth.Z": g.depth}
    wanted |= {f"ViewLayer.Normal.{c}": g.normal[..., k] for k, c in enumerate("XYZ")}
    wanted |= {f"ViewLayer.Position.{c}": g.position[..., k] for k, c in enumerate("XYZ")}
    thing = np.where(g.face >= 0, 0, -1)
    wanted |= {"ViewLayer.IndexOB.X": thing, "ViewLayer.Instance.X": thing, "ViewLayer.Triangle.X": g.face}
    wanted |= {f"Light00{k}.Visibility.X": v for k, v in enumerate(frame.visibility)}
    blockers = {"Light000.Blocker.X", "Light001.Blocker.X"}  # ambient light has none
    of_blockers = {f"Light00{k}.{name}.X" for k in (0, 1) for name in ("BlockerIndexOB", "BlockerInstance")}
    assert found.keys() == wanted.keys() | blockers | of_blockers
    for name, values in wanted.items():
        ids = values.dtype.kind == "i"
        assert found[name].dtype == (np.uint32 if ids else np.float32), name
        assert ((found[name].view(np.int32) if ids else found[name]) == values).all(), name
    for name in blockers:
        blocker = found[name].view(np.int32)
        assert (blocker == -1).any() and (blocker >= 0).any() and blocker.max() < SCENE.n_triangles


def test_masks_are_white_in_shadow(tmp_path):
    camera = SCENE.cameras[0].resized(40, 24)
    at.dataset(SCENE, tmp_path / "set", [camera], LIGHTS, spp=4)
    for k, visibility in enumerate(at.render(SCENE, camera, LIGHTS, spp=4).visibility):
        with Image.open(tmp_path / "set" / "masks" / f"0000.Light00{k}.png") as image:
            assert image.mode == "L"
            found = np.asarray(image)
        assert (found == np.rint(255 * (1 - visibility.astype(float)))).all() and len(np.unique(found)) > 2


def test_the_manifest_lists_each_file_with_its_digest(whole):
    found, files = manifest(whole), contents(whole)
    listed = {f["path"]: f for frame in found["frames"] for f in frame["files"].values()}
    assert listed.keys() == {name for name in files if not name.endswith(".json")} and len(listed) == 9
    for name, file in listed.items():
        assert file["sha256"] == hashlib.sha256(files[name]).hexdigest() and file["bytes"] == len(files[name])
    triangles, digest = SCENE.triangles(), hashlib.sha256()
    for array in (*triangles[:2], triangles.colour, SCENE.object_of_face):
        digest.update(array.tobytes())
    settings = found["settings"]
    assert settings["scene"]["sha256"] == digest.hexdigest()
    assert found["complete"] and settings["version"] == at.__version__ and settings["seed"] == 7
    assert settings["options"] == deciding_fields(at.RenderOptions(spp=4, materials="diffuse"))
    assert [f["made"] for f in found["frames"]] == ["orbit", "random", "random"]
    assert settings["lights"] == [{"layer": f"Light00{k}", "drawn": "frame"} for k in (0, 1)]
    assert [[light["type"] for light in f["lights"]][1] for f in found["frames"]] == ["SphereLight"] * 3
    assert found["objects"] == [{"name": "atrium", "mesh": "atrium", "instance": 0}]


def test_the_docs_name_every_key_of_the_manifest(whole):
    page = (ROOT / "docs" / "jobs" / "dataset.md").read_text()

    def keys(value):
        if isinstance(value, dict):
            for key, inner in value.items():
                yield key
                yield from keys(inner) if key not in ("lights", "files", "options") else ()
        elif isinstance(value, list) and value:
            yield from keys(value[0])

    assert [key for key in keys(manifest(whole)) if f"`{key}`" not in page] == []


def test_matrices_take_positions_to_their_pixels(whole):
    frame = manifest(whole)["frames"][1]
    camera, found = frame["camera"], exr(whole / frame["files"]["exr"]["path"])
    position = np.stack([found[f"ViewLayer.Position.{c}"] for c in "XYZ"], -1).astype(float) + frame["origin"]
    seen = found["ViewLayer.Triangle.X"].view(np.int32) >= 0
    matrix, y_x = np.array(camera["world_to_camera"]), np.argwhere(seen)
    local = position[seen] @ matrix[:3, :3].T + matrix[:3, 3]
    assert np.allclose(matrix[:3, :3] @ matrix[:3, :3].T, np.eye(3)) and np.linalg.det(matrix) > 0
    assert np.allclose(local[:, 2], found["ViewLayer.Depth.Z"][seen], rtol=1e-4)
    pixel = local @ np.array(camera["intrinsics"]).T
    assert seen.any() and np.allclose(pixel[:, :2] / pixel[:, 2:], y_x[:, ::-1] + 0.5, atol=1e-2)


def test_the_same_call_changes_nothing(whole):
    before = times(whole)
    assert at.dataset(SCENE, whole, **ASKED, threads=1)[3:6] == (0, 3, True)
    assert times(whole) == before


@pytest.mark.parametrize("more", [{"threads": 1}, {"plan": "bsah+single"}, {"overwrite": True}])
def test_threads_and_plans_change_no_byte(whole, tmp_path, more):
    at.dataset(SCENE, tmp_path / "set", **ASKED, **more)
    assert contents(tmp_path / "set") == contents(whole)


def test_shards_make_the_same_data_set(whole, tmp_path):
    made = at.dataset(SCENE, tmp_path / "set", **ASKED, shard=(1, 2))
    assert (made.rendered, made.complete) == (1, False) and not manifest(tmp_path / "set")["complete"]
    made = at.dataset(SCENE, tmp_path / "set", **ASKED, shard=(0, 2))
    assert (made.rendered, made.finished, made.complete) == (2, 0, True)
    assert contents(tmp_path / "set") == contents(whole)


@pytest.mark.parametrize("name", ["frames/0001.exr", "masks/0001.Light000.png", "frames/0001.json"])
def test_a_lost_or_short_file_is_made_again(whole, tmp_path, name):
    at.dataset(SCENE, tmp_path / "set", **ASKED)
    for damage in (Path.unlink, lambda path: path.write_bytes(path.read_bytes()[:-2])):
        damage(tmp_path / "set" / name)
        assert at.dataset(SCENE, tmp_path / "set", **ASKED)[3:5] == (1, 2)
        assert contents(tmp_path / "set") == contents(whole)


COMMAND = ["dataset", "procedural:atrium?triangles=2000", "-o", "set", "--orbit", "1", "--random", "2"]
COMMAND += ["--random-lights", "2", "--seed", "7", "--size", "24x16", "--spp", "4", "--json"]


@pytest.mark.skipif(sys.platform == "win32", reason="signals are different on Windows")
@pytest.mark.parametrize("kind", ["exr", "png"])
def test_a_killed_command_goes_on_and_ends_with_the_same_bytes(whole, tmp_path, kind):
    run_killed(tmp_path, "write_exr" if kind == "exr" else "write_png", *COMMAND)
    assert not manifest(tmp_path / "set")["complete"] and any(n.endswith(".tmp") for n in contents(tmp_path / "set"))
    done = run(tmp_path, *COMMAND)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["complete"] and told["rendered"] + told["finished"] == 3
    assert told["finished"] == (1 if kind == "exr" else 0)
    assert contents(tmp_path / "set") == contents(whole)


def test_other_settings_are_an_error_that_names_them(whole, tmp_path):
    at.dataset(SCENE, tmp_path / "set", **ASKED)
    before = contents(tmp_path / "set")
    for changed, words in {
        ("spp", 8): "spp 4, not 8",
        ("seed", 8): "seed 7, not 8",
        ("random", 3): "cameras random 2, not 3",
        ("lights", LIGHTS[0]): "lights",
        ("sampler", "sobol"): "sampler larcher-pillichshammer, not sobol",
    }.items():
        asked = ASKED | dict([changed])
        with pytest.raises(at.InputError, match=re.escape(words) + r".*--overwrite"):
            at.dataset(SCENE, tmp_path / "set", **asked)
    with pytest.raises(at.InputError, match="scene sha256"):
        at.dataset(at.procedural("atrium", triangles=2000, seed=1), tmp_path / "set", **ASKED)
    assert contents(tmp_path / "set") == before


def test_a_data_set_of_another_format_is_refused_by_name(whole, tmp_path):
    folder = tmp_path / "set"
    shutil.copytree(whole, folder)
    (folder / "manifest.json").write_text(json.dumps(manifest(folder) | {"format": 1}))
    before = contents(folder)
    for overwrite in (False, True):
        with pytest.raises(at.InputError, match="format 1, and this antumbra writes format 2; name another folder"):
            at.dataset(SCENE, folder, **ASKED, overwrite=overwrite)
    assert contents(folder) == before
    (folder / "manifest.json").write_text((whole / "manifest.json").read_text().replace(at.__version__, "0.9.0"))
    with pytest.raises(at.InputError, match=r"other settings \(version.*0\.9\.0"):
        at.dataset(SCENE, folder, **ASKED)


def test_overwrite_replaces_a_data_set(whole, tmp_path):
    at.dataset(SCENE, tmp_path / "set", **ASKED | {"random": 5, "random_lights": 3})
    made = at.dataset(SCENE, tmp_path / "set", **ASKED, overwrite=True)
    assert made[3:6] == (3, 0, True)
    assert contents(tmp_path / "set") == contents(whole)


def test_a_folder_that_was_only_just_made_is_used(whole, tmp_path):
    (tmp_path / "set").mkdir()
    (tmp_path / "set" / ".antumbra-left.tmp").write_text("{")
    at.dataset(SCENE, tmp_path / "set", **ASKED)
    assert set(contents(whole)) <= set(contents(tmp_path / "set"))


def test_a_folder_of_other_files_is_left_alone(tmp_path):
    (tmp_path / "frames").mkdir()
    (tmp_path / "frames" / "mine.json").write_text("{}")
    (tmp_path / "manifest.json").write_text('{"name": "of another program"}')
    for overwrite in False, True:
        with pytest.raises(at.InputError, match=r"has files, but no data set's manifest\.json"):
            at.dataset(SCENE, tmp_path, **ASKED, overwrite=overwrite)
    assert list(contents(tmp_path)) == ["frames/mine.json", "manifest.json"]
    assert manifest(tmp_path) == {"name": "of another program"}


@pytest.mark.parametrize(
    "asked, words",
    [
        ({"shard": (2, 2)}, "shard"),
        ({"shard": 3}, "shard"),
        ({"orbit": -1}, "orbit"),
        ({"seed": -1}, "seed"),
        ({"size": (0, 4)}, "picture width"),
        ({"size": 4}, "size"),
        ({"spp": 0}, "spp"),
        ({"cameras": []}, "0 cameras"),
        ({"cameras": [3]}, "antumbra.Camera"),
        ({"lights": []}, "no lights"),
        ({"plan": "no-such"}, "no-such"),
    ],
)
def test_bad_values_are_errors_and_make_no_folder(tmp_path, asked, words):
    with pytest.raises(at.InputError, match=words):
        at.dataset(SCENE, tmp_path / "set", **asked)
    assert os.listdir(tmp_path) == []


def test_objects_and_instances_are_those_of_the_file(tmp_path):
    made = Gltf()
    mesh = made.mesh(made.primitive(TETRAHEDRON, TETRAHEDRON_FACES), name="shape")
    for x in 0, 2, 4:
        made.node(mesh=mesh, translation=[x, 0, 0], name=f"at {x}")
    scene = at.load(made.write(tmp_path))
    at.dataset(scene, tmp_path / "set", size=(48, 48), spp=1)
    found = exr(tmp_path / "set" / "frames" / "0000.exr")
    ids, face = (found[f"ViewLayer.{n}.X"].view(np.int32) for n in ("IndexOB", "Triangle"))
    assert set(ids.flat) == {-1, 0, 1, 2}
    assert (ids == np.where(face >= 0, face // 4, -1)).all()
    assert (found["ViewLayer.Instance.X"].view(np.int32) == ids).all()
    assert manifest(tmp_path / "set")["objects"][1] == {"name": "at 2", "mesh": "shape", "instance": 1}


def test_a_store_gives_the_same_pictures(tmp_path):
    at.build_store([SCENE], tmp_path / "made.antumbra")
    paged, camera = at.load(tmp_path / "made.antumbra"), SCENE.cameras[0].resized(24, 16)
    names = {"memory": SCENE, "store": paged}
    for name, scene in names.items():
        at.dataset(scene, tmp_path / name, [camera], LIGHTS, orbit=1, spp=4, size=(24, 16))
    for frame in "0000", "0001":
        a, b = (exr(tmp_path / name / "frames" / f"{frame}.exr") for name in names)
        assert a.keys() == b.keys() and all((a[name] == b[name]).all() for name in a)


def test_the_scenes_own_cameras_and_lights_are_the_default(tmp_path):
    at.dataset(SCENE, tmp_path / "set", size=(8, 6), spp=1)
    found = manifest(tmp_path / "set")
    assert [f["camera"]["position"] for f in found["frames"]] == [SCENE.cameras[0].position.tolist()]
    assert [light["type"] for light in found["settings"]["lights"]] == ["QuadLight"]


def test_a_contact_sheet_shows_a_frame(whole):
    picture = contact_sheet(whole, 2)
    assert picture.dtype == np.uint8 and picture.ndim == 3 and len(np.unique(picture)) > 50
    with pytest.raises(at.InputError, match="no frame 9"):
        contact_sheet(whole, 9)


def test_progress_counts_frames(tmp_path):
    told = []
    at.dataset(SCENE, tmp_path / "set", **ASKED, progress=lambda *said: told.append(said))
    assert told == [("frames", k, 3) for k in (1, 2, 3)]
    assert dataset.MANIFEST in os.listdir(tmp_path / "set")


def test_cameras_that_are_not_perspective_record_their_projection(tmp_path):
    cameras = [SCENE.default_camera(24, 16, kind) for kind in ("perspective", "top", "panoramic")]
    at.dataset(SCENE, tmp_path, cameras, LIGHTS[:1], spp=1)
    told = [frame["camera"] for frame in manifest(tmp_path)["frames"]]
    assert [camera.get("projection") for camera in told] == [None, "orthographic", "panoramic"]
    assert ["intrinsics" in camera for camera in told] == [True, False, False]
    assert told[1]["extent"] == cameras[1].extent and told[2]["extent"] is None
    for camera, record in zip(cameras, told):
        matrix = np.array(record["world_to_camera"])
        np.testing.assert_allclose(matrix[:3, :3] @ matrix[:3, :3].T, np.eye(3), atol=1e-12)
        np.testing.assert_allclose(matrix @ [*camera.position, 1.0], (0, 0, 0, 1), atol=1e-9)
