"""The G-buffer by the faster method: rays where a tree is kept, the same bits, and no choice by the first call."""

import numpy as np
import pytest

import antumbra as at
from antumbra.engine import primary_visibility
from antumbra.engine.auto_accelerator import AutoAccelerator
from antumbra.engine.primary_visibility import RASTER, RAYS, PrimaryMethodChooser

LAMP = at.QuadLight((-1, 7, -1), (2, 0, 0), (0, 0, 2))


@pytest.fixture(scope="module")
def scene():
    return at.procedural("atrium", triangles=3000)


@pytest.fixture
def compiled(monkeypatch):
    """All kernels are compiled; trees are kept, however slow the machine, and have the form that camera rays walk."""
    monkeypatch.setattr(primary_visibility, "rays_are_compiled", lambda: True)
    monkeypatch.setattr(primary_visibility, "has_blocks", lambda whole: True)
    monkeypatch.setattr(AutoAccelerator, "needs_rebuild", lambda self, accelerated: False)


def _used(monkeypatch):
    """A list that gets the method of each frame."""
    used, timed = [], PrimaryMethodChooser.timed

    def noted(self, method, pixels, look):
        used.append(method)
        return timed(self, method, pixels, look)

    monkeypatch.setattr(PrimaryMethodChooser, "timed", noted)
    return used


@pytest.mark.parametrize("plan", ["auto", "bsah+multifrusta"])
def test_later_frames_try_rays_and_have_the_same_surfaces(scene, monkeypatch, compiled, plan):
    used, camera = _used(monkeypatch), scene.cameras[0].resized(40, 30)
    renderer = at.Renderer(scene, plan)
    frames = [renderer.render(camera, LAMP, spp=4) for _ in range(6)]
    assert used[:4] == [RASTER, RASTER, RAYS, RAYS] and set(used[4:]) <= {RASTER, RAYS}
    for frame in frames[1:]:
        for one, other in zip(frames[0].gbuffer, frame.gbuffer):
            np.testing.assert_array_equal(one, other)
        np.testing.assert_array_equal(frame.bits[0], frames[0].bits[0])


def test_rays_wait_until_their_kernels_are_compiled(scene, monkeypatch):
    monkeypatch.setattr(primary_visibility, "rays_are_compiled", lambda: False)
    used, renderer = _used(monkeypatch), at.Renderer(scene)
    for _ in range(4):
        renderer.render(scene.cameras[0].resized(24, 20), LAMP, spp=4)
    assert used == [RASTER] * 4


def test_moving_scenes_have_no_tree_in_time(tmp_path, monkeypatch, compiled):
    rng = np.random.default_rng(0)
    still = rng.normal(size=(300, 3))
    np.save(tmp_path / "frames.npy", np.stack([still, still + 0.01 * rng.normal(size=still.shape)]))
    np.save(tmp_path / "faces.npy", np.arange(300).reshape(-1, 3))
    used, renderer = _used(monkeypatch), at.Renderer(at.load(tmp_path))
    for time in (0.0, 0.5, 1.0):
        renderer.render(at.Camera((0, 0, 6), (0, 0, 0), width=24, height=20), LAMP, time=time)
    assert used == [RASTER] * 3


@pytest.mark.parametrize("slow, fast", [(RASTER, RAYS), (RAYS, RASTER)])
def test_the_faster_method_is_used_and_the_other_tried_again(monkeypatch, slow, fast):
    clock = [0.0]
    monkeypatch.setattr(primary_visibility, "perf_counter", lambda: clock[0])
    monkeypatch.setattr(primary_visibility, "rays_are_compiled", lambda: True)
    monkeypatch.setattr(primary_visibility, "has_blocks", lambda whole: True)
    chooser, used = PrimaryMethodChooser(), []

    def look(method):
        clock[0] += 100.0 * (method not in used) + {slow: 2.0, fast: 1.0}[method]  # first calls take much longer

    for _ in range(4 + primary_visibility.RETRY_PERIOD):
        method = chooser.choose(object())
        chooser.timed(method, 10, lambda method=method: look(method))
        used.append(method)
    assert used[:4] == [RASTER, RASTER, RAYS, RAYS]
    assert used[4:-1] == [fast] * (primary_visibility.RETRY_PERIOD - 1) and used[-1] == slow
    assert PrimaryMethodChooser().choose(None) == RASTER
