"""Pages of scenes: what the file holds, its suns and times beside Python's, and what cannot become a page."""

import base64
import hashlib
import html
import json
import re
from datetime import UTC, date, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

import antumbra as at
from antumbra.base.errors import InputError
from antumbra.picture.heat_maps import RAMP, linear_scale
from antumbra.sun.location import Place, parse_zone
from antumbra.sun.sun_positions import solar_angles, times_of
from antumbra.web import page_export
from antumbra.web.page_export import PageOptions, write_page
from antumbra.web.page_source import PAGE, page_program
from pages import box_on_floor
from web_pages import CODE, DATA, PARTS, SCENE, asked, needs_linker, needs_node, part_of

OPTIONS = PageOptions("Box & <floor>", datetime(2026, 6, 21, 15, 30), Place(52.0, 4.4, timezone="Europe/Amsterdam"))
PLACES = [
    Place(52.0, 4.4, 3.0, timezone="Europe/Amsterdam"),
    Place(-33.9, 151.2, 40.0, timezone="Australia/Sydney"),
    Place(0.0, -78.5, 2850.0, timezone="-05:00"),
    Place(78.2, 15.6, timezone="Arctic/Longyearbyen"),
    Place(27.7, 85.3, 1400.0, timezone="Asia/Kathmandu"),
    Place(-80.0, -170.0),
]


def digest_of(text):
    """SHA-256 in base64."""
    return base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """(scene, text of its page, report)."""
    path, scene = tmp_path_factory.mktemp("page") / "box.html", box_on_floor()
    report = write_page(scene, path, OPTIONS)
    return scene, path.read_text(encoding="utf-8"), report


@needs_node
def test_suns_are_those_of_python_to_a_hundredth_of_a_degree(tmp_path):
    generator = np.random.default_rng(4)
    first, last = (int(datetime(year, 1, 1, tzinfo=UTC).timestamp()) for year in (1901, 2199))
    instants = [np.sort(generator.integers(first, last, 2000)) for _ in PLACES]
    calls = [{"call": "angles", "place": p._asdict(), "seconds": s.tolist()} for p, s in zip(PLACES, instants)]
    for place, seconds, found in zip(PLACES, instants, asked(tmp_path, *calls)):
        altitude, azimuth = np.radians(solar_angles(place, seconds.astype("datetime64[s]")))
        got_altitude, got_azimuth = np.radians(np.array(found)).T
        apart = 2 * np.arcsin(
            np.sqrt(
                np.sin((altitude - got_altitude) / 2) ** 2
                + np.cos(altitude) * np.cos(got_altitude) * np.sin((azimuth - got_azimuth) / 2) ** 2
            )
        )
        assert np.degrees(apart).max() < 0.01
        assert (altitude > 0).any() and (altitude < 0).any()


@needs_node
def test_days_begin_and_end_as_in_python(tmp_path):
    days = [date(2026, 3, 29), date(2026, 10, 25), date(2026, 4, 5), date(2026, 10, 4), date(2026, 6, 21)]
    places = [place for place in PLACES if place.timezone]
    texts = [str(day) for day in days]
    calls = [{"call": "midnights", "place": place._asdict(), "days": texts} for place in places]
    lengths = set()
    for place, found in zip(places, asked(tmp_path, *calls)):
        for day, (start, end) in zip(days, found):
            times = times_of([day], parse_zone(place.timezone), 60)
            hours = times.hours.sum()
            assert start + 1800 == times.middle[0].astype(np.int64)
            assert (end - start) / 3600 == hours
            lengths.add(hours)
    assert lengths == {23.0, 24.0, 25.0}


@needs_node
def test_clocks_without_a_zone_follow_the_longitude(tmp_path):
    (found,) = asked(tmp_path, {"call": "offsets", "place": PLACES[-1]._asdict(), "seconds": [0, 1_790_000_000]})
    assert found == [-11 * 3600] * 2


@needs_node
def test_each_language_has_all_words(tmp_path):
    (words,) = asked(tmp_path, {"call": "words"})
    assert sorted(words) == sorted(page_export.LANGUAGES)
    gaps = {
        language: {name: set(re.findall(r"\{\w+\}", text)) for name, text in table.items()}
        for language, table in words.items()
    }
    assert all(table == gaps["en"] for table in gaps.values())
    sources = " ".join(path.read_text(encoding="utf-8") for path in PAGE.glob("*.mjs") if path.stem != "words")
    assert [name for name in words["en"] if f"words.{name}" not in sources] == []


@needs_node
def test_colours_and_ticks_are_those_of_our_pictures(tmp_path):
    tops = [0.4, 1.0, 8.0, 9.3, 12.25, 16.75, 4380.0]
    values = np.random.default_rng(2).uniform(0.0, 20.0, 300)
    call = {"call": "scale", "palette": RAMP.tolist(), "values": values.tolist()}
    for top, found in zip(tops, asked(tmp_path, *({**call, "most": top} for top in tops))):
        scale = linear_scale(np.array([top]))
        assert found["ticks"] == pytest.approx(scale.ticks.tolist(), rel=1e-12)
        assert found["colours"] == scale.colours(values, np.ones(300, bool)).tolist()


@needs_linker
@needs_node
def test_a_page_holds_the_bits_of_the_scene(page, tmp_path):
    scene, text, report = page
    about = json.loads(part_of(text, SCENE))
    asked(tmp_path, {"call": "columns", "data": part_of(text, DATA), "columns": about["columns"]})
    kinds = {each["name"]: np.dtype(each["type"]) for each in about["columns"]}
    arrays = {name: np.fromfile(tmp_path / name, kind) for name, kind in kinds.items()}
    triangles = scene.triangles()
    corners = arrays["positions"].reshape(-1, 3)[arrays["indices"]].reshape(-1, 3, 3)
    assert corners.tobytes() == triangles.vertices.tobytes()
    assert arrays["colours"].reshape(-1, 3)[arrays["colourOf"]].tobytes() == triangles.colour.tobytes()
    rays = arrays["origins"].reshape(-1, 3) + triangles.origin, arrays["directions"].reshape(-1, 3)
    hits = scene.closest_hit(*rays)
    assert arrays["distances"].tobytes() == hits.t.tobytes()
    assert triangles.face_id[arrays["faces"]][hits.face >= 0].tolist() == hits.face[hits.face >= 0].tolist()
    assert arrays["blocked"].astype(bool).tolist() == scene.occluded(*rays).tolist()
    assert 0 < arrays["blocked"].sum() < page_export.PROOF_RAYS
    assert report.digest.startswith(about["digest"]) and about["triangles"] == report.triangles == 12


@needs_linker
def test_a_page_allows_no_request(page):
    scene, text, report = page
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', text)[1]
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
    assert rules["default-src"] == rules["base-uri"] == rules["form-action"] == "'none'"
    assert rules["worker-src"] == "blob:"
    assert rules["script-src"] == f"'sha256-{digest_of(part_of(text, CODE))}' 'wasm-unsafe-eval'"
    assert rules["style-src"] == f"'sha256-{digest_of(part_of(text, 'style'))}'"
    assert not re.search(r"\s(src|href|style|on\w+)=", text.split("<script")[0])
    columns = page_export.Columns()
    page_export._add_geometry(columns, scene.triangles(), scene.data.object_of_face)
    assert report.size == len(text.encode()) <= 1e6 + len(columns.packed())


@needs_linker
def test_texts_of_a_page_are_escaped(page):
    _, text, _ = page
    assert html.escape(OPTIONS.title) in text and OPTIONS.title not in text
    assert text.count("</script>") == 3


def test_the_program_of_a_page_has_each_module_once():
    program = page_program()
    names = re.findall(r"^const (\w+) = \(\(\) => \{$", program, re.M)
    assert len(names) == len(set(names)) and {"module_scene", "page_tracer", "page_main"} <= set(names)
    assert names[-1] == "page_main" and len(names) >= len(list(PAGE.glob("*.mjs")))
    assert "import.meta" not in program and "</" not in program
    assert not re.search(r"^(import|export) ", program, re.M)


def test_each_export_of_the_page_is_imported():
    sources = {path: path.read_text(encoding="utf-8") for path in [*PAGE.glob("*.mjs"), PARTS]}
    exports = [
        (path, name) for path in sources for name in re.findall(r"^export \w+(?: function)? (\w+)", sources[path], re.M)
    ]
    unused = [
        name
        for path, name in exports
        if not any(re.search(rf"\b{name}\b", text) for other, text in sources.items() if other != path)
    ]
    assert unused == [] and len(exports) > 30


def test_modules_that_import_each_other_are_refused(tmp_path):
    (tmp_path / "a.mjs").write_text('import { b } from "./b.mjs";\nexport const a = 1;\n')
    (tmp_path / "b.mjs").write_text('import { a } from "./a.mjs";\nexport const b = 1;\n')
    with pytest.raises(RuntimeError, match=r"a\.mjs imports itself through b\.mjs"):
        page_program(tmp_path / "a.mjs")


def test_what_pages_cannot_show_is_refused(tmp_path, monkeypatch):
    path = tmp_path / "page.html"
    leaves = box_on_floor()
    leaves.set_transmittance({"*": 0.5})
    with pytest.raises(InputError, match="lets light pass"):
        write_page(leaves, path, OPTIONS)
    with pytest.raises(InputError, match="pages have perspective views"):
        camera = at.Camera((0, 9, 0.1), (0, 0, 0), projection="orthographic", extent=5.0)
        write_page(box_on_floor(), path, OPTIONS, camera)
    with pytest.raises(InputError, match="choose en or de"):
        write_page(box_on_floor(), path, OPTIONS._replace(language="fr"))
    monkeypatch.setattr(page_export, "MOST_TRIANGLES", 11)
    with pytest.raises(InputError, match="has 12 triangles, and a page holds 11"):
        write_page(box_on_floor(), path, OPTIONS)
    assert list(tmp_path.iterdir()) == []


WRONG = {
    "day": ("example:hills", "--date", "2026-02-30"),
    "zone": ("procedural:atrium?triangles=100", "--timezone", "UTC"),
    "suffix": ("example:hills", "-o", "page.pdf"),
    "offset": ("example:hills", "--date", "2026-06-21T12:00+02:00"),
    "half a place": ("example:hills", "--latitude", "5"),
    "view": ("example:hills", "--camera", "top"),
}


@pytest.mark.parametrize("words", WRONG.values(), ids=WRONG)
def test_a_mistake_leaves_no_file(cli, tmp_path, words):
    cli("page", *words, "-q").refused()
    assert list(tmp_path.iterdir()) == []


@needs_linker
def test_a_command_writes_a_page(cli):
    day = str(date(2026, 6, 21) + timedelta(days=1))
    outcome = cli("page", "example:hills", "--date", day, "--language", "de", "--title", "Hügel")
    assert outcome.code == 0 and "hills.html" in outcome.out
    about = json.loads(part_of(Path("hills.html").read_text(encoding="utf-8"), SCENE))
    assert (about["date"], about["minute"]) == (day, 14 * 60)
    assert about["place"]["latitude"] == pytest.approx(52, abs=2)
