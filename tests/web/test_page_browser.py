"""Pages in headless Chromium, opened from a folder without a network: pictures, suns, answers, and the proof."""

import json
from datetime import datetime
from importlib.util import find_spec
from zoneinfo import ZoneInfo

import numpy as np
import pytest

import antumbra as at
from antumbra.city.sensors.sensors import point_sensors
from antumbra.sun.location import Place
from antumbra.sun.sun_positions import days_of, directions_of, solar_angles, times_of
from antumbra.web import page_export
from antumbra.web.page_export import PageOptions, write_page
from web_pages import scene_of_towers

pytestmark = [
    pytest.mark.programs,
    pytest.mark.skipif(find_spec("ziglang") is None, reason="without ziglang, pages are NOT checked"),
]
PLACE = Place(52.0, 4.4, timezone="Europe/Amsterdam")
DAY = "2026-03-21"
FIRST = "body[data-samples]"


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

    def point(self, right, down):
        """Move the pointer to shares of the picture."""
        box = self.page.locator("#picture").bounding_box()
        self.page.mouse.move(box["x"] + right * box["width"], box["y"] + down * box["height"])

    def press(self, right, down):
        """Press the pointer at shares of the picture."""
        self.point(right, down)
        self.page.mouse.down()
        self.page.mouse.up()

    def click(self, right, down):
        """Ask at shares of the picture, and return (sentence, point, normal, hours)."""
        self.press(right, down)
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
    assert normals[0].tolist() == [0, -1, 0] and "sees 50 % of the sky" in sentences[0]  # a wall that faces open land
    blocked = [text for text in sentences if ", blocked " in text]
    assert blocked and all("by Tower_" in text for text in blocked)
    assert opened.faults == []


def painted(opened, kind):
    """Paint hours of sun, and return the words of the command that has the same numbers."""
    opened.page.locator("#show").select_option(kind)
    opened.page.wait_for_selector("#value[data-state='done']", timeout=60_000)
    return opened.page.locator("#command").inner_text().split()


def hours_within(scene, sensors, days, step, error=0.01):
    """The least and the most hours of sun of sensors if positions of the sun are wrong by up to `error` degrees."""
    times = times_of(days_of(",".join(days)), ZoneInfo(PLACE.timezone), step)
    altitude, azimuth = solar_angles(PLACE, times.middle)
    seen = []
    for up in (-error, 0.0, error):
        for aside in (-error, 0.0, error):
            ways = directions_of(altitude + up, azimuth + aside / np.cos(np.radians(altitude)), "z")
            origins = (sensors.points + 1e-4 * sensors.normals)[:, None]
            ahead = (sensors.normals @ ways.T > 0.0) & (altitude + up > 0.0)
            seen.append(ahead & ~scene.occluded(*np.broadcast_arrays(origins, ways)))
    return np.all(seen, 0) @ times.hours, np.any(seen, 0) @ times.hours


def test_paint_has_the_hours_of_the_command(chromium, written):
    scene, path = written
    opened = Opened(chromium, path, 1200, 700)
    opened.page.wait_for_selector(FIRST)
    opened.page.locator("#picture").focus()
    for _ in range(16):
        opened.page.keyboard.press("+")  # until a sensor's cell has several pixels
    places = [(right, down) for right in (0.3, 0.4, 0.5, 0.6, 0.7, 0.8) for down in (0.2, 0.35, 0.5, 0.65, 0.8)]
    spots = [opened.click(*place)[1:3] for place in places]
    points, normals = (np.array(column) + shift for column, shift in zip(zip(*spots), (scene.origin, 0.0)))
    faces = scene.closest_hit(points + 1e-3 * normals, -normals).face
    for kind, days in (("day", [DAY]), ("year", [f"2026-{month:02d}-21" for month in range(1, 13)])):
        words = painted(opened, kind)
        options = dict(zip(words[2::2], words[3::2]))
        assert words[:2] == ["antumbra", "sun"] and options["--days"] == ",".join(days)
        table = at.sun_hours(scene, options["--sensors"], options["--days"], step=float(options["--step"]), place=PLACE)
        found, rows, spacing = [], [], float(options["--sensors"].removeprefix("grid:"))
        for place, point, face in zip(places, points, faces):
            own = np.flatnonzero(table.sensors.faces == face)
            away = np.linalg.norm(table.sensors.points[own] - point, axis=1)
            if away.min() > 0.35 * spacing:
                continue  # between sensors, where rounding decides
            opened.point(*place)
            found.append(float(opened.page.locator("#value").get_attribute("data-hours")) * len(days))
            rows.append(own[away.argmin()])
        low, high = hours_within(scene, table.sensors.take(np.unique(rows)), days, float(options["--step"]))
        order = np.searchsorted(np.unique(rows), rows)
        wanted = table["sun_hours"][rows]
        assert (low[order] - 1e-9 <= found).all() and (found <= high[order] + 1e-9).all()
        assert np.isclose(found, wanted, atol=1e-9, rtol=0.0).sum() > 0.7 * len(found) > 4
        assert len(set(found)) > 4
    assert opened.faults == []


def test_painting_stops_and_starts_anew(chromium, written):
    opened = Opened(chromium, written[1])
    opened.page.wait_for_selector(FIRST)
    button, value = opened.page.locator("#paint"), opened.page.locator("#value")
    assert button.is_hidden() and opened.page.locator("#legend").is_hidden()
    opened.page.locator("#show").select_option("year")
    opened.page.wait_for_selector("#value[data-state='painting']")
    button.click()
    opened.page.wait_for_selector("#value[data-state='stopped']")
    assert button.inner_text() == "Restart" and value.inner_text().endswith("stopped")
    button.click()
    opened.page.wait_for_selector("#value[data-state='painting']")
    before = opened.page.locator("#command").inner_text()
    opened.page.locator("#date").fill("2025-01-05")
    opened.page.wait_for_function("before => document.getElementById('command').textContent !== before", arg=before)
    assert "2025-12-21" in opened.page.locator("#command").inner_text()
    opened.page.locator("#show").select_option("light")
    assert opened.page.locator("#legend").is_hidden() and opened.page.locator("#overlay").is_hidden()
    assert opened.faults == []


def test_two_clicks_measure_a_distance_and_the_sight_between(chromium, written):
    scene, path = written
    opened = Opened(chromium, path)
    opened.page.wait_for_selector(FIRST)
    opened.page.locator("#ruler").click()
    answer = opened.page.locator("#answer")
    assert answer.inner_text() == "Click the first place."
    verdicts = []
    for first, second in (((0.3, 0.8), (0.6, 0.75)), ((0.3, 0.8), (0.6, 0.45)), ((0.5, 0.5), (0.3, 0.8))):
        opened.press(*first)
        opened.page.wait_for_function(
            "() => document.getElementById('answer').textContent === 'Click the second place.'"
        )
        opened.press(*second)
        opened.page.wait_for_function("() => document.getElementById('answer').textContent.includes('apart')")
        found = json.loads(answer.get_attribute("data-measured"))
        spots = found["eye"]["spot"], found["spot"]
        away = np.subtract(spots[1]["point"], spots[0]["point"])
        lengths = np.linalg.norm(away), np.hypot(away[0], away[1]), away[2]
        np.testing.assert_allclose([found[name] for name in ("length", "level", "rise")], lengths, rtol=1e-12)
        eye = np.array(spots[0]["point"]) + [0, 0, found["eye"]["height"]]
        normal = None if found["eye"]["height"] else spots[0]["normal"]
        sight = at.line_of_sight(scene, eye, spots[1]["point"], normals=normal, target_normals=spots[1]["normal"])
        assert found["seen"] == bool(sight.visible)
        verdicts.append(found["seen"])
    assert set(verdicts) == {True, False}
    opened.page.locator("#ruler").click()
    assert answer.inner_text() == "Click a place to ask when it has sun."
    assert opened.faults == []


def test_a_click_shows_the_horizon_and_what_is_seen_from_there(chromium, written):
    opened = Opened(chromium, written[1])
    opened.page.wait_for_selector(FIRST)
    overlay = "[...document.getElementById('overlay').getContext('2d').getImageData(0, 0, {0}, {1}).data]"
    opened.page.locator("#show").select_option("seen")
    assert opened.page.locator("#legend").inner_text() == "Click the place to look from."
    opened.click(0.46, 0.75)
    opened.page.wait_for_function(
        "() => document.getElementById('horizon').width > 100 && document.getElementById('overlay').width > 300"
    )
    box = opened.page.locator("#overlay").bounding_box()
    size = int(box["width"]), int(box["height"])
    opened.page.wait_for_function(f"() => document.getElementById('overlay').width === {size[0]}")
    layer = np.array(opened.page.evaluate(overlay.format(*size))).reshape(-1, 4)
    colours = {tuple(colour) for colour in layer[layer[:, 3] > 0][:, 3:].tolist()}
    assert len(colours) == 2  # of what is seen, and of what is hidden
    assert opened.page.locator("#legend").inner_text().split() == ["seen", "from", "here", "hidden"]
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
    assert "Höhe der Sonne" in opened.page.locator(".controls").first.inner_text()
    wide = opened.page.evaluate("document.documentElement.scrollWidth")
    assert wide <= 390 and opened.faults == []


def test_a_page_of_a_result_tells_its_numbers_and_lets_them_be_hidden(chromium, written, tmp_path):
    scene, _ = written
    table = at.sun_hours(scene, "face", DAY, place=PLACE, step=60)
    camera = at.Camera((10.0, -90.0, 80.0), (5.0, 5.0, 0.0), (0.0, 0.0, 1.0), vfov=45.0)
    table.page(tmp_path / "sun.html", camera=camera)
    opened = Opened(chromium, tmp_path / "sun.html")
    opened.page.wait_for_selector("#proof[data-wrong='0']")
    found = []
    for place in (0.4, 0.5), (0.3, 0.8), (0.51, 0.36):
        sentence, point, normal, _ = opened.click(*place)
        start = point + scene.origin + normal
        face = int(scene.closest_hit(start[None], -normal[None]).face[0])
        found.append(float(opened.page.locator("#answer").get_attribute("data-value")))
        assert found[-1] == table["sun_hours"][face]
        assert sentence.startswith(f"Hours of direct sun: {found[-1]:g} h.")
    assert len(set(found)) > 1
    painted = opened.page.locator("#picture").screenshot()
    opened.page.locator("#painted").uncheck()
    opened.page.wait_for_timeout(1500)
    assert opened.page.locator("#picture").screenshot() != painted
    assert opened.page.locator("#result").inner_text().startswith("Hours of direct sun (h)")
    assert opened.faults == []


def test_a_notebook_shows_a_page_in_a_frame_that_cannot_reach_it(chromium, written, tmp_path):
    page = written[0].page(place=PLACE, when=DAY)
    (tmp_path / "notebook.html").write_text(f"<!doctype html><body>{page._repr_html_()}", encoding="utf-8")
    opened = Opened(chromium, tmp_path / "notebook.html")
    frame = opened.page.frame_locator("iframe")
    frame.locator("#proof[data-wrong='0']").wait_for()
    assert opened.faults == [] and "allow-same-origin" not in page._repr_html_()
