"""Sheets as they are handed in: pages within their paper, no text over another, all parts there, units of the scene."""

import hashlib
import re
from datetime import date
from itertools import combinations
from zoneinfo import ZoneInfo

import numpy as np
import pytest

import antumbra as at
from antumbra.city.tables.map_legend import scale_of
from antumbra.city.tables.result_table import Column, Table
from pdf_pages import pdf_text
from sheet_cases import hills, reports, roofs, shadows, site, windows
from sheet_pages import boxes, map_of, pages_of, table_map, table_pages_of, texts, words

pytest.importorskip("matplotlib")

NAMES = "verdicts", "losses in feet", "viewshed", "raster in feet", "faces", "skyline"
SHADOWS = "shadow in feet", "hours of shadow"
BLOCK = dict(
    project="River Street 5, demolition of the old warehouse and a new block of four storeys with 24 dwellings",
    author="A. Planner, Bureau for Daylight, Delft", date="2026-11-28", licence="CC BY 4.0",
)  # fmt: skip


@pytest.fixture(scope="module")
def cases():
    return reports()


@pytest.fixture(scope="module")
def shadow_cases():
    pytest.importorskip("shapely", reason="shadows need antumbra[gis]: their sheets are NOT checked")
    return shadows()


def check_pages(figures, paper):
    """Every text lies within the margins of its page, and overlaps no other one."""
    width, height = paper
    for number, figure in enumerate(figures, 1):
        assert figure.get_size_inches() * 25.4 == pytest.approx([width, height])
        found = boxes(figure)
        assert len(found) > 5
        for text, left, bottom, right, top in found:
            assert left > 5 and bottom > 5 and right < width - 5 and top < height - 5, (number, text)
        plain = [box for box in found if not re.fullmatch(r"\d{1,2}", box[0])]  # hours along the paths of the sun cross
        for a, b in combinations(plain, 2):
            over = min(a[3], b[3]) - max(a[1], b[1]), min(a[4], b[4]) - max(a[2], b[2])
            assert min(over) < 0.35, (number, a[0], b[0])  # descenders may touch ascenders


@pytest.mark.parametrize("orientation", ["portrait", "landscape"])
@pytest.mark.parametrize("paper, size", [("a4", (210, 297)), ("a3", (297, 420)), ("letter", (215.9, 279.4))])
@pytest.mark.parametrize("name", NAMES)
def test_texts_are_on_the_paper_and_apart(cases, name, paper, size, orientation):
    fields = {**BLOCK, "paper": paper, "orientation": orientation}
    figures = pages_of(cases[name](at.Sheet(**fields)), **fields)
    check_pages(figures, size if orientation == "portrait" else size[::-1])


@pytest.mark.parametrize("name", SHADOWS)
@pytest.mark.parametrize("orientation", ["portrait", "landscape"])
def test_texts_of_shadows_are_on_the_paper_and_apart(shadow_cases, name, orientation):
    figures = pages_of(shadow_cases[name](at.Sheet()), **BLOCK, orientation=orientation)
    check_pages(figures, (210, 297) if orientation == "portrait" else (297, 210))


@pytest.mark.parametrize("name", NAMES)
def test_every_page_has_the_title_block(cases, name):
    figures = pages_of(cases[name](at.Sheet()), title="Sunlight on River Street", **BLOCK)
    assert len(figures) >= 4
    for number, figure in enumerate(figures, 1):
        found = words(figure)
        assert "Sunlight on River Street" in found and BLOCK["project"] in found and BLOCK["author"] in found
        assert f"{number} of {len(figures)}" in found and "2026-11-28" in found and at.__version__ in found
        assert name == "skyline" or re.search(r"1:[0-9,]+", found)


def test_the_pages_of_windows_say_all_that_a_reader_asks(tmp_path):
    data = tmp_path / "windows.csv"
    data.write_text("x,y,z\n")
    page, table, method, suns, sources = table_pages_of(
        windows(), "en17037_passes", sources=[data], licence="CC BY 4.0", title="Windows"
    )
    assert "fails: 25.0 % of the sensors" in words(page) and "passes: 75.0 % of the sensors" in words(page)
    assert {"A1.1", "A2.3", "B2.3"} <= set(texts(page)) and "the lowest first, then outwards" in words(page)
    found = texts(table)
    assert {"id", "dwelling", "x (m)", "sun hours (h)", "energy (kWh/m²)", "sun hours loss (h)"} <= set(found)
    assert found.count("fails") == 3 and found.count("passes") == 9 and found.count("B1.2") == 2
    asked = words(method)
    for text in ("EN 17037:2018, level minimum", "At least 1.5 hours.", "The sky is clear.", "24 above the horizon",
                 "30 minutes", "12 (points)", "Solar Position Algorithm", "52.00000", "Europe/Amsterdam",
                 "sun on 21 March 2026", "sun on 21 June", "the time zone is unusual",
                 "1:600, of the coordinates"):  # fmt: skip
        assert text in asked, text
    times = at.times_of([date(2026, 3, 21)], ZoneInfo("Europe/Amsterdam"), 30)
    expected = at.suns_of(at.Place(52.0, 4.36), times, "z")
    listed = texts(suns)
    assert "2026-03-21 07:15" in listed and f"{expected.azimuth[0]:.2f}" in listed and "Positions of the sun" in listed
    said = words(sources)
    assert "windows.csv: 6 bytes, SHA-256" in said and "CC BY 4.0" in said and "River Street" in said
    assert hashlib.sha256(b"x,y,z\n").hexdigest() in re.sub(r"\s", "", said)


# --- Units ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("unit, square, bar", [("m", "m²", " m"), ("us-ft", "us-ft²", " us-ft"), ("ft", "ft²", " ft")])
def test_legends_and_tables_are_in_the_unit_of_the_scene(unit, square, bar):
    scene = site(unit)
    cells = at.raster_sensors(scene, 6.0 / scene.unit.metres)
    made = Table(cells, {"lit": Column(np.arange(len(cells)) % 2 == 0, "", "lit")}, {}, scene)
    found = texts(table_map(made, "lit"))
    area = 0.5 * len(cells) * cells.raster.spacing**2
    assert f"no: 50.0 % of the cells, {area:,.0f} {square}" in " ".join(found)
    assert any(re.fullmatch(rf"[0-9]+{bar}", text) for text in found)
    assert any("1 in = " in text for text in found) == (unit != "m")
    assert f"x ({unit})" in texts(table_pages_of(windows(unit), "sun_hours")[1])


def test_areas_of_shadows_are_in_the_unit_of_the_scene(shadow_cases):
    shadow = shadow_cases["shadow in feet"](at.Sheet())
    page, table = (words(each) for each in pages_of(shadow)[:2])
    assert "ft²" in page and "m²" not in page and "area (ft²)" in table and "height of -3.28084 ft" in page


# --- Colours ----------------------------------------------------------------------------------------------------------


def lightness(colours):
    """CIE L* of sRGB colours."""
    linear = np.where(colours <= 0.04045 * 255, colours / 255 / 12.92, ((colours / 255 + 0.055) / 1.055) ** 2.4)
    y = linear @ [0.2126, 0.7152, 0.0722]
    return np.where(y > 216 / 24389, 116 * np.cbrt(y) - 16, y * 24389 / 27)


def test_verdicts_and_losses_can_be_told_apart_without_colours():
    made = windows()
    fails, passes = scale_of(made, "en17037_passes").classes
    assert (fails.name, passes.name) == ("fails", "passes")
    assert np.ptp(lightness(np.array([fails.colour, passes.colour], float))) > 30
    seen = scale_of(hills(), "seen")
    assert [each.name for each in seen.classes] == ["not visible", "visible"]
    assert np.ptp(lightness(np.array([each.colour for each in seen.classes], float))) > 25
    loss = scale_of(made, "sun_hours_loss")
    losses = lightness(loss.colours(np.linspace(0, loss.high, 20)).astype(float))
    assert (np.diff(losses) < 0).all() and np.ptp(losses) > 50


def test_losses_are_centred_on_zero():
    made = windows()
    made.columns["x_loss"] = Column(np.linspace(-1.0, 4.0, 12), "h", "lost")
    scale = scale_of(made, "x_loss")
    assert scale.diverging and scale.low == -1.0 and scale.high == 4.0 and 0.0 in [each.value for each in scale.stops()]
    zero, gain, loss, most = scale.colours(np.array([0.0, -1.0, 1.0, 4.0])).astype(int)
    assert np.ptp(zero) <= 5 and gain[2] > gain[0] and loss[0] > loss[2]  # neutral; bluish; reddish
    assert (most != loss).any() and scale.colours(np.array([-4.0]))[0].tolist() != gain.tolist()
    found = texts(table_map(made, "x_loss"))
    assert "positive: lost; negative: gained" in found and "gained" in found
    made.columns["calm_loss"] = Column(np.zeros(12), "h", "lost")
    assert scale_of(made, "calm_loss").ticks() == [0.0]


def test_values_before_and_after_have_one_scale():
    made = windows()
    made.columns |= {"q": Column(np.arange(12.0), "h", "after"), "q_before": Column(2 * np.arange(12.0), "h", "before")}
    assert scale_of(made, "q").high == scale_of(made, "q_before").high == 22.0


def test_a_viewshed_has_two_classes_over_a_hillshade():
    made = hills()
    figure = table_map(made, "seen")
    image = np.asarray(figure.axes[0].images[0].get_array())[..., :3].astype(float)
    grey, teal = (np.array(each.colour, float) for each in scale_of(made, "seen").classes)
    ratio = image[..., None, :] / np.stack([grey, teal])
    shades = np.ptp(ratio, axis=-1)
    assert (shades.min(-1) < 0.03).all()  # each pixel is a shade of one of both
    assert len(np.unique(image.reshape(-1, 3), axis=0)) > 20  # a hillshade, not two flat colours
    found = words(figure)
    assert (
        "not visible: " in found and "visible: " in found and "observer" in found and "What the observer sees" in found
    )
    assert "85500, 449600" in words(table_pages_of(made, "seen")[2])
    several = at.viewshed(made.scene, made.sensors, [[85500.0, 449600, 60], [85200.0, 449700, 60]]).table
    assert {"0", "1"} <= set(texts(table_map(several, "seen"))) and not scale_of(several, "seen").classes


# --- Errors -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "fields, message",
    [
        ({"scale": "1:100"}, r"scale: 1:100 does not fit on A4; the extent of 51\.\d+ x 2\.\d+ m needs 1:300, or A3"),
        (
            {"extent": [500, 0, 600, 90]},
            r"extent: nothing of the result lies in 500,0,600,90; it lies in -51\.67,-17\.85,",
        ),
        ({"labels": "idd"}, "labels: there is no column 'idd'; did you mean 'id'?"),
        (
            {"project": "W" * 290, "author": "W" * 9},
            "the project of 290 characters does not fit on the sheet; shorten it",
        ),
        ({"sources": ["missing.csv"]}, r"sources: missing\.csv cannot be read"),
    ],
)
def test_what_does_not_fit_is_refused_and_leaves_no_file(tmp_path, fields, message):
    with pytest.raises(at.InputError, match=message) as error:
        windows().save_map(tmp_path / "a.pdf", sheet=at.Sheet(**fields))
    assert "\n" not in str(error.value) and not list(tmp_path.iterdir())


def test_an_empty_result_is_refused(tmp_path):
    made = Table(at.point_sensors(np.empty((0, 3))), {"a": Column(np.empty(0), "", "a")}, {}, site())
    with pytest.raises(at.InputError, match="the table has no rows; there is nothing to draw on a map"):
        made.save_map(tmp_path / "a.pdf")
    assert not list(tmp_path.iterdir())


def test_a_skyline_has_no_scale(cases):
    with pytest.raises(at.InputError, match="a diagram without a scale; leave scale and extent out"):
        map_of(cases["skyline"](at.Sheet()), scale=500)


def test_titles_with_dollars_stay_text(tmp_path):
    figure = table_map(windows(), "sun_hours", title="Costs $5 and $6_a", project="a $x$ b")
    assert "Costs $5 and $6_a" in texts(figure) and "a $x$ b" in texts(figure)


def test_pages_can_be_chosen():
    assert len(table_pages_of(windows(), "sun_hours", pages=["map"])) == 1
    method, suns, sources = table_pages_of(windows(), "sun_hours", pages=["sources", "method"])
    assert "Method" in texts(method) and "Positions of the sun" in texts(suns) and "Data sources" in texts(sources)


def test_labels_are_those_of_a_column_or_none():
    assert not {"A1.1", "B2.3"} & set(texts(table_map(windows(), "sun_hours", labels="none")))
    assert "0.5" in texts(table_map(windows(), "sun_hours", labels="sun_hours"))


def test_a_raster_is_summarised_and_areas_are_listed():
    table = words(table_pages_of(roofs(), "sun_hours")[1])
    assert "garden" in table and "75.0 %" in table and "greatest" in table and "400 rows" in table


def test_text_of_pdf_files_can_be_selected(tmp_path):
    windows().save_map(tmp_path / "a.pdf", "sun_hours", sheet=at.Sheet(title="Sunlight", project="River Street 5"))
    lines = re.findall(r"BT\n(.*?)\nET", pdf_text(tmp_path / "a.pdf"), re.DOTALL)
    strings = ["".join(re.findall(r"\(((?:[^()\\]|\\.)*)\)", line)) for line in lines]
    strings = [text.replace("\0", "") for text in strings]  # codes of two bytes
    assert {"Sunlight", "River Street 5", "A1.1", "B2.3"} <= set(strings)
    assert b"/ToUnicode" in (tmp_path / "a.pdf").read_bytes()
    assert len(re.findall(rb"/Type /Page\b(?!s)", (tmp_path / "a.pdf").read_bytes())) == 5


@pytest.mark.parametrize("kind", ["raster", "face", "points"])
def test_gains_are_hatched_or_have_another_mark(kind):
    scene = site()
    sensors = {"raster": lambda: at.raster_sensors(scene, 6.0), "face": lambda: at.face_sensors(scene)}.get(kind)
    sensors = windows().sensors if sensors is None else sensors()
    losses = np.linspace(-1.0, 2.0, len(sensors))
    made = Table(
        sensors, {"q_loss": Column(losses, "h", "lost"), "all_loss": Column(losses + 1.0, "h", "lost")}, {}, scene
    )
    some, none = (texts(table_map(made, name)) for name in ("q_loss", "all_loss"))
    assert "gained" in some and "gained" not in none
    hatches = [each.get_hatch() for each in table_map(made, "q_loss").axes[0].collections]
    assert ("...." in hatches) == (kind != "points")


def test_letters_without_a_font_are_a_note(tmp_path):
    letter = chr(0x12000)  # cuneiform
    with pytest.warns(UserWarning, match=rf"a\.svg: no font has the letters {letter}, which are boxes") as told:
        windows().save_map(tmp_path / "a.svg", "sun_hours", sheet=at.Sheet(project=f"A {letter} B"))
    assert len(told) == 1 and letter in (tmp_path / "a.svg").read_text(encoding="utf-8")
