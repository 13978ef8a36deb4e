"""Pages in headless Chromium, opened from a folder without a network: pictures, suns, answers, and the proof."""

import base64
import io
import json
import re
import zlib
from datetime import datetime
from importlib.util import find_spec
from zoneinfo import ZoneInfo

import numpy as np
import pytest
from PIL import Image

import antumbra as at
from antumbra.city.sensors.sensors import point_sensors
from antumbra.sun.location import Place
from antumbra.sun.sun_positions import days_of, directions_of, solar_angles, times_of
from antumbra.web import page_export
from antumbra.web.page_export import PageOptions, write_page
from web_pages import scene_of_towers, towers

pytestmark = [
    pytest.mark.programs,
    pytest.mark.skipif(find_spec("ziglang") is None, reason="without ziglang, pages are NOT checked"),
]
PLACE = Place(52.0, 4.4, timezone="Europe/Amsterdam")
DAY = "2026-03-21"
FIRST = "body[data-samples]"
PATIENCE = 180_000  # milliseconds, for a loaded machine


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


@pytest.fixture(autouse=True)
def closed_afterwards(chromium):
    """Close the pages of a test, which would go on drawing beside those of the next ones."""
    yield
    for context in chromium.contexts:
        context.close()


class Opened:
    """A page in a browser without a network."""

    def __init__(self, chromium, path, width=800, height=600, link="", before=""):
        context = chromium.new_context(viewport={"width": width, "height": height})
        context.set_offline(True)
        context.set_default_timeout(PATIENCE)
        self.page, self.faults, self.requests = context.new_page(), [], []
        self.page.on("pageerror", lambda fault: self.faults.append(str(fault)))
        self.page.on("console", lambda message: self.faults.append(message.text))
        self.page.on("request", lambda request: self.requests.append(request.url))
        if before:
            self.page.add_init_script(before)
        self.page.goto(path.as_uri() + link)

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
    assert '<img id="still"' in written[1].read_text(encoding="utf-8")
    opened.page.wait_for_selector("#still", state="detached", timeout=PATIENCE)  # once the picture is as fine
    assert int(opened.page.locator("body").get_attribute("data-samples")) >= 16
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
    opened = Opened(chromium, path, 1200, 480)
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
    opened.page.wait_for_selector("#value[data-state='done']", timeout=PATIENCE)
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


def stops_painting(opened):
    """Paint the year, and stop it. Returns whether it was not done before."""
    from playwright.sync_api import TimeoutError

    opened.page.locator("#show").select_option("light")
    opened.page.locator("#show").select_option("year")
    try:
        opened.page.wait_for_selector("#value[data-state='painting']", timeout=20_000)
        opened.page.locator("#paint").click(timeout=20_000)
        opened.page.wait_for_selector("#value[data-state='stopped']", timeout=20_000)
    except TimeoutError:
        return False
    return True


def test_painting_stops_and_starts_anew(chromium, written):
    opened = Opened(chromium, written[1])
    opened.page.wait_for_selector(FIRST)
    button, value = opened.page.locator("#paint"), opened.page.locator("#value")
    assert button.is_hidden() and opened.page.locator("#legend").is_hidden()
    assert any(stops_painting(opened) for _ in range(5))  # painting may be done before the click
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
    opened = Opened(chromium, path, 1200, 480)
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
    assert answer.inner_text() == "Exact shadows, traced in your browser. Click a place to see when it is in the sun."
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


def test_the_day_plays_once_up_to_the_long_shadows_of_the_evening(chromium, written):
    expect = pytest.importorskip("playwright.sync_api").expect
    opened = Opened(chromium, written[1], link="?play")
    opened.page.wait_for_selector(FIRST)
    first = str(json.loads(opened.page.locator("#scene").text_content())["minute"])
    expect(opened.page.locator("#first")).not_to_have_value(first, timeout=PATIENCE)
    assert opened.page.locator("#play").get_attribute("aria-label") == "Stop"
    opened.page.locator("#first").evaluate("slider => { slider.value = '1020' }")  # 17:00
    expect(opened.page.locator("#play")).to_have_attribute("aria-label", "Play the day", timeout=PATIENCE)
    assert 0 < opened.angles()[0] <= 7 and opened.faults == []


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
    for _ in range(PATIENCE // 500):
        opened.page.wait_for_timeout(500)
        if opened.page.locator("#picture").screenshot() != painted:
            break
    else:
        pytest.fail("the picture still shows the numbers")
    assert opened.page.locator("#result").inner_text().startswith("Hours of direct sun (h)")
    assert opened.faults == []


def test_a_notebook_shows_a_page_in_a_frame_that_cannot_reach_it(chromium, written, tmp_path):
    page = written[0].page(place=PLACE, when=DAY)
    (tmp_path / "notebook.html").write_text(f"<!doctype html><body>{page._repr_html_()}", encoding="utf-8")
    opened = Opened(chromium, tmp_path / "notebook.html")
    frame = opened.page.frame_locator("iframe")
    frame.locator("#proof[data-wrong='0']").wait_for()
    assert opened.faults == [] and "allow-same-origin" not in page._repr_html_()


# --- Both states ------------------------------------------------------------------------------------------------------

TOWER_C = at.Scene.from_arrays(towers()["Tower A"] + (22.0, 22.0, 0.0), name="Tower C", up="z")


@pytest.fixture(scope="module")
def changed(tmp_path_factory):
    """(change, path of its page, its camera)."""
    folder = tmp_path_factory.mktemp("changes")
    change = at.scene_change(scene_of_towers(folder), TOWER_C, "Tower_B")
    camera = at.Camera((10.0, -90.0, 80.0), (5.0, 5.0, 0.0), (0.0, 0.0, 1.0), vfov=45.0)
    write_page(change.after, folder / "change.html", options(), camera, before=change.before)
    return change, folder / "change.html", camera


def press(opened, key, times, where="#divider"):
    opened.page.locator(where).focus()
    for _ in range(times):
        opened.page.keyboard.press(key)


def test_what_changes_at_a_point_is_that_of_python(chromium, changed):
    change, path, _ = changed
    opened = Opened(chromium, path, 1200, 480)
    opened.page.wait_for_selector(FIRST)
    opened.page.wait_for_selector("#proof[data-wrong='0']")
    assert "4000 of 4000 rays" in opened.page.locator("#proof").inner_text()
    points, normals, hours, sentences = [], [], [], []
    for key, places in {
        "Home": ((0.4, 0.5), (0.43, 0.47), (0.52, 0.52)),
        "End": ((0.35, 0.75), (0.5, 0.6), (0.6, 0.6)),
    }.items():
        press(opened, key, 1)
        for right, down in places:
            _, point, normal, _ = opened.click(right, down)
            points.append(point)
            normals.append(normal)
            bars = [opened.page.locator(bar) for bar in ("#dayBefore", "#day")]
            hours.append([float(bar.get_attribute("data-hours")) for bar in bars])
            sentences.append(opened.page.locator("#change").inner_text())
    sensors = point_sensors(np.array(points) + change.after.origin, np.array(normals))
    table = change.compare(at.sun_hours, sensors, days=DAY, step=5, place=PLACE)
    before, after = np.array(hours).T
    np.testing.assert_array_equal(np.round(12 * before), np.round(12 * np.asarray(table["sun_hours_before"])))
    np.testing.assert_array_equal(np.round(12 * after), np.round(12 * np.asarray(table["sun_hours"])))
    ends = [" less." if b > a else " more." if b < a else " before and after." for b, a in zip(before, after)]
    assert all(text.endswith(end) for text, end in zip(sentences, ends)) and len(set(ends)) > 1
    assert opened.faults == []


def test_each_side_of_the_divider_shows_and_answers_its_state(chromium, changed):
    _, path, _ = changed
    opened = Opened(chromium, path)
    opened.page.wait_for_selector(FIRST)
    handle, before = opened.page.locator("#divider"), opened.page.locator("#pictureBefore")
    pictures = {}
    for key, share, state, other in (("Home", "0", "before", "after"), ("End", "100", "after", "before")):
        press(opened, key, 1)
        assert handle.get_attribute("aria-valuenow") == share
        pictures[key] = opened.page.locator("#main").screenshot()
        found = set()
        for right in np.linspace(0.35, 0.75, 9):
            for down in (0.15, 0.2, 0.3):
                box = opened.page.locator("#picture").bounding_box()
                opened.page.mouse.click(box["x"] + right * box["width"], box["y"] + down * box["height"])
                opened.page.wait_for_selector("#answer[aria-busy='false']")
                found.add(opened.page.locator("#change").inner_text())
        assert f"This surface does not exist {state} the change." in found, (key, found)
        assert f"This surface does not exist {other} the change." not in found
    assert pictures["Home"] != pictures["End"]
    press(opened, "ArrowLeft", 2)
    press(opened, "PageDown", 1)
    assert before.get_attribute("data-share") == "0.86"
    box = handle.bounding_box()
    opened.page.mouse.move(box["x"] + box["width"] / 2, box["y"] + 50)
    opened.page.mouse.down()
    opened.page.mouse.move(opened.page.locator("#main").bounding_box()["width"] * 0.25, 300)
    opened.page.mouse.up()
    assert float(before.get_attribute("data-share")) == pytest.approx(0.25, abs=0.005)
    assert opened.faults == []


def test_paint_lies_on_the_side_after_while_the_side_before_is_finished(chromium, changed):
    opened = Opened(chromium, changed[1])
    opened.page.wait_for_selector(FIRST)
    press(opened, "End", 1)
    light = opened.page.locator("#main").screenshot()
    painted(opened, "day")
    assert opened.page.locator("#scale-title").inner_text() == "After: Sun hours on 21 March"
    box = opened.page.locator("#picture").bounding_box()
    opened.point(0.4, 0.6)
    assert opened.page.locator("#value").get_attribute("data-hours") == ""  # the state before is shown here
    press(opened, "Home", 1)
    opened.point(0.4, 0.6)
    assert float(opened.page.locator("#value").get_attribute("data-hours")) > 0.0
    assert opened.page.locator("#main").screenshot() != light and box["width"] > 300
    opened.page.wait_for_function("() => document.getElementById('samples').textContent === ''", timeout=PATIENCE)
    assert opened.faults == []


# --- The frame --------------------------------------------------------------------------------------------------------


def test_a_link_restores_the_view(chromium, changed):
    opened = Opened(chromium, changed[1])
    opened.page.wait_for_selector(FIRST)
    press(opened, "ArrowLeft", 3, "#picture")
    press(opened, "PageUp", 1)
    opened.page.locator("#date").fill("2026-07-05")
    opened.page.locator("#first").fill("1080")
    opened.page.locator("#link").click()
    link = opened.page.url.partition("#")[2]
    again = Opened(chromium, changed[1], link=f"#{link}")
    again.page.wait_for_selector(FIRST)
    again.page.locator("#link").click()
    assert again.page.url.partition("#")[2] == link and "date=2026-07-05&minute=1080&divider=0.6" in link
    for part in ("#when", "#north", "#divider"):
        assert again.page.locator(part).get_attribute("style") == opened.page.locator(part).get_attribute("style")
    assert again.angles() == opened.angles()
    again.page.locator("#reset").click()
    again.page.locator("#link").click()
    assert "divider=0.5" in again.page.url and again.page.url.partition("&")[0] != f"#{link}".partition("&")[0]
    wrong = Opened(chromium, changed[1], link="#camera=1,2")
    wrong.page.wait_for_selector("#said:has-text('no view of this page')")
    assert again.faults == wrong.faults == []


def test_the_saved_picture_has_its_caption_and_no_button_makes_a_request(chromium, changed):
    opened = Opened(chromium, changed[1])
    opened.page.wait_for_selector(FIRST)
    opened.page.wait_for_selector("#proof[data-wrong='0']")
    with opened.page.expect_download() as saved:
        opened.page.locator("#save").click()
    assert saved.value.suggested_filename == "Towers 2026-03-21 12-30.png"
    pixels = np.asarray(Image.open(io.BytesIO(saved.value.path().read_bytes())).convert("RGB")).astype(int)
    box = opened.page.locator("#picture").bounding_box()
    shown = box["width"] / pixels.shape[1] * pixels.shape[0]
    assert 70 < shown - box["height"] < 200
    for rows in (pixels[:20], pixels[-60:]):  # title, and credits: dark ink on white paper
        assert (rows[0] == 255).all() and rows.min() < 100
    for name in ("#reset", "#link"):
        opened.page.locator(name).click()
    assert [url for url in opened.requests if not url.startswith("blob:")] == [changed[1].as_uri()]
    assert opened.faults == []


NAMES = """() => [...document.querySelectorAll("button, input, [role]:not([role=status])")]
    .filter((each) => each.checkVisibility({ visibilityProperty: true }))
    .map((each) => each.getAttribute("aria-label") || each.textContent || each.labels?.[0]?.textContent || "")"""


def test_the_tab_key_passes_through_the_page_in_the_order_of_reading(chromium, changed):
    opened = Opened(chromium, changed[1])
    opened.page.wait_for_selector(FIRST)
    visited = []
    for _ in range(8):
        opened.page.keyboard.press("Tab")
        visited.append(opened.page.evaluate("() => document.activeElement.id"))
    assert visited == ["walk", "reset", "link", "save", "picture", "divider", "play", "first"]
    names = opened.page.evaluate(NAMES)
    assert all(name.strip() for name in names), names
    live = opened.page.evaluate("() => [...document.querySelectorAll('[aria-live], [role=status]')].map((e) => e.id)")
    assert set(live) >= {"said", "answer", "change", "proof"}


@pytest.mark.parametrize("width", [390, 1440])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_pages_fit_phones_and_desktops_in_both_schemes(chromium, changed, width, scheme):
    opened = Opened(chromium, changed[1], width, 844)
    opened.page.emulate_media(color_scheme=scheme)
    opened.page.wait_for_selector(FIRST)
    assert opened.page.evaluate("() => document.documentElement.scrollWidth") <= width
    box = opened.page.locator("#picture").bounding_box()
    assert box["height"] > 300 and box["width"] > 0.7 * width
    back = opened.page.evaluate("() => getComputedStyle(document.body).backgroundColor")
    assert (sum(map(int, re.findall(r"\d+", back)[:3])) > 380) == (scheme == "light")


# --- What can go wrong ------------------------------------------------------------------------------------------------


def with_a_bit_altered(path, out, name):
    """Write a page in which one bit of a column differs."""
    text = path.read_text(encoding="utf-8")
    columns = json.loads(re.search(r'id="scene">(.*?)</', text, re.S)[1])["columns"]
    old = re.search(r'id="data">(.*?)</', text, re.S)[1]
    data, at_byte = bytearray(zlib.decompress(base64.b64decode(old))), 0
    for column in columns:
        if column["name"] == name:
            data[at_byte] ^= 1
            break
        at_byte += column["length"] * int(column["type"][1:])
    else:
        raise KeyError(name)
    out.write_text(text.replace(old, base64.b64encode(zlib.compress(bytes(data))).decode()), encoding="utf-8")


@pytest.mark.parametrize("name, wrong", [("blocked", "1"), ("blockedBefore", "1"), ("colours", "0")])
def test_an_altered_bit_is_shown_and_never_hidden(chromium, changed, tmp_path, name, wrong):
    with_a_bit_altered(changed[1], tmp_path / "page.html", name)
    opened = Opened(chromium, tmp_path / "page.html", 390, 844)
    opened.page.wait_for_selector(f"header #proof[role='alert'][data-wrong='{wrong}']")
    text = opened.page.locator("#proof").inner_text()
    assert "WARNING: the scene differs" in text and ("1 of 4000 rays differ" in text) == (wrong == "1")
    opened.page.mouse.wheel(0, 2000)
    opened.page.emulate_media(media="print")
    box = opened.page.locator("#proof").bounding_box()
    assert box["height"] > 20 and 0 <= box["y"] < 200


SHORT = "DecompressionStream = class { constructor() { throw new RangeError('Array buffer allocation failed') } }"
LACKS = {
    "it lacks WebAssembly SIMD": "WebAssembly.validate = () => false",
    "it lacks DecompressionStream": "delete globalThis.DecompressionStream",
    "it lacks WebAssembly.": "delete globalThis.WebAssembly",
    "This device has too little memory for the scene, which has 32 triangles": SHORT,
    "The file is damaged": "globalThis.atob = () => { throw new Error('wrong letters') }",
}


@pytest.mark.parametrize("words, before", LACKS.items(), ids=LACKS)
def test_a_page_that_cannot_open_says_why(chromium, changed, words, before):
    opened = Opened(chromium, changed[1], before=before)
    opened.page.wait_for_selector("#opening[role='alert']")
    assert words in opened.page.locator("#opening").inner_text()
    assert opened.faults == []


# --- Walking and rooms ------------------------------------------------------------------------------------------------


def eye_of(opened):
    """What the scale bar and the north arrow say of the camera, which change as it moves."""
    return [opened.page.locator(each).get_attribute("style") for each in ("#north", "#scale")]


def test_a_visitor_walks_and_returns(chromium, written):
    opened = Opened(chromium, written[1])
    opened.page.wait_for_selector(FIRST)
    above = eye_of(opened)
    opened.page.locator("#walk").click()
    opened.page.wait_for_function(
        f"() => document.querySelector('#scale').getAttribute('style') !== {json.dumps(above[1])}"
    )
    assert "press Escape to stop" in opened.page.locator("#help").inner_text()
    before = opened.page.locator("#picture").screenshot()
    opened.page.keyboard.down("w")
    opened.page.wait_for_timeout(700)
    opened.page.keyboard.up("w")
    opened.page.wait_for_selector("body[data-samples='64']", timeout=PATIENCE)
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
    opened.page.wait_for_selector("body[data-samples='64']", timeout=PATIENCE)
    assert opened.page.locator("input:visible").count() == 0
    script = (
        "(c => c.getContext('2d').getImageData(c.width / 2, c.height / 2, 1, 1).data)(document.querySelector('canvas'))"
    )
    pixel = list(opened.page.evaluate(f"Array.from({script})"))
    assert pixel[0] > 2 * pixel[1] > 0 and opened.faults == []
