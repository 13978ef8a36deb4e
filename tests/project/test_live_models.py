"""The 3D views in the docs: their baked bits are those of the library, and the page shows them."""

import base64
import json
import zlib
from collections import Counter

import numpy as np
import pytest

import antumbra as at
from pages import headless
from repository import ROOT, tool

pytest.importorskip("pvlib", reason="no pvlib: the live models of the docs are NOT tested")
live = tool(ROOT / "scripts" / "live_models.py")
TINY = live.LiveScene("city", 2_000, 20.0, (95.0, 90.0, 100.0), (0.0, 0.0, 0.0), 42.0, live.SPRING, 15, 0.3, 1.0)


@pytest.fixture(scope="module")
def script():
    live.SCENES["tiny"] = TINY
    yield live.script_of("tiny")
    del live.SCENES["tiny"]


def test_split_edges_are_short_and_leave_no_gaps():
    c = np.array([[x, y, z] for x in (0, 1) for y in (0, 3) for z in (0, 7)], np.float64)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    box = np.array([c[list(three)] for a, b, d, e in quads for three in ((a, b, d), (a, d, e))])
    parts, source = live.split_edges(box, 0.9)
    edges = np.roll(parts, -1, axis=1) - parts
    assert np.linalg.norm(edges, axis=-1).max() <= 0.9 and len(parts) > 100
    area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    whole = np.linalg.norm(np.cross(box[:, 1] - box[:, 0], box[:, 2] - box[:, 0]), axis=1)
    np.testing.assert_allclose(np.bincount(source, area), whole, rtol=1e-12)
    pairs = Counter((tuple(face[k]), tuple(face[(k + 1) % 3])) for face in parts.tolist() for k in range(3))
    assert all(pairs[b, a] == n == 1 for (a, b), n in pairs.items()), "the closed box has gaps"


def test_bits_count_the_hours_of_the_job():
    scene, suns = at.procedural("city", triangles=2_000), live.suns_of_day(TINY)
    vertices = live.in_order(live.vertices_of(scene, 20.0))
    light = live.light_of(scene, vertices, suns)
    seen = len(suns.directions) - np.bitwise_count(light.hidden)
    table = at.sun_hours(
        scene, at.point_sensors(vertices.samples, vertices.normals), [TINY.day], place=live.PLACE, step=TINY.step
    )
    np.testing.assert_array_equal(seen * (TINY.step / 60.0), table["sun_hours"])
    assert len(np.unique(seen)) > 10 and 0 < light.sky.mean() < 255


def test_columns_hold_the_model(script):
    model = json.loads(script.partition("] = ")[2].rstrip(";\n"))
    scene, suns = at.procedural("city", triangles=2_000), live.suns_of_day(TINY)
    vertices = live.in_order(live.vertices_of(scene, 20.0))
    data = zlib.decompress(base64.b64decode(model["data"]))
    n, m = model["vertices"], model["faces"]
    assert len(data) == n * (6 + 8 + 3 + 1) + 12 * m and n == len(vertices.at) and m == len(vertices.faces)

    def column(start, rows, width, kind):
        planes = np.frombuffer(data, np.uint8, rows * width, start).reshape(width, rows)
        return np.ascontiguousarray(planes.T).view(kind)

    places = column(0, n, 6, "<u2") / 65535.0 * model["size"] + model["lower"]
    np.testing.assert_allclose(places, vertices.at, atol=max(model["size"]) / 65535.0)
    hidden = column(6 * n, n, 8, "<u8")[:, 0]
    np.testing.assert_array_equal(hidden, live.light_of(scene, vertices, suns).hidden)
    codes = column(14 * n, m, 12, "<u4").astype(np.int64)
    steps = (codes >> 1) ^ -(codes & 1)
    first = np.cumsum(steps[:, 0])
    np.testing.assert_array_equal(np.stack([first, first + steps[:, 1], first + steps[:, 2]], 1), vertices.faces)
    assert len(model["suns"]) == len(model["times"]) <= live.MAX_SUNS and len(model["ramp"]) == 9


# The page


def page_of(chromium, folder, script, width, webgl=True):
    (folder / "tiny.js").write_text(script)
    for name in ("live.js", "antumbra.css"):
        (folder / name).write_text((ROOT / "docs" / "_static" / name).read_text())
    (folder / "page.html").write_text(
        '<!doctype html><meta name="viewport" content="width=device-width"><link rel="stylesheet" href="antumbra.css">'
        '<body><figure class="live" data-model="tiny.js" data-name="tiny"><img alt="A city" src="data:,"></figure>'
        '<script defer src="live.js"></script>'
    )
    page = chromium.new_page(viewport={"width": width, "height": 600})
    if not webgl:
        page.add_init_script("HTMLCanvasElement.prototype.getContext = () => null")
    page.goto((folder / "page.html").as_uri())
    page.wait_for_selector("figure.live[data-state]")
    return page


def drag(canvas):
    """Turn the view by a hundred pixels."""
    box, mouse = canvas.bounding_box(), canvas.page.mouse
    mouse.move(box["x"] + 120, box["y"] + 60)
    mouse.down()
    mouse.move(box["x"] + 220, box["y"] + 90, steps=4)
    mouse.up()


def shot_after(canvas, act, argument):
    """The pixels of the view after an act."""
    act(argument)
    canvas.page.wait_for_timeout(500)
    return canvas.screenshot()


@pytest.mark.programs
def test_the_page_shows_the_model_and_the_sun_moves_its_shadows(script, tmp_path):
    with headless() as chromium:
        for width in (390, 1280):
            page = page_of(chromium, tmp_path, script, width)
            assert page.get_attribute("figure.live", "data-state") == "ready"
            assert page.evaluate("document.documentElement.scrollWidth") <= width
            canvas, slider, box = page.locator("canvas"), page.get_by_role("slider"), page.get_by_role("checkbox")
            acts = [(slider.fill, "10"), (slider.fill, "30"), (box.set_checked, True), (canvas.press, "ArrowLeft")]
            acts.append((drag, canvas))
            shots = [shot_after(canvas, *act) for act in acts]
            assert len(set(shots)) == len(shots), "a control changes nothing"
            assert page.locator("output").inner_text() == "14:22"
            page.close()


@pytest.mark.programs
def test_without_webgl_the_image_stays(script, tmp_path):
    with headless() as chromium:
        page = page_of(chromium, tmp_path, script, 390, webgl=False)
        assert page.get_attribute("figure.live", "data-state") == "image"
        assert page.locator("figure.live img").count() == 1 and page.locator("canvas").count() == 0


@pytest.mark.programs
def test_pages_with_models_stay_below_three_megabytes():
    names = {line.split()[1] for page in (ROOT / "docs").rglob("*.md") for line in page.read_text().splitlines()
             if line.startswith("```{live} ")}  # fmt: skip
    assert names == set(live.SCENES) - {"tiny"}
    assert all(len(live.script_of(name)) < 1.5e6 for name in names), "pages also have pictures"
