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
from antumbra.scene.height_tints import height_tints
from antumbra.sun.location import Place, parse_zone
from antumbra.sun.sun_positions import solar_angles, times_of
from antumbra.viewer.page_html import ICON_ADDRESS
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


def test_links_restore_a_view_and_others_are_refused(tmp_path):
    own = {"camera": [1.5, -2e-7, 3, 40, 0.1], "sun": {"date": "2026-06-21", "minute": 930}, "divider": 0.4}
    text = "camera=1.5,-2e-7,3,40,0.1&date=2026-06-21&minute=930&divider=0.4"
    links = ["camera=1,2,3,4,5&minute=60", "camera=1,2,3", "camera=1,2,x,4,5", f"{text}&date=x", "minute=5", ""]
    links += [text.replace("2026-06-21", "today"), text.replace("930", ""), text.replace("0.4", "left")]
    found, *views = asked(tmp_path, {"call": "views", "own": own, "links": [text, *links]})[0]
    assert found == text and views[0] == own
    assert views[1] == {"camera": [1, 2, 3, 4, 5], "sun": {"date": "2026-06-21", "minute": 60}, "divider": 0.4}
    assert views[2:4] == [None] * 2 and views[5:] == [None] * 5


@needs_node
def test_short_memory_is_told_in_words(tmp_path):
    short = [
        "WebAssembly.Memory(): could not allocate memory",
        "Array buffer allocation failed",
        "Out of memory",
        "Invalid array length",
    ]
    (found,) = asked(tmp_path, {"call": "reasons", "messages": [*short, "a worker did not start"]})
    assert all(text.startswith("This device has too little memory") for text in found[:4])
    assert found[4] == "a worker did not start"


@needs_node
def test_the_scale_bar_is_a_round_length_in_metres_or_feet(tmp_path):
    units = {"m": 1.0, "mm": 0.001, "ft": 0.3048, "us-ft": 1200 / 3937, "in": 0.0254}
    abouts = [{"unit": name, "metres": metres} for name, metres in units.items()]
    calls = [{"call": "bar", "about": a, "distance": d} for d in (3.0, 700.0, 41000.0) for a in abouts]
    for call, (text, pixels) in zip(calls, asked(tmp_path, *calls)):
        number, unit = text.split()
        length = float(number) * {"m": 1.0, "km": 1000.0, "ft": 0.3048}[unit]
        shown = pixels * call["distance"] / 800 * call["about"]["metres"]
        assert shown == pytest.approx(length, rel=1e-5) and 26 < pixels <= 130
        assert (unit == "ft") == (call["about"]["unit"] in ("ft", "us-ft", "in"))
        assert number.strip("0.") in ("1", "2", "5")


@needs_node
@pytest.mark.parametrize("state", [0, 1])
def test_a_surface_of_both_states_may_have_other_triangles_but_lies_in_one_plane(tmp_path, state):
    own, cases = 1 << state, {"same": (0.0, 0.0), "near": (-0.009, 0.0), "far": (-0.03, 0.0), "steep": (0.0, 0.2)}
    calls = [
        {"call": "both", "state": state, "faces": [own, 3 - own], "height": h, "tilt": t} for h, t in cases.values()
    ]
    shared, *found = asked(tmp_path, {**calls[2], "faces": [3, 0]}, *calls)
    assert shared[state]["face"] == shared[1 - state]["face"] == 0 and shared[1 - state]["at"]
    assert [each[state]["face"] for each in found] == [0] * 4
    others = [each[1 - state] and each[1 - state]["face"] for each in found]
    assert others == [1, 1, None, None]


@needs_linker
@needs_node
def test_a_page_holds_both_states_and_shares_equal_faces(tmp_path):
    box, tower = box_on_floor(), at.Scene.from_arrays([[[4, 0, 0], [5, 0, 0], [4, 3, 0]]], name="tower")
    after = at.changed_scene(box, tower)
    change, variant = at.scene_change(box, tower, remove=()), at.scene_variant(box, after)
    sizes = []
    for made in (change, variant):
        report = write_page(made.after, tmp_path / "page.html", OPTIONS, before=made.before)
        text = (tmp_path / "page.html").read_text(encoding="utf-8")
        about = json.loads(part_of(text, SCENE))
        asked(tmp_path, {"call": "columns", "data": part_of(text, DATA), "columns": about["columns"]})
        arrays = {
            each["name"]: np.fromfile(tmp_path / each["name"], np.dtype(each["type"])) for each in about["columns"]
        }
        corners = arrays["positions"].reshape(-1, 3)[arrays["indices"]].reshape(-1, 3, 3)
        for state, (scene, end) in enumerate(((made.before, "Before"), (made.after, ""))):
            held = (arrays["states"] >> state & 1).astype(bool)
            own = scene.triangles()
            assert held.sum() == (12, 13)[state]
            assert corners[held].tobytes() == own.vertices[held].tobytes()
            rays = arrays["origins"].reshape(-1, 3) + own.origin, arrays["directions"].reshape(-1, 3)
            assert arrays[f"blocked{end}"].astype(bool).tolist() == scene.occluded(*rays).tolist()
            assert arrays[f"distances{end}"].tobytes() == scene.closest_hit(*rays).t.tobytes()
        assert (arrays["blocked"] != arrays["blockedBefore"]).any()
        whole = b"".join((tmp_path / each["name"]).read_bytes() for each in about["columns"])
        assert about["triangles"] == report.triangles == 13 and about["changes"] and len(whole) > 0
        assert len(set(about["digest"].split(" / "))) == 2
        sizes.append(arrays["positions"].size)
    assert sizes[0] == sizes[1]


@needs_linker
@needs_node
def test_pages_tint_terrain_as_pictures_do(tmp_path):
    heights = np.linspace(0.0, 5.0, 7)[:, None] + np.zeros(9)
    scene = at.from_raster((heights, (2.0, 0.0, 80_000.0, 0.0, -2.0, 450_000.0)))
    write_page(scene, tmp_path / "slope.html", OPTIONS)
    text = (tmp_path / "slope.html").read_text(encoding="utf-8")
    columns = json.loads(part_of(text, SCENE))["columns"]
    asked(tmp_path, {"call": "columns", "data": part_of(text, DATA), "columns": columns})
    kinds = {each["name"]: each["type"] for each in columns}
    colours, rows = (np.fromfile(tmp_path / name, kinds[name]) for name in ("colours", "colourOf"))
    expected = height_tints(scene.data, scene.triangles().vertices.mean(1))
    assert np.array_equal(colours.reshape(-1, 3)[rows], expected) and len(np.unique(expected, axis=0)) > 8


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
    assert rules["img-src"] == "data:"
    before = re.sub(r' src="data:image/webp;base64,[\w+/=]+"', "", text.split("<script")[0], count=1)
    before = before.replace(f' href="{ICON_ADDRESS}"', "", 1)
    assert not re.search(r"\s(src|href|style|on\w+)=", before)
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
    sources = {path: path.read_text(encoding="utf-8") for path in [*PAGE.glob("*.mjs"), *PARTS.parent.glob("*.mjs")]}
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
    "two changes": ("example:hills", "--variant", "example:hills", "--remove", "hills"),
    "variant": ("example:hills", "--variant", "absent.glb"),
    "place of a variant": ("example:hills", "--variant", "example:hills?at=1,2"),
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


@needs_linker
def test_credits_are_those_in_the_file_unless_they_are_given(cli, tmp_path):
    model = {"asset": {"version": "2.0", "copyright": "CC BY 4.0,\n Ada & Co"}, "scene": 0, "scenes": [{"nodes": [0]}]}
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 0, 1]], np.float32).tobytes()
    model |= {
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "buffers": [{"byteLength": 36, "uri": f"data:;base64,{base64.b64encode(corners).decode()}"}],
    }
    Path("model.gltf").write_text(json.dumps(model))
    for words, credits in (((), "CC BY 4.0, Ada &amp; Co"), (("--credits", "Ours"), "Ours")):
        assert cli("page", "model.gltf", "-q", *words).code == 0
        assert part_of(Path("model.html").read_text(encoding="utf-8"), 'p id="credits"') == credits


@needs_linker
def test_a_command_writes_both_states_of_a_scene(cli):
    outcome = cli("page", "example:hills", "--variant", "example:hills?at=0,0,5", "-o", "hills.html")
    assert outcome.code == 0 and "note: variant hills" in outcome.err
    about = json.loads(part_of(Path("hills.html").read_text(encoding="utf-8"), SCENE))
    assert about["changes"]
    assert about["triangles"] == 2 * at.examples.hills().n_triangles
