"""The default view of a store is that of its scene in memory: from outside, or from inside a room or a sky box."""

import numpy as np
import pytest

import antumbra as at
from antumbra.engine.sources import paged_views
from cutout_scenes import scene_with_cutouts
from engine.test_default_view import BOXES, MAP, block, divided


def boxed(name, times=0):
    return at.Scene.from_arrays(np.concatenate([divided(block(*BOXES[name]), times), MAP]))


def with_points(faces):
    """Some faces more, which have no area."""
    return np.concatenate([faces, np.repeat(faces[::3, :1], 3, 1), faces[:50]])


SCENES = {
    "room": lambda: at.procedural("atrium", triangles=4000),
    "cellar": lambda: at.procedural("cellar", triangles=4000),
    "city": lambda: at.procedural("city", triangles=20_000),
    "forest": lambda: at.procedural("forest", triangles=4000),
    "map": lambda: at.Scene.from_arrays(MAP),
    "far box": lambda: boxed("far"),
    "tight box": lambda: boxed("tight", 2),
    "tower": lambda: boxed("tower"),
    "two boxes": lambda: at.Scene.from_arrays(
        np.concatenate([block((-90, -50, -90), (90, 90, 90)), block(*BOXES["around"], inward=True), MAP])
    ),
    "z up": lambda: at.Scene.from_arrays(boxed("around").triangles().vertices[..., [0, 2, 1]] * (1, -1, 1), up="z"),
    "far away": lambda: at.Scene.from_arrays(boxed("around").triangles().vertices + np.array([5e6, 0, -4e5])),
    "without area": lambda: at.Scene.from_arrays(with_points(boxed("around").triangles().vertices)),
    "cut-outs": scene_with_cutouts,
    "instances": lambda: at.Scene.from_instances([block((0, 0, 0), (1, 1, 1))], [copies()], instances=True),
    "terrain": lambda: at.from_raster((np.add.outer(np.arange(30.0), np.arange(40.0) % 7), (2.0, 0, 0, 0, -2.0, 0))),
}


def copies():
    out = np.tile(np.eye(4), (30, 1, 1))
    out[:, :3, 3] = np.random.default_rng(0).uniform(-9, 9, (30, 3))
    return out


def same_view(one, other):
    """Check that two views have the same room, cameras and lights."""
    for a, b in zip(one.room or (), other.room or ()):
        np.testing.assert_array_equal(a, b)
    assert (one.room is None) == (other.room is None)
    for size in ((40, 30), (10, 70)):
        assert repr(one.camera(*size)) == repr(other.camera(*size))
    assert repr(one.lights()) == repr(other.lights())


@pytest.mark.parametrize("name", SCENES)
def test_the_view_of_a_store_is_that_of_its_scene(tmp_path, name):
    scene = SCENES[name]()
    at.build_store(scene, tmp_path / "a.antumbra", chunk=64)
    at.build_store(scene, tmp_path / "a.tiles", chunk=64, tile=150)
    for file in ("a.antumbra", "a.tiles"):
        same_view(at.load(tmp_path / file).view, scene.view)
    inside = {"room", "far box", "tight box", "tower", "two boxes", "z up", "far away", "without area"}
    assert (scene.view.room is not None) == (name in inside)


def test_a_box_that_does_not_fit_in_memory_stays_closed(tmp_path, monkeypatch):
    """The store is then shown as if the box were not found: its faces cannot be told from the content's."""
    at.build_store(boxed("far"), tmp_path / "a.antumbra", chunk=64)
    monkeypatch.setattr(paged_views, "ALL_BYTES", 1 << 40)
    room = at.load(tmp_path / "a.antumbra").view.room
    assert room is None or room.planes is None
    monkeypatch.undo()
    assert at.load(tmp_path / "a.antumbra").view.room.planes is not None


def test_images_leave_no_chunk_in_memory(tmp_path, monkeypatch):
    at.build_store(SCENES["room"](), tmp_path / "a.antumbra", chunk=64)
    sources, make = [], paged_views.ViewsInStore.__init__
    monkeypatch.setattr(
        paged_views.ViewsInStore, "__init__", lambda self, source: (sources.append(source), make(self, source))[1]
    )
    assert at.load(tmp_path / "a.antumbra").view.room is not None
    assert len(sources) == 1 and sources[0].residency.held == 0 and sources[0].residency.paging.loaded > 0


def test_images_take_the_chunks_of_the_scene_and_have_room_for_all_cut_outs(tmp_path, monkeypatch):
    scene = SCENES["room"]()
    at.build_store(scene, tmp_path / "a.antumbra", chunk=64)
    store = at.load(tmp_path / "a.antumbra")
    store.max_memory = 16 << 30
    points = np.random.default_rng(0).uniform(*scene.bounds, (2000, 3))
    blocked = store.occluded(points, points[::-1] - points)
    source = store.engine.source
    assert source.residency.held > 0
    monkeypatch.setattr(type(store.data), "cutout_bytes", property(lambda self: 4 << 30))
    limits, make = [], paged_views.ViewsInStore.__init__
    monkeypatch.setattr(
        paged_views.ViewsInStore,
        "__init__",
        lambda self, views: (limits.append((views.max_memory, source.residency.held)), make(self, views))[1],
    )
    assert store.view.room is not None
    ((limit, held),) = limits
    assert limit > 4 << 30 and held == 0
    np.testing.assert_array_equal(store.occluded(points, points[::-1] - points), blocked)
