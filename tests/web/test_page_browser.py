"""Pages in headless Chromium, opened from a folder without a network: pictures, suns, answers, and the proof."""

import json
from datetime import datetime
from importlib.util import find_spec

import numpy as np
import pytest

import antumbra as at
from antumbra.city.sensors.sensors import point_sensors
from antumbra.sun.location import Place
from antumbra.sun.sun_positions import solar_angles
from antumbra.web import page_export
from antumbra.web.page_export import PageOptions, write_page

pytestmark = [
    pytest.mark.programs,
    pytest.mark.skipif(find_spec("ziglang") is None, reason="without ziglang, pages are NOT checked"),
]
PLACE = Place(52.0, 4.4, timezone="Europe/Amsterdam")
DAY = "2026-03-21"
FIRST = "body[data-samples]"


def towers():
    """A floor of 80 m with two towers, named, and z up: {name of a tower: its mesh}."""
    c = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (0, 1)], np.float64)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (1, 5, 7, 3)]
    box = np.array([c[list(three)] for a, b, d, e in quads for three in ((a, b, d), (a, d, e))])
    floor = np.array([[[-40, -40, 0], [40, -40, 0], [40, 40, 0]], [[-40, -40, 0], [40, 40, 0], [-40, 40, 0]]], float)
    places = {"Tower A": ((5, 5, 30), (-12, -14, 0)), "Tower B": ((4, 4, 45), (14, -10, 0))}
    return {"floor": floor, **{name: box * size + shift for name, (size, shift) in places.items()}}


def scene_of_towers(folder):
    """The towers from an OBJ file, whose materials are the objects."""
    colours = "".join(f"newmtl {name.replace(' ', '_')}\nKd 0.7 0.6 0.5\n" for name in towers())
    (folder / "towers.mtl").write_text(colours)
    lines, n = ["mtllib towers.mtl"], 0
    for name, corners in towers().items():
        lines.append(f"usemtl {name.replace(' ', '_')}")
        lines += [f"v {x} {y} {z}" for x, y, z in corners.reshape(-1, 3)]
        lines += [f"f {n + i + 1} {n + i + 2} {n + i + 3}" for i in range(0, 3 * len(corners), 3)]
        n += 3 * len(corners)
    path = folder / "towers.obj"
    path.write_text("\n".join(lines) + "\n")
    return at.load(path, up="z")


def options(language="en"):
    return PageOptions("Towers", datetime(2026, 3, 21, 12, 30), PLACE, "A model of ours", language)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """(scene, path of its page)."""
    folder = tmp_path_factory.mktemp("pages")
    scene = scene_of_towers(folder)
    camera = at.Camera((10.0, -90.0, 80.0), (5.0, 5.0, 0.0), (0.0, 0.0, 1.0), vfov=45.0)
    write_page(scene, folder / "towers.html", options(), camera)
    return scene, folder / "towers.html"


class Opened:
    """A page in a browser without a network."""

    def __init__(self, chromium, path, width=800, height=600):
        context = chromium.new_context(viewport={"width": width, "height": height})
        context.set_offline(True)
        self.page, self.faults, self.requests = context.new_page(), [], []
        self.page.on("pageerror", lambda fault: self.faults.append(str(fault)))
        self.page.on("console", lambda message: self.faults.append(message.text))
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.page.goto(path.as_uri())

    def click(self, right, down):
        """Click at shares of the picture, and return (sentence, point, normal, hours)."""
        box = self.page.locator("#picture").bounding_box()
        self.page.mouse.click(box["x"] + right * box["width"], box["y"] + down * box["height"])
        self.page.wait_for_selector("#answer[aria-busy='false']")
        answer = self.page.locator("#answer")
        point, normal = json.loads(answer.get_attribute("data-point"))
        return answer.inner_text(), np.array(point), np.array(normal), float(answer.get_attribute("data-hours"))

    def angles(self):
        return json.loads(self.page.locator("#when").get_attribute("data-angles"))


def test_a_page_opens_without_a_network(chromium, written):
    opened = Opened(chromium, written[1])
    opened.page.wait_for_selector(FIRST)
    opened.page.wait_for_selector("#proof[data-wrong='0']")
    assert opened.page.locator("#proof").inner_text().startswith("Same bits as Antumbra")
    assert opened.faults == []
    assert [url for url in opened.requests if not url.startswith("blob:")] == [written[1].as_uri()]
    image = opened.page.locator("#picture").screenshot()
    assert len(image) > 10_000  # more than a plane colour
    assert opened.page.locator("h1").inner_text() == "Towers"
    assert opened.page.locator("#scale").inner_text().endswith(" m")


def test_a_page_that_finds_other_bits_says_so(chromium, written, tmp_path, monkeypatch):
    whole = page_export.Columns.add

    def altered(columns, name, values, step=False):
        if name == "distances":
            values = values.copy()
            values[:7] = np.nextafter(values[:7], np.inf) if np.isfinite(values[:7]).all() else 5.0
        whole(columns, name, values, step)

    monkeypatch.setattr(page_export.Columns, "add", altered)
    write_page(written[0], tmp_path / "page.html", options())
    opened = Opened(chromium, tmp_path / "page.html")
    opened.page.wait_for_selector("#proof[data-wrong='7']")
    assert opened.page.locator("#proof").get_attribute("role") == "alert"
    assert "WARNING: 7 of 2000 rays differ" in opened.page.locator("#proof").inner_text()


def test_answers_have_the_hours_of_python(chromium, written):
    scene, path = written
    opened = Opened(chromium, path)
    opened.page.wait_for_selector(FIRST)
    found, sentences = [], []
    for right, down in ((0.4, 0.5), (0.43, 0.47), (0.5, 0.5), (0.55, 0.4), (0.51, 0.36), (0.3, 0.8)):
        sentence, *place = opened.click(right, down)
        found.append(place)
        sentences.append(sentence)
    points, normals, hours = (np.array(column) for column in zip(*found))
    sensors = point_sensors(points + scene.origin, normals)
    table = at.sun_hours(scene, sensors, DAY, step=5, place=PLACE)
    np.testing.assert_array_equal(np.round(hours * 12), np.round(np.asarray(table["sun_hours"]) * 12))
    assert len(set(hours.tolist())) > 2
    assert normals[0].tolist() == [0, -1, 0] and "Sees 50 % of the sky" in sentences[0]  # a wall that faces open land
    blocked = [text for text in sentences if ", blocked " in text]
    assert blocked and all("by Tower_" in text for text in blocked)
    assert opened.faults == []


def test_the_sun_follows_the_slider_and_the_date(chromium, written):
    opened = Opened(chromium, written[1])
    opened.page.wait_for_selector(FIRST)
    for day, minute, utc in (("2026-03-21", 600, "2026-03-21T09:00"), ("2026-07-05", 1080, "2026-07-05T16:00")):
        opened.page.locator("#date").fill(day)
        opened.page.locator("#first").fill(str(minute))
        altitude, azimuth = solar_angles(PLACE, np.array([utc], "datetime64[s]"))
        np.testing.assert_allclose(opened.angles(), [altitude[0], azimuth[0]], atol=0.01)
    opened.page.locator("#first").fill("120")
    assert "below the horizon" in opened.page.locator("#when").inner_text()
    assert opened.faults == []


def test_keys_move_the_view_and_ask(chromium, written):
    opened = Opened(chromium, written[1])
    opened.page.wait_for_selector(FIRST)
    before = opened.page.locator("#north").get_attribute("style")
    opened.page.locator("#picture").focus()
    for key in ("ArrowLeft", "Shift+ArrowUp", "+", "Enter"):
        opened.page.keyboard.press(key)
    opened.page.wait_for_selector("#answer[data-point]")
    assert opened.page.locator("#north").get_attribute("style") != before
    labels = opened.page.locator("[role=img]:visible")
    assert all(labels.nth(k).get_attribute("aria-label") for k in range(labels.count()))
    assert opened.faults == []


def test_a_page_without_a_place_sets_the_sun_by_hand_on_a_phone_in_german(chromium, written, tmp_path):
    write_page(written[0], tmp_path / "page.html", options("de")._replace(place=None))
    opened = Opened(chromium, tmp_path / "page.html", 390, 780)
    opened.page.wait_for_selector(FIRST)
    opened.page.locator("#second").fill("10")
    assert opened.angles()[0] == 10
    assert opened.page.locator("#date").is_hidden() and opened.page.locator("#play").is_hidden()
    assert "Höhe der Sonne" in opened.page.locator(".controls").inner_text()
    wide = opened.page.evaluate("document.documentElement.scrollWidth")
    assert wide <= 390 and opened.faults == []


def eye_of(opened):
    """What the scale bar and the north arrow say of the camera, which change as it moves."""
    return [opened.page.locator(each).get_attribute("style") for each in ("#north", "#scale")]


def test_a_visitor_walks_and_returns(chromium, written):
    opened = Opened(chromium, written[1])
    opened.page.wait_for_selector(FIRST)
    above = eye_of(opened)
    opened.page.locator("#walk").click()
    opened.page.wait_for_function(f"document.querySelector('#scale').getAttribute('style') !== {json.dumps(above[1])}")
    assert "Escape ends" in opened.page.locator("#help").inner_text()
    before = opened.page.locator("#picture").screenshot()
    opened.page.keyboard.down("w")
    opened.page.wait_for_timeout(700)
    opened.page.keyboard.up("w")
    opened.page.wait_for_selector("body[data-samples='64']", timeout=90_000)
    assert opened.page.locator("#picture").screenshot() != before
    opened.page.keyboard.press("Escape")
    assert opened.page.locator("#walk").get_attribute("aria-pressed") == "false"
    assert opened.faults == []


def test_a_room_has_no_controls_of_the_sun_and_its_textures_are_shown(chromium, tmp_path, monkeypatch):
    red = np.full((4, 4, 3), (200, 30, 20), np.uint8)
    corners = np.array([[[-4, -4, 0], [4, -4, 0], [4, 4, 0]], [[-4, -4, 0], [4, 4, 0], [-4, 4, 0]]], float)
    scene = at.Scene.from_arrays(corners, uv=corners.reshape(-1, 3)[:, :2] / 8 + 0.5, texture=red, up="z")
    lamp = at.SphereLight((0.0, 0.0, 3.0), 0.5, intensity=20.0)
    monkeypatch.setattr(type(scene), "default_lights", lambda *_: [lamp])
    camera = at.Camera((0.0, -0.1, 4.0), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), vfov=60.0)
    write_page(scene, tmp_path / "room.html", options()._replace(place=None), camera)
    opened = Opened(chromium, tmp_path / "room.html", 400, 500)
    opened.page.wait_for_selector("body[data-samples='64']", timeout=90_000)
    assert opened.page.locator("input:visible").count() == 0
    script = (
        "(c => c.getContext('2d').getImageData(c.width / 2, c.height / 2, 1, 1).data)(document.querySelector('canvas'))"
    )
    pixel = list(opened.page.evaluate(f"Array.from({script})"))
    assert pixel[0] > 2 * pixel[1] > 0 and opened.faults == []
