"""What the workers of a page find, in node: sensors, hours, sightlines and horizons, beside Python's."""

import json
import re
from datetime import datetime
from types import SimpleNamespace

import numpy as np
import pytest

import antumbra as at
from antumbra.city.sensors.surface_grid import grid_sensors
from antumbra.sun.location import Place
from antumbra.viewer.control_panel import describe_point
from antumbra.viewer.gizmos import Face, Probe, Sight
from antumbra.web.page_export import PageOptions, write_page
from web_pages import DATA, SCENE, asked, needs_linker, needs_node, part_of, scene_of_towers

PLACE = Place(52.0, 4.4, timezone="Europe/Amsterdam")
DAY = "2026-03-21"
BLOCKED, SEEN, BEHIND, OUTSIDE = 2, 1, 0, 3
TOWERS = (((-17, -19, 0), (-7, -9, 30)), ((10, -14, 0), (18, -6, 45)))  # lower and upper corners


def opened(scene, folder):
    """What node needs of the page of a scene."""
    write_page(scene, folder / "page.html", PageOptions("Page", datetime(2026, 3, 21, 12), PLACE))
    text = (folder / "page.html").read_text(encoding="utf-8")
    return {"data": part_of(text, DATA), "about": json.loads(part_of(text, SCENE))}


@pytest.fixture(scope="module")
def towers(tmp_path_factory):
    """(scene, what node needs of its page)."""
    folder = tmp_path_factory.mktemp("towers")
    scene = scene_of_towers(folder)
    return scene, opened(scene, folder)


def soup(n, seed, place=0.0):
    """Triangles of many sizes, one without an area, in any direction, whose coordinates float32 holds."""
    generator = np.random.default_rng(seed)
    corners = generator.normal(size=(n, 1, 3)) * 8 + generator.normal(size=(n, 3, 3)) * generator.exponential(
        2, (n, 1, 1)
    )
    corners[3] = corners[3, :1]
    corners[5, :, 1] = 2.0  # level
    corners[7, :, 0] = -1.0  # upright
    return np.round(256.0 * corners) / 256.0 + place


@needs_node
@pytest.mark.parametrize("up", ["y", "z"])
@pytest.mark.parametrize("place", [0.0, 2.0**17])
def test_sensors_are_those_of_a_grid_in_python(tmp_path, up, place):
    scene = at.Scene.from_arrays(soup(60, 3, place), up=up)
    triangles = scene.triangles()
    corners = triangles.vertices.reshape(-1, 3)
    assert (corners + triangles.origin == scene.data.corners(0.0).reshape(-1, 3)).all()
    mesh = {
        "positions": corners.ravel().tolist(),
        "indices": list(range(len(corners))),
        "origin": triangles.origin.tolist(),
        "up": "xyz".index(up),
    }
    spacings = 0.3, 1.0, 7.0
    found = asked(tmp_path, *({"call": "sensors", "mesh": mesh, "spacing": spacing} for spacing in spacings))
    for spacing, sensors in zip(spacings, found):
        wanted = grid_sensors(scene, spacing)
        points = np.array(sensors["points"]).reshape(-1, 3)
        assert points.tolist() == (wanted.points - triangles.origin).tolist()
        assert np.array(sensors["normals"]).reshape(-1, 3).tolist() == wanted.normals.tolist()
        assert sensors["cells"] == sensors["inParts"] == sorted(set(sensors["cells"]))
        assert (np.bincount(wanted.faces) == 1).sum() > 0  # some have their centre alone
    assert len(found[0]["cells"]) > 2 * len(found[1]["cells"]) > 2 * len(found[2]["cells"])


@needs_linker
@needs_node
@pytest.mark.parametrize(
    "days, step", [([DAY], 5), ([f"2026-{month:02d}-21" for month in range(1, 13)], 60)], ids=["day", "year"]
)
def test_painted_hours_are_those_of_the_command(towers, tmp_path, days, step):
    scene, page = towers
    call = {"call": "paint", "page": page, "most": 3000, "place": PLACE._asdict(), "days": days, "step": step}
    (levels,) = asked(tmp_path, call)
    assert len(levels) > 1 and levels[0]["spacing"] > levels[-1]["spacing"] > 0
    for level in levels:
        table = at.sun_hours(scene, f"grid:{level['spacing']}", ",".join(days), step=step, place=PLACE)
        hours = table["sun_hours"].tolist()
        assert level["hours"] == hours
        assert len(set(hours)) > 5 and 0.0 in hours
        assert level["unknown"] == 0 and level["cells"] >= len(hours)


def wall_and_floor():
    """A wall of two large triangles, of more cells than a part has, and a floor."""
    x = np.array([[-80, 0, 0], [80, 0, 0], [80, 0, 90], [-80, 0, 0], [80, 0, 90], [-80, 0, 90]], np.float64)
    floor = np.array([[-80, -80, 0], [80, -80, 0], [80, 40, 0], [-80, -80, 0], [80, 40, 0], [-80, 40, 0]], np.float64)
    return at.Scene.from_arrays(np.concatenate([x, floor]).reshape(-1, 3, 3), up="z")


@needs_linker
@needs_node
def test_large_faces_are_painted_in_parts_of_their_rows(tmp_path):
    scene = wall_and_floor()
    page = opened(scene, tmp_path)
    call = {"call": "paint", "page": page, "most": 70_000, "place": PLACE._asdict(), "days": [DAY], "step": 60}
    (levels,) = asked(tmp_path, call)
    spacing = levels[-1]["spacing"]
    table = at.sun_hours(scene, f"grid:{spacing}", DAY, place=PLACE)
    assert levels[-1]["hours"] == table["sun_hours"].tolist()
    assert np.bincount(table.sensors.faces).max() > 8192  # so several parts


def rays_over(n=40):
    """The rays of a picture of the towers from above and beside, and their directions (n, n, 3)."""
    rays = {
        "origin": [0.0, -90.0, 80.0],
        "corner": [-0.5, 0.9, -0.2],
        "dx": [1 / n, 0, 0],
        "dy": [0, -0.4 / n, -1.1 / n],
    }
    x, y = np.meshgrid(np.arange(n) + 0.5, np.arange(n) + 0.5)
    ways = np.array(rays["corner"]) + x[..., None] * np.array(rays["dx"]) + y[..., None] * np.array(rays["dy"])
    return rays, ways.reshape(-1, 3).astype(np.float32)


FLOOR = {"face": 0, "point": [2.3, -30.1, 0.0], "normal": [0.0, 0.0, 1.0]}
WALL = {"face": -1, "point": [12.0, -14.0, 20.0], "normal": [0.0, -1.0, 0.0]}


@needs_linker
@needs_node
@pytest.mark.parametrize("spot, height", [(FLOOR, 1.6), (FLOOR, 0), (WALL, 0)], ids=["eye", "floor", "wall"])
def test_what_is_seen_from_a_place_is_what_lines_of_sight_say(towers, tmp_path, spot, height):
    scene, page = towers
    rays, ways = rays_over()
    question = {
        "rays": rays,
        "width": 40,
        "first": 0,
        "rows": 40,
        "spacings": [],
        "eye": {"spot": spot, "height": height},
    }
    code = {"call": "ask", "page": page, "name": "surfaces", "question": question}
    (found,) = asked(tmp_path, code)
    seen = np.array(list(found["maps"][0].values()))
    hits = scene.closest_hit(np.float32(rays["origin"]), ways)
    hit = hits.face >= 0
    assert ((seen >= 0) == hit).all() and (~hit).any()
    corners = scene.data.corners(0.0)[hits.face[hit]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals *= -np.sign((normals * ways[hit]).sum(1))[:, None]
    targets = np.float64(rays["origin"]) + hits.t[hit, None] * ways[hit].astype(np.float64)
    eye = np.array(spot["point"]) + [0.0, 0.0, height]
    normal = None if height else np.array(spot["normal"])
    sight = at.line_of_sight(scene, eye, targets, normals=normal, target_normals=normals)
    assert (seen[hit] == np.where(sight.visible, SEEN, BLOCKED)).all()
    assert sight.visible.any() and not sight.visible.all()


@needs_linker
@needs_node
def test_sightlines_between_places_are_those_of_python(towers, tmp_path):
    scene, page = towers
    spots = [FLOOR, WALL, {**FLOOR, "point": [30.0, 25.0, 0.0]}, {**FLOOR, "point": [-12.0, 12.0, 0.0]}]
    pairs = [
        (a, b, height) for a in spots for b in spots if a is not b for height in (0, 1.6) if a is not WALL or not height
    ]
    calls = [
        {"call": "ask", "page": page, "name": "sightline", "question": {"eye": {"spot": a, "height": h}, "spot": b}}
        for a, b, h in pairs
    ]
    verdicts = set()
    for (a, b, h), found in zip(pairs, asked(tmp_path, *calls)):
        eye = np.array(a["point"]) + [0.0, 0.0, h]
        normal = None if h else a["normal"]
        sight = at.line_of_sight(scene, eye, b["point"], normals=normal, target_normals=b["normal"])
        assert found["seen"] == bool(sight.visible)
        if found["blocker"] >= 0:
            assert found["blocker"] == sight.face
        verdicts.add((found["seen"], found["blocker"] >= 0))
    assert {(True, False), (False, True)} <= verdicts


@needs_linker
@needs_node
@pytest.mark.parametrize("north", [0.0, 30.0])
def test_the_horizon_is_that_of_the_towers(towers, tmp_path, north):
    size = 120
    question = {"spot": FLOOR, "size": size, "north": north}
    (states,) = asked(tmp_path, {"call": "ask", "page": towers[1], "name": "horizon", "question": question})
    x, y = np.meshgrid(np.arange(size), np.arange(size))
    right, down = (2 * (x.ravel() + 0.5) / size - 1), (2 * (y.ravel() + 0.5) / size - 1)
    altitude = np.radians(90 * (1 - np.hypot(right, down)))
    bearing = np.arctan2(right, -down) + np.radians(north)
    way = np.stack([np.sin(bearing) * np.cos(altitude), np.cos(bearing) * np.cos(altitude), np.sin(altitude)], 1)
    blocked = np.zeros(size * size, bool)
    for lower, upper in TOWERS:
        with np.errstate(divide="ignore"):
            ends = (np.array([lower, upper])[:, None] - np.array(FLOOR["point"])) / way
        blocked |= np.maximum(ends.min(0).max(1), 0.0) < ends.max(0).min(1)
    wanted = np.where(altitude <= 0, OUTSIDE, np.where(blocked, BLOCKED, SEEN))
    assert states == wanted.tolist()
    assert (wanted == BLOCKED).sum() > 300


@needs_node
def test_answers_are_sentences_in_both_languages(tmp_path):
    call = {
        "call": "sentence", "place": PLACE._asdict(), "date": DAY, "altitude": 30.0, "names": ["Tower A", "Tower B"],
        "blocked": [(6.5, 8.0), (14 + 1 / 6, 16 + 5 / 12)], "now": SEEN, "nowBlocker": -1, "sky": 0.372,
    }  # fmt: skip
    shade = {"now": BLOCKED, "nowBlocker": 1}
    calls = [
        {**call, "language": "en"},
        {**call, "language": "de", **shade},
        {**call, "language": "en", "names": [], "blocked": [(0, 24)], **shade},
        {**call, "language": "de", "blocked": [], "altitude": -2.0},
        {**call, "language": "de", "names": [], "now": BEHIND},
    ]
    assert asked(tmp_path, *calls) == [
        "In the sun. 8 h 35 min of sun on 21 March, blocked 06:50 to 08:00 by Tower A and 14:10 to 16:25 by Tower B; "
        "sees 37 % of the sky.",
        "Im Schatten von Tower B. 8 h 35 min Sonne am 21. März, verschattet von 06:50 bis 08:00 Uhr durch Tower A und "
        "von 14:10 bis 16:25 Uhr durch Tower B; 37 % des Himmels sichtbar.",
        "In the shade. No sun on 21 March, blocked 06:50 to 18:50; sees 37 % of the sky.",
        "Die Sonne steht unter dem Horizont. 12 h Sonne am 21. März; 37 % des Himmels sichtbar.",
        "Von der Sonne abgewandt. 8 h 35 min Sonne am 21. März, verschattet von 06:50 bis 08:00 Uhr und von "
        "14:10 bis 16:25 Uhr; 37 % des Himmels sichtbar.",
    ]


@needs_node
def test_a_click_has_the_same_answer_on_a_page_and_in_the_viewer(tmp_path):
    tower, own = (Face(k, name, np.zeros((3, 3))) for k, name in enumerate(("Tower A", "")))
    other = own._replace(index=2)
    cases = [(SEEN, None, 1.0), (BLOCKED, tower, 0.0), (BLOCKED, other, 0.0), (BEHIND, own, 0.0), (None, None, 0.0)]
    call = {"call": "sentence", "place": None, "language": "en", "names": ["Tower A"], "sky": 0.372}
    model = SimpleNamespace(text_of=str)
    calls, shown = [], []
    for state, blocker, share in cases:
        light = {
            "altitude": None if state is None else 30.0,
            "now": state,
            "nowBlocker": blocker.index if blocker else -1,
        }
        calls.append({**call, **light})
        sun = None if state is None else Sight("sun", share, 16, np.zeros(3), blocker, None)
        probe = Probe(np.zeros(3), np.array([0.0, 0.0, 1.0]), own, [] if sun is None else [sun], 0.372, sun)
        shown.append(re.findall(r"<div[^>]*>(.*?)<br>", describe_point(probe, model))[0])
    assert asked(tmp_path, *calls) == shown and len(set(shown)) == len(cases)
    assert shown[0] == "In the sun. Sees 37 % of the sky." and shown[1].startswith("In the shade of Tower A. ")


@needs_node
def test_distances_are_sentences_in_both_languages(tmp_path):
    first, second = ({"face": 0, "point": point, "normal": [0, 0, 1]} for point in ([0, 0, 0], [0, 3000, 4000]))
    level = {"face": 0, "point": [12.5, 0, 0], "normal": [0, 0, 1]}
    about = {"up": "z", "metres": 1.0}
    seen, hidden = {"seen": True, "blocker": -1}, {"seen": False, "blocker": 3}
    call = {"call": "measure", "first": first, "about": about, "eye": 0, "sight": seen, "name": "Tower B"}
    calls = [
        {**call, "second": second, "language": "en"},
        {**call, "second": level, "language": "en", "eye": 1.6, "sight": hidden},
        {**call, "second": second, "language": "de", "about": {"up": "z", "metres": 0.01}},
        {**call, "second": level, "language": "de", "eye": 1.6, "sight": hidden},
        {**call, "second": level, "language": "en", "sight": hidden, "name": ""},
    ]
    assert [re.sub("\xa0", " ", text) for text in asked(tmp_path, *calls)] == [
        "5.00 km apart: 3.00 km horizontally; the second place is 4.00 km higher. "
        "From the first place, the second is in sight.",
        "12.50 m apart: 12.50 m horizontally; both are at the same height. "
        "From 1.60 m above the first place, the second is hidden by Tower B.",
        "50,00 m Abstand, waagerecht 30,00 m; die zweite Stelle liegt 40,00 m höher. "
        "Von der ersten Stelle aus ist die zweite zu sehen.",
        "12,50 m Abstand, waagerecht 12,50 m; beide liegen gleich hoch. "
        "Aus 1,60 m Höhe über der ersten Stelle ist die zweite durch Tower B verdeckt.",
        "12.50 m apart: 12.50 m horizontally; both are at the same height. From the first place, the second is hidden.",
    ]
