"""Each surface of a city is read once, although files hold it as several geometries, in parts, or on several lines."""

import json

import numpy as np
import pytest

import antumbra as at
from city_files import CUBE, CUBE_FACES, building, city, instances, polygons, put, solid, surfaces

pytest.importorskip("mapbox_earcut")

TYPES = {
    "Solid": solid("2"),
    "CompositeSolid": {"type": "CompositeSolid", "lod": "2", "boundaries": [[polygons()]]},
    "MultiSolid": {"type": "MultiSolid", "lod": "2", "boundaries": [[polygons()]]},
    "CompositeSurface": {**surfaces("2"), "type": "CompositeSurface"},
    "MultiSurface": surfaces("2"),
}
QUARTER = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])


def beside(offset, faces=CUBE_FACES):
    """Polygons of the cube number `offset` of a row of cubes."""
    return polygons([[8 * offset + i for i in face] for face in faces])


def row(n, gap=1.0):
    return np.concatenate([CUBE + (k * gap, 0, 0) for k in range(n)])


def feature(objects, vertices=CUBE):
    return {"type": "CityJSONFeature", "id": "a", "CityObjects": objects, "vertices": vertices.tolist()}


def area(scene):
    a, b, c = scene.triangles().vertices.transpose(1, 0, 2).astype(float)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2.0


def loaded(folder, objects, vertices=CUBE, **options):
    """The scene, and its notes without file names."""
    scene = at.load(put(folder, city(objects, vertices)), **options)
    return scene, [note.partition(": ")[2] for note in scene.notes]


@pytest.mark.parametrize("turn", [np.eye(3, dtype=int), QUARTER], ids=["upright", "turned"])
@pytest.mark.parametrize("first", range(2))
@pytest.mark.parametrize("worse", list(TYPES)[1:])
def test_one_geometry_per_object_and_level(tmp_path, worse, first, turn):
    """The type that encloses a volume best is read, wherever it is in the file."""
    better = list(TYPES)[list(TYPES).index(worse) - 1]
    order = [worse, better] if first else [better, worse]
    scene, notes = loaded(tmp_path, {"a": building(*(TYPES[name] for name in order))}, CUBE @ turn.T)
    assert area(scene) == 6.0 and {s.geometry for s in scene.city.surfaces} == {order.index(better)}
    assert notes == ["geometries left out that repeat another one of their object (a Solid is preferred): 1"]


def test_roof_area_and_energy_count_once(tmp_path):
    pytest.importorskip("pvlib")
    kinds = {"surfaces": [{"type": "GroundSurface"}, {"type": "RoofSurface"}, {"type": "WallSurface"}]}
    values = [0, 1, 2, 2, 2, 2]
    both = solid("2", semantics={**kinds, "values": [values]}), surfaces("2", semantics={**kinds, "values": values})
    vertices = CUBE * (10.0, 10.0, 6.0) + (84000.0, 446000.0, 0.0)
    cases = {
        "alone": {"a": building(both[0])},
        "both": {"a": building(*both)},
        "part": {
            "a": building(both[0], children=["b"]),
            "b": building(both[1], kind="BuildingPart", parents=["a"]),
        },
    }
    sums = {}
    for name, objects in cases.items():
        scene, _ = loaded(tmp_path, objects, vertices)
        table = at.sun_hours(
            scene, "face", "2026-06-21", step=120, energy=True, surfaces=["RoofSurface"], per="building"
        )
        sums[name] = table.sensors.areas.sum(), table["direct_kwh"].sum()
    assert sums["alone"] == sums["both"] == sums["part"] and sums["alone"][0] == 100.0 and sums["alone"][1] > 0.0


def test_geometries_at_other_places_are_all_read(tmp_path):
    """Two solids side by side, or a footprint beyond the walls, are not the same shape."""
    both = solid("2"), {"type": "MultiSurface", "lod": "2", "boundaries": beside(1)}
    scene, notes = loaded(tmp_path, {"a": building(*both)}, row(2))
    assert area(scene) == 12.0 and notes == []
    twice = instances()
    first = twice["CityObjects"]["tree"]["geometry"][0]
    for anchor, expected in ((1, 2), (0, 1)):
        twice["CityObjects"]["tree"]["geometry"] = [first, {**first, "boundaries": [anchor]}]
        assert at.load(put(tmp_path, twice)).n_triangles == 12 * expected


def test_the_note_says_how_to_choose(tmp_path):
    objects = {"a": building(solid("1"), surfaces("1"), surfaces("2", polygons(CUBE_FACES[:3])), surfaces("2"))}
    scene, notes = loaded(tmp_path, objects)
    assert "choose another level of 1, 2 with lod" in notes[0] and area(scene) == 3.0
    assert loaded(tmp_path, objects, lod="1")[1] == notes


@pytest.mark.parametrize("listing", ["children", "parents"])
@pytest.mark.parametrize("lod", [None, "2"])
def test_parts_that_repeat_a_building_are_read_instead_of_it(tmp_path, lod, listing):
    """The building is the row of its parts. Files link them by children, by parents, or by both."""
    whole = {"type": "MultiSurface", "lod": "2", "boundaries": [*beside(0), *beside(1)]}
    link = {"children": ["b", "c"]} if listing == "children" else {}
    back = {"parents": ["a"]} if listing == "parents" else {}
    objects = {"a": building(whole, **link)}
    for k, name in enumerate("bc"):
        part = {"type": "Solid", "lod": "2", "boundaries": [beside(k)]}
        objects[name] = building(part, kind="BuildingPart", **back)
    scene, notes = loaded(tmp_path, objects, row(2), lod=lod)
    assert [each.name for each in scene.objects] == ["b", "c"] and area(scene) == 12.0
    assert notes == ["geometries left out, of objects whose parts repeat them: 1"]


def test_a_building_without_geometry_in_its_parts_keeps_its_own(tmp_path):
    objects = {"a": building(solid("2"), children=["b"]), "b": building(kind="BuildingPart", parents=["a"])}
    scene, notes = loaded(tmp_path, objects)
    assert [each.name for each in scene.objects] == ["a"] and notes == []


def test_a_building_beside_its_annexe_is_read_with_it(tmp_path):
    annexe = {"type": "Solid", "lod": "2", "boundaries": [beside(1)]}
    objects = {"a": building(solid("2"), children=["b"]), "b": building(annexe, kind="BuildingPart", parents=["a"])}
    scene, notes = loaded(tmp_path, objects, row(2))
    assert [each.name for each in scene.objects] == ["a", "b"]
    assert notes == ["objects with a geometry beside those of their parts; all are read, so areas may count twice: 1"]


def test_a_building_on_two_lines_is_read_once(tmp_path):
    head = {**city(), "CityObjects": {}}
    far = feature({"a": building(solid())}, CUBE + 10)
    for other, n in ((feature({"a": building(solid())}), 12), (far, 24)):
        lines = "\n".join(json.dumps(each) for each in (head, feature({"a": building(solid())}), other))
        assert at.load(put(tmp_path, lines, "a.city.jsonl")).n_triangles == n
    # the same id at another place is another building


@pytest.mark.parametrize("boundaries", [[[["x", 1, 2]]], [[[0, 1, 2**70]]], [[[0, 1, 99]]], 7, "roof"])
def test_damaged_geometries_are_still_reported(tmp_path, boundaries):
    broken = {"type": "MultiSurface", "lod": "2", "boundaries": boundaries}
    with pytest.raises(at.InputError, match=r"export .* again"):
        at.load(put(tmp_path, city({"a": building(solid("2"), broken)})))


def test_repeated_polygons_of_an_object_are_noted(tmp_path):
    again = surfaces("2", polygons([*CUBE_FACES, CUBE_FACES[1][2:] + CUBE_FACES[1][:2]]))
    scene, notes = loaded(tmp_path, {"a": building(again)})
    assert notes == ["2 triangles repeat others; areas and energy count them again"] and area(scene) == 7.0
    walls = {"a": building(solid()), "b": building({**solid(), "boundaries": [beside(1)]})}
    assert loaded(tmp_path, walls, row(2))[1] == []  # the common wall faces both ways
