"""Lights drawn per frame light what the camera sees, depend on the frame alone, and stand in free space."""

import json

import numpy as np
import OpenEXR
import pytest

import antumbra as at
from antumbra.datasets.frame_lights import MIN_LIT, RULE, frame_light, lit_share, seen_surfaces
from antumbra.datasets.random_views import random_camera, sampling_region

SIZE = 32, 24


def faces(lower, upper, inward=False):
    """(12, 3, 3): a box, seen from outside or from inside."""
    lower, upper = np.array(lower, float), np.array(upper, float)
    x, y, z = np.meshgrid((0, 1), (0, 1), (0, 1), indexing="ij")
    corners = lower + np.stack([x, y, z], -1).reshape(-1, 3) * (upper - lower)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    soup = corners[np.array([f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))])]
    return soup[:, ::-1] if inward else soup


def closed_room():
    """A closed room with furniture, which no sun reaches."""
    rng = np.random.default_rng(1)
    things = [faces(p, p + rng.uniform(0.3, 1.0, 3)) for p in rng.uniform((-4, 0, -3), (4, 0.5, 3), (12, 3))]
    return at.Scene.from_arrays(np.concatenate([faces((-5, 0, -4), (5, 3, 4), inward=True), *things]), name="room")


def lit(folder):
    frames = json.loads((folder / "manifest.json").read_text())["frames"]
    return np.array([frame["lit"] for frame in frames], float), frames


def test_in_a_closed_room_every_frame_is_lit(tmp_path):
    """Of lights drawn once for all frames, the sun lights none of them."""
    asked = {"random": 12, "random_lights": 2, "seed": 3, "size": SIZE, "spp": 4}
    at.dataset(closed_room(), tmp_path / "once", **asked, lights_per="set")
    assert (lit(tmp_path / "once")[0][:, 0] < 0.01).all()
    at.dataset(closed_room(), tmp_path / "each", **asked)
    shares, frames = lit(tmp_path / "each")
    assert shares.min() > 0.5 * MIN_LIT and shares.mean() > 0.3
    assert {light["type"] for frame in frames for light in frame["lights"]} == {"SphereLight"}
    places = {tuple(light["center"]) for frame in frames for light in frame["lights"]}
    assert len(places) == 24 and all(-5 < x < 5 and 0 < y < 3 and -4 < z < 4 for x, y, z in places)


def test_in_the_open_suns_and_spheres_alternate(tmp_path):
    rng = np.random.default_rng(2)
    town = np.concatenate(
        [faces(p, p + (1, h, 1)) for p, h in zip(rng.uniform(-9, 9, (60, 3)) * (1, 0, 1), rng.uniform(1, 4, 60))]
    )
    ground = np.array([[(-20, 0, -20), (-20, 0, 20), (20, 0, 20)], [(-20, 0, -20), (20, 0, 20), (20, 0, -20)]], float)
    scene = at.Scene.from_arrays(np.concatenate([town, ground]))
    at.dataset(scene, tmp_path / "set", random=8, random_lights=2, size=SIZE, spp=4)
    shares, frames = lit(tmp_path / "set")
    kinds = [[light["type"] for light in frame["lights"]] for frame in frames]
    assert [k[1] for k in kinds] == ["SphereLight"] * 8 and [k[0] for k in kinds].count("DirectionalLight") >= 6
    assert shares.min() > 0.5 * MIN_LIT


def test_the_share_that_a_light_lights_is_that_of_a_picture():
    region = sampling_region(at.procedural("atrium", triangles=2000), 0.0, None)
    for k in range(4):
        camera = random_camera(region, 5, k, (96, 96))
        seen = seen_surfaces(region, camera)
        light = frame_light(region, seen, 5, k, k)
        frame = at.render(region.scene, camera, light, spp=16)
        assert abs(frame.visibility[0][frame.mask].mean() - lit_share(region, seen, light)) < 0.1


def test_a_light_depends_on_the_seed_its_number_and_the_frame():
    region = sampling_region(closed_room(), 0.0, None)
    seen = seen_surfaces(region, random_camera(region, 5, 0, SIZE))
    first = frame_light(region, seen, 5, 1, 0)
    assert (first.center == frame_light(region._replace(threads=1), seen, 5, 1, 0).center).all()
    for other in ((6, 1, 0), (5, 3, 0), (5, 1, 1)):
        assert (first.center != frame_light(region, seen, *other).center).any()


def test_a_view_of_nothing_gets_a_sun():
    region = sampling_region(closed_room(), 0.0, None)
    nothing = seen_surfaces(region, at.Camera((0, 50, 0), (0, 60, 0), up=(1, 0, 0)))
    assert not len(nothing.points) and isinstance(frame_light(region, nothing, 0, 1, 0), at.DirectionalLight)


def test_the_manifest_states_the_rule(tmp_path):
    at.dataset(closed_room(), tmp_path / "set", random=1, random_lights=1, size=SIZE, spp=1)
    settings = json.loads((tmp_path / "set" / "manifest.json").read_text())["settings"]
    assert settings["drawn"] == {"rule": RULE, "tries": 64, "lit": MIN_LIT} and "10%" in RULE
    at.dataset(closed_room(), tmp_path / "once", random=1, random_lights=1, size=SIZE, spp=1, lights_per="set")
    settings = json.loads((tmp_path / "once" / "manifest.json").read_text())["settings"]
    assert "drawn" not in settings and settings["lights"][0]["type"] == "DirectionalLight"


def test_explicit_lights_come_first_and_are_the_same_in_all_frames(tmp_path):
    lamp = at.PointLight((0, 2, 0))
    at.dataset(closed_room(), tmp_path / "set", lights=[lamp], random=2, random_lights=1, size=SIZE, spp=1)
    manifest = json.loads((tmp_path / "set" / "manifest.json").read_text())
    first, second = manifest["settings"]["lights"]
    assert first["type"] == "PointLight" and second == {"layer": "Light001", "drawn": "frame"}
    assert [len(frame["lights"]) for frame in manifest["frames"]] == [1, 1]
    assert [len(frame["lit"]) for frame in manifest["frames"]] == [2, 2]


def test_a_store_draws_the_lights_of_its_scene(tmp_path):
    at.build_store(closed_room(), tmp_path / "room.antumbra")
    asked = {"random": 2, "random_lights": 2, "seed": 3, "size": SIZE, "spp": 1}
    for name, scene in (("memory", closed_room()), ("store", at.load(tmp_path / "room.antumbra"))):
        at.dataset(scene, tmp_path / name, **asked)
    first, second = (lit(tmp_path / name)[1] for name in ("memory", "store"))
    assert [frame["lights"] for frame in first] == [frame["lights"] for frame in second]


def test_an_unknown_choice_is_refused(tmp_path):
    with pytest.raises(at.InputError, match="lights_per is 'scene'"):
        at.dataset(closed_room(), tmp_path / "set", random_lights=1, lights_per="scene")


def test_blockers_have_the_object_and_instance_of_their_face(tmp_path):
    cube = faces((-0.5, 0, -0.5), (0.5, 1, 0.5))
    where = [np.eye(4) for _ in range(3)]
    for k, matrix in enumerate(where):
        matrix[:3, 3] = (3 * k - 3, 0.5, 0)
    floor = np.array([[(-9, 0, -9), (-9, 0, 9), (9, 0, 9)], [(-9, 0, -9), (9, 0, 9), (9, 0, -9)]], float)
    scene = at.Scene.from_instances([floor, cube], [[np.eye(4)], where])
    camera = at.Camera((0, 9, 3), (0, 0, 0), width=48, height=32)
    at.dataset(scene, tmp_path / "set", [camera], at.DirectionalLight((0.6, -1, 0.1)), spp=1)
    with OpenEXR.File(str(tmp_path / "set" / "frames" / "0000.exr"), separate_channels=True) as file:
        ids = {n: c.pixels.view(np.int32) for n, c in file.channels().items() if c.pixels.dtype == np.uint32}
    blocker, hidden = ids["Light000.Blocker.X"], ids["Light000.Blocker.X"] >= 0
    objects, instances = ids["Light000.BlockerIndexOB.X"], ids["Light000.BlockerInstance.X"]
    assert (objects[~hidden] == -1).all() and (instances[~hidden] == -1).all() and hidden.any() and not hidden.all()
    assert (objects[hidden] == scene.object_of_face[blocker[hidden]]).all()
    assert (instances[hidden] == [scene.objects[k].instance for k in objects[hidden]]).all()
    shadows = hidden & (ids["ViewLayer.IndexOB.X"] == 0)
    assert set(instances[shadows]) == {0, 1, 2}, "the shadows on the floor are of three instances"
