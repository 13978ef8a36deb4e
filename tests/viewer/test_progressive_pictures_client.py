"""What one browser gets, with a stand-in for the browser."""

import asyncio
from types import SimpleNamespace

import numpy as np
import pytest

import antumbra as at
from antumbra.viewer import progressive_pictures
from antumbra.viewer.progressive_pictures import (
    CLICK,
    HAZE,
    MESH,
    PICTURE_STEPS,
    ClientView,
    TaskQueue,
    first_pose,
    fitted,
    pose_of,
)
from antumbra.viewer.viewer_model import Model
from pages import CAMERA, SUN, box_on_floor

STILL = np.zeros((30, 40, 3), np.uint8)


class Browser:
    """Writes down what a browser would get."""

    client_id = 3

    def __init__(self):
        self.scene, self.camera, self.got = self, looking(), []
        self.standin = SimpleNamespace(visible=None)

    def set_background_image(self, image, *_, **__):
        self.got.append({HAZE.shape: "haze", STILL.shape: "still"}.get(image.shape, image.shape[:2]))

    def add_glb(self, name, data, visible):
        self.standin.visible = visible
        return self.standin


def looking(x=0.0, width=64, height=48):
    """A camera as viser has it, which looks along -z from (x, 0, 20)."""
    return SimpleNamespace(
        wxyz=(0.0, 1.0, 0.0, 0.0), position=(x, 0.0, 20.0), fov=0.8, image_width=width, image_height=height
    )


@pytest.fixture
def viewing(monkeypatch):
    monkeypatch.setattr(progressive_pictures, "REST_DELAY", 0.02)
    monkeypatch.setattr(progressive_pictures, "DISPLAY_DELAY", 0.0)
    monkeypatch.setattr(progressive_pictures, "FIRST_DELAY", 0.0)
    worker, drawn, browser = TaskQueue(lambda error: drawn.append(error)), [], Browser()
    made = ClientView(Model(box_on_floor(), SUN, CAMERA), worker, browser, drawn.append, STILL)
    made.worker, made.drawn, made.browser = worker, drawn, browser
    yield made
    worker.close()


def test_poses_come_from_the_browser():
    pose = pose_of(looking(2.0))
    np.testing.assert_allclose(pose.target - pose.position, (0, 0, -1), atol=1e-12)
    np.testing.assert_allclose(pose.up, (0, 1, 0), atol=1e-12)
    assert (pose.width, pose.height, pose.vfov) == (64, 48, 0.8) and pose_of(looking(width=0)) is None


def test_pictures_become_finer_until_the_last(viewing):
    asyncio.run(viewing.look(looking()))
    assert viewing.worker.wait(60.0)
    assert [picture.step for picture in viewing.drawn] == list(PICTURE_STEPS)
    assert viewing.browser.got == ["still", (6, 8), (12, 16), (24, 32), (48, 64), (48, 64), (48, 64)]


def test_a_move_begins_anew_and_other_pixels_do_not(viewing):
    asyncio.run(viewing.look(looking()))
    assert viewing.worker.wait(60.0)
    n = len(viewing.drawn)
    asyncio.run(viewing.look(looking(width=32, height=24)))
    assert viewing.worker.wait(60.0) and len(viewing.drawn) == n
    asyncio.run(viewing.look(looking(1.0)))
    assert viewing.worker.wait(60.0) and len(viewing.drawn) == 2 * n
    viewing.begin(0.0)
    assert viewing.worker.wait(60.0) and len(viewing.drawn) == 3 * n


def test_a_browser_that_has_gone_gets_nothing(viewing):
    asyncio.run(viewing.look(looking()))
    viewing.leave()
    assert viewing.worker.wait(60.0)
    n = len(viewing.browser.got)
    viewing.begin(0.0)
    assert viewing.worker.wait(60.0) and len(viewing.browser.got) == n < len(PICTURE_STEPS)


def test_the_stand_in_is_seen_while_the_camera_moves(viewing):
    asyncio.run(viewing.look(looking()))
    assert viewing.worker.wait(60.0)
    viewing.put_proxy(b"")
    assert viewing.browser.standin.visible is False
    viewing.browser.got.clear()
    progressive_pictures.REST_DELAY = 1000.0
    for x in (1.0, 2.0, 3.0):
        asyncio.run(viewing.look(looking(x)))
    assert viewing.browser.standin.visible is True and viewing.browser.got == ["haze"]
    progressive_pictures.REST_DELAY = 0.0
    asyncio.run(viewing.look(looking(4.0)))
    assert viewing.worker.wait(60.0) and len(viewing.browser.got) == 1 + len(PICTURE_STEPS)
    for _ in range(200):
        if viewing.browser.standin.visible is False:
            break
        asyncio.run(asyncio.sleep(0.01))
    assert viewing.browser.standin.visible is False


def test_a_page_that_changes_its_shape_is_fitted_until_the_camera_moves(viewing):
    viewing.model = Model(box_on_floor(), SUN, at.Camera((0.0, 1.0, 30.0), (0.0, 1.0, 0.0), vfov=40.0))
    home = first_pose(viewing.model, 64, 48)
    camera = looking()
    viewing.go_home(camera)
    assert camera.fov == home.vfov == pytest.approx(np.radians(40.0)) and (camera.position == home.position).all()
    camera.image_width, camera.image_height = 32, 64
    asyncio.run(viewing.look(camera))
    assert np.tan(camera.fov / 2.0) == pytest.approx(2.0 * np.tan(home.vfov / 2.0))  # as much from side to side
    assert viewing.pose.vfov == camera.fov
    camera.position = camera.position + [1.0, 0.0, 0.0]
    asyncio.run(viewing.look(camera))
    seen, camera.image_width = camera.fov, 64
    asyncio.run(viewing.look(camera))
    assert camera.fov == seen and viewing.pose.width == 64


def test_the_first_picture_is_no_stand_in(viewing):
    viewing.put_proxy(b"")
    asyncio.run(viewing.look(looking()))
    assert viewing.browser.standin.visible is False
    assert viewing.worker.wait(60.0) and viewing.browser.got[1] == (6, 8)


def test_a_picture_from_before_a_change_is_not_sent(viewing, monkeypatch):
    asyncio.run(viewing.look(looking()))
    assert viewing.worker.wait(60.0)
    n, traced = len(viewing.drawn), []
    trace = progressive_pictures.trace_picture

    def trace_once(model, camera, step, check):
        picture = trace(model, camera, step)  # without a check
        traced.append(step)
        if len(traced) == 3:
            viewing.begin(0.0)
        return picture

    monkeypatch.setattr(progressive_pictures, "trace_picture", trace_once)
    viewing.begin(0.0)
    assert viewing.worker.wait(60.0)
    assert traced == [*PICTURE_STEPS[:3], *PICTURE_STEPS]
    assert [picture.step for picture in viewing.drawn[n:]] == [*PICTURE_STEPS[:2], *PICTURE_STEPS]


def test_the_cores_are_idle_after_the_coarsest_picture(viewing, monkeypatch):
    monkeypatch.setattr(progressive_pictures, "FIRST_DELAY", 1000.0)
    asyncio.run(viewing.look(looking()))
    for _ in range(2000):
        if viewing.drawn:
            break
        asyncio.run(asyncio.sleep(0.01))
    baked = []
    viewing.worker.submit("proxy mesh", MESH, lambda check: baked.append(1))
    viewing.worker.submit("click", CLICK, lambda check: baked.append(len(baked)))
    for _ in range(2000):
        if baked:
            break
        asyncio.run(asyncio.sleep(0.01))
    asyncio.run(asyncio.sleep(0.1))
    assert baked == [0] and len(viewing.drawn) == 1  # clicks are answered
    viewing.leave()
    assert viewing.worker.wait(60.0) and baked == [0, 1]


@pytest.mark.parametrize("aspect, shape", [(40 / 30, (30, 40)), (2.0, (20, 40)), (1.0, (30, 30)), (1e6, (1, 40))])
def test_a_still_is_cropped_for_wide_pages(aspect, shape):
    picture = np.arange(30 * 40).reshape(30, 40, 1)
    part = fitted(picture, aspect)
    assert part.shape[:2] == shape and divmod(part[0, 0, 0], 40) == ((30 - shape[0]) // 2, (40 - shape[1]) // 2)


@pytest.mark.parametrize("aspect, height", [(0.5, 80), (0.8, 50), (1e-9, 240)])
def test_a_still_is_continued_for_upright_pages(aspect, height):
    picture = np.arange(30 * 40).reshape(30, 40, 1)
    whole = fitted(picture, aspect)
    assert whole.shape == (height, 40, 1) and (whole[0] == picture[0]).all() and (whole[-1] == picture[-1]).all()
    assert (whole[height // 2 - 15 : height // 2 + 15] == picture).all()
