"""The page in headless Chromium, and its server."""

import io
import socket
import time

import numpy as np
import pytest
from PIL import Image

import antumbra as at
from antumbra.viewer.render_words import render_command
from antumbra.viewer.viewer_page import checked_port
from pages import CAMERA, SUN, box_on_floor, headless

WAIT = 120.0  # seconds, at most

pytestmark = pytest.mark.programs


@pytest.fixture(scope="module")
def chromium():
    with headless() as started:
        yield started


@pytest.fixture
def viewer(chromium):
    with at.view(box_on_floor(), SUN, camera=CAMERA, port=0, browser=False) as made:
        made._page.guard.still = b""  # the scene is seen once the page works
        yield made


@pytest.fixture
def page(chromium, viewer):
    opened = chromium.new_page(viewport=SIZE)
    opened.goto(viewer.url)
    yield opened
    opened.close()


def pixels(page):
    """(h, w, 3) int of the page."""
    return np.asarray(Image.open(io.BytesIO(page.screenshot(timeout=1000 * WAIT))).convert("RGB")).astype(int)


def shown(page, condition):
    """The pixels of the page as soon as the condition holds for them."""
    end = time.monotonic() + WAIT
    while True:
        found = pixels(page)
        if condition(found):
            return found
        assert time.monotonic() < end, "the page does not show it"
        time.sleep(0.2)


def red(found, y, x):
    r, g, b = found[y, x]
    return r > 2 * g and r > 2 * b and r > 60


SIZE = {"width": 1324, "height": 400}  # the panel takes 324
MIDDLE, NORTH, SOUTH = (200, 500), (140, 500), (262, 500)
"""Places of the page: the top of the box, and the floor beside it."""


def bright(found, place):
    return found[place].min() > 150


def dark(found, place):
    return found[place].max() < 110


def test_the_page_shows_the_scene_and_the_sun_moves_its_shadow(page):
    found = shown(page, lambda p: red(p, *MIDDLE) and bright(p, SOUTH) and dark(p, NORTH))
    assert len(np.unique(found.reshape(-1, 3), axis=0)) > 20
    bearing, _, _ = page.get_by_role("slider").all()  # bearing, elevation, exposure
    bearing.press("Home")  # 0 degrees: the sun in the north
    shown(page, lambda p: bright(p, NORTH) and dark(p, SOUTH))


PHONE = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}
PANEL = "[data-panel]"  # the head of the folded panel


@pytest.fixture
def phone(chromium, viewer):
    context = chromium.new_context(**PHONE)
    context.set_default_timeout(1000 * WAIT)  # software WebGL takes its time
    opened = context.new_page()
    opened.goto(viewer.url)
    opened.locator(".mantine-Notification-closeButton").tap()  # the notice about software WebGL
    yield opened
    context.close()


def test_on_a_phone_the_panel_opens_below_the_scene_and_its_sliders_change_the_picture(phone, viewer):
    complaints = []
    phone.on("console", lambda message: complaints.append(message.text) if message.type == "error" else None)
    phone.on("pageerror", lambda error: complaints.append(str(error)))
    folded = phone.locator(PANEL).bounding_box()
    assert folded["x"] == 0 and folded["width"] == 390 and folded["y"] > 700  # the rest is the scene's
    phone.locator(PANEL).tap()
    phone.wait_for_function(f"document.querySelector('{PANEL}').getBoundingClientRect().top < 600")
    assert phone.evaluate("document.documentElement.scrollWidth") == 390
    thumb = phone.get_by_role("slider").first.bounding_box()
    assert min(thumb["width"], thumb["height"]) >= 24  # for thumbs
    phone.wait_for_timeout(1000)  # until it has unfolded
    height = int(phone.locator(PANEL).bounding_box()["y"])
    middle, north, south = ((int(share * height), 195) for share in (0.5, 0.35, 0.65))
    shown(phone, lambda p: red(p, *middle) and dark(p, north) and bright(p, south))
    phone.get_by_role("slider").first.press("Home")  # the bearing: the sun in the north
    shown(phone, lambda p: red(p, *middle) and bright(p, north) and dark(p, south))
    assert not complaints


def test_on_a_phone_a_tap_says_what_the_point_sees(phone, viewer):
    shown(phone, lambda p: red(p, 400, 195))
    phone.touchscreen.tap(195, 400)
    phone.locator(PANEL).tap()
    phone.get_by_text("In the sun. Sees 100 % of the sky.").wait_for(timeout=1000 * WAIT)


def test_beside_the_panel_the_whole_canvas_is_the_scene(page):
    panel = page.get_by_text("Antumbra: box & floor").bounding_box()
    assert page.locator("canvas").first.bounding_box()["width"] <= panel["x"]


def test_a_page_for_other_machines_works_with_its_token(chromium):
    with at.view(box_on_floor(), SUN, camera=CAMERA, host="0.0.0.0", port=0, browser=False) as viewer:
        viewer._page.guard.still = b""
        opened = chromium.new_page(viewport=SIZE)
        opened.goto(viewer.url)
        shown(opened, lambda p: red(p, *MIDDLE))
        opened.reload()  # the client has written the address of its WebSocket into that of the page
        shown(opened, lambda p: red(p, *MIDDLE))
        assert opened.goto(viewer.url.replace(viewer.url.split("/")[-2], "wrong")).status == 403
        opened.close()


def test_a_click_says_what_the_point_sees(page):
    shown(page, lambda p: red(p, *MIDDLE))
    assert page.get_by_text("Click or tap a surface").count() == 1
    page.mouse.click(*NORTH[::-1])
    page.get_by_text("behind face").wait_for(timeout=1000 * WAIT)
    assert page.get_by_text("0 % of 256").count() == 1
    line = lambda p: ((p[..., 0] > 200) & (p[..., 1] < 120) & (p[..., 2] < 120)).sum() > 20
    shown(page, line)
    page.mouse.click(*SOUTH[::-1])
    page.get_by_text("100 % of 256").wait_for(timeout=1000 * WAIT)


def test_turning_shows_the_stand_in_and_then_the_picture(page):
    shown(page, lambda p: red(p, *MIDDLE))
    rest = pixels(page)
    page.mouse.move(400, 330)
    page.mouse.down()
    page.mouse.move(460, 250, steps=3)
    page.mouse.up()
    turned = shown(page, lambda p: (np.abs(p - rest).max(2) > 30).mean() > 0.05)
    reds = (turned[..., 0] > 2 * turned[..., 1]) & (turned[..., 0] > 60)
    assert reds.sum() > 500  # the box is still there


def test_keys_zoom_reset_and_list_themselves_and_all_controls_have_names(page):
    complaints = []
    page.on("console", lambda message: complaints.append(message.text) if message.type == "error" else None)
    shown(page, lambda p: red(p, *MIDDLE))
    reds = lambda p: ((p[..., 0] > 2 * p[..., 1]) & (p[..., 0] > 60)).sum()
    size = reds(pixels(page))
    for _ in range(3):
        page.keyboard.press("-")
    shown(page, lambda p: 100 < reds(p) < 0.8 * size)
    page.keyboard.press("r")
    shown(page, lambda p: reds(p) > 0.95 * size)
    page.keyboard.press("+")
    shown(page, lambda p: reds(p) > 1.1 * size)
    page.keyboard.press("?")
    assert page.get_by_role("dialog", name="Keyboard shortcuts").get_by_text("reset the view").is_visible()
    page.keyboard.press("Escape")
    assert not page.get_by_role("dialog", name="Keyboard shortcuts").is_visible()
    for name in "Bearing", "Elevation", "Exposure":
        assert page.get_by_role("slider", name=name).count() == 1
    nameless = "button, input:not([type=hidden]), [role=slider], [role=button]"
    named = "e => [...e.labels ?? []].length || e.ariaLabel || e.textContent.trim() || e.closest('[aria-hidden=true]')"
    found = page.locator(nameless).evaluate_all(f"all => all.filter(e => !({named})(e)).map(e => e.outerHTML)")
    assert not found and not complaints


def test_the_command_of_a_view_is_copied(page, viewer):
    page.context.grant_permissions(["clipboard-read", "clipboard-write"])
    shown(page, lambda p: red(p, *MIDDLE))
    page.keyboard.press("c")
    page.get_by_text("Copied the command").wait_for(timeout=1000 * WAIT)
    command = page.evaluate("navigator.clipboard.readText()")
    assert command == render_command(viewer._model, viewer.camera) and page.get_by_text(command).count() == 1
    assert command.startswith("antumbra render 'box & floor' --size ") and " --camera=0,12," in command
    page.evaluate("navigator.clipboard.writeText('mine')")
    page.evaluate("e = document.querySelector('code'); e.dataset.copy = '1'; e.previousSibling.before('drawn again')")
    page.wait_for_function("!document.querySelector('[data-copy]')")
    assert page.evaluate("navigator.clipboard.readText()") == "mine"
    page.get_by_role("slider", name="Bearing").press("Home")
    shown(page, lambda p: bright(p, NORTH))
    page.keyboard.press("c")
    moved = render_command(viewer._model, viewer.camera)
    page.get_by_text(moved).wait_for(timeout=1000 * WAIT)
    assert moved != command and page.locator("code").count() == 1


def test_the_viewer_is_a_handle(viewer):
    assert viewer.url.startswith("http://127.0.0.1:") and viewer.url in repr(viewer)
    assert viewer.url in viewer._repr_html_() and "iframe" in viewer._repr_html_()
    (sun,) = viewer.lights
    assert (sun.direction == SUN.direction).all() and viewer.time == 0.0
    viewer.time = 5.0
    assert viewer.time == 0.0  # the scene does not move
    viewer.close()
    viewer.close()
    assert "closed" in repr(viewer) and "iframe" not in viewer._repr_html_()
    checked_port("127.0.0.1", int(viewer.url.rpartition(":")[2]))  # free again
    viewer.wait()
    assert (viewer.camera.position == CAMERA.position).all() and len(viewer.lights) == 1


def test_what_the_user_left_can_be_rendered(page, viewer):
    shown(page, lambda p: red(p, *MIDDLE))
    bearing, _, _ = page.get_by_role("slider").all()  # bearing, elevation, exposure
    bearing.press("Home")
    shown(page, lambda p: dark(p, SOUTH) and bright(p, NORTH))
    np.testing.assert_allclose(viewer.camera.position, CAMERA.position, atol=1e-5)
    assert (viewer.camera.width, viewer.camera.height) == (1000, 400)
    frame = at.render(viewer.scene, viewer.camera, viewer.lights, spp=1)
    lit = frame.visibility[0]
    assert lit[NORTH] == 1.0 and lit[SOUTH] == 0.0 and frame.mask[MIDDLE]


def test_busy_and_impossible_ports_have_a_cure():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(at.InputError, match=f"port {port} is busy; choose another with --port"):
            checked_port("127.0.0.1", port)
    assert 0 < checked_port("127.0.0.1", 0) < 65536
    with pytest.raises(at.InputError, match="is this machine"):
        checked_port("192.0.2.1", 8080)
