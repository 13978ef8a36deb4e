"""Attributes written to a copy of a CityJSON file."""

import json

import numpy as np
import pytest

import antumbra as at
from city_files import building, city, everything, polygons, put, sequence, solid, surfaces

SEMANTICS = {
    "surfaces": [{"type": "GroundSurface"}, {"type": "RoofSurface", "slope": 3}, {"type": "WallSurface", "parent": 1}],
    "values": [[0, 1, 2, 2, 2, 2]],
}
pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")


def written(tmp_path, document, values, **options):
    source = put(tmp_path, document)
    at.write_attributes(source, tmp_path / "out.city.json", values, **options)
    text = (tmp_path / "out.city.json").read_text(encoding="utf-8")
    return json.loads(text)


def stripped(node, names):
    """JSON without the attributes."""
    if isinstance(node, dict):
        return {k: stripped(v, names) for k, v in node.items() if k not in names}
    return [stripped(v, names) for v in node] if isinstance(node, list) else node


def test_means_are_weighted_by_area(tmp_path):
    box = building(solid(semantics=SEMANTICS), attributes={"näme": "Tür", "height": 3.125e-7})
    document = city({"a": box}, extra={"kept": [1, None, 1e22, "ü"]})
    document["vertices"] = [[x, y, 3 * z] for x, y, z in document["vertices"]]
    faces = at.load(put(tmp_path, document)).city
    values = faces.surface_of_face * 10.0  # 0 ground, 10 roof, 20 walls
    values[-4:] = [20, 40, np.nan, np.inf]  # two walls: one has two values, one has none
    found = written(tmp_path, document, {"sun_hours": values})
    thing = found["CityObjects"]["a"]
    ground, roof, wall = thing["geometry"][0]["semantics"]["surfaces"]
    assert ground == {"type": "GroundSurface", "sun_hours": 0.0}
    assert roof == {"type": "RoofSurface", "slope": 3, "sun_hours": 10.0}
    assert wall["sun_hours"] == pytest.approx((20 * 6 + 20 * 1.5 + 40 * 1.5) / 9) and wall["parent"] == 1
    mean = (0 * 1 + 10 * 1 + 20 * 6 + 20 * 1.5 + 40 * 1.5) / 11
    assert thing["attributes"]["sun_hours"] == pytest.approx(mean) and thing["attributes"]["näme"] == "Tür"
    assert stripped(found, ["sun_hours"]) == json.loads(json.dumps(document))


def test_semantics_are_made(tmp_path):
    half = {"surfaces": [{"type": "RoofSurface"}], "values": [None, 0]}
    objects = {
        "bare": building(solid()),
        "half": building(surfaces("1", semantics=half)),
        "null": building(solid(semantics=None)),
        "shell": building(solid(semantics={"surfaces": [{"type": "RoofSurface"}], "values": [None]})),
        "pond": building(surfaces(boundaries=polygons([[4, 5, 6, 7]])), kind="WaterBody"),
        "bed": building(surfaces(boundaries=polygons([[4, 5, 6, 7]])), kind="PlantCover"),
    }
    document = city(objects)
    n = at.load(put(tmp_path, document)).n_triangles
    found = written(tmp_path, document, {"h": np.arange(n)})["CityObjects"]
    kinds = ["GroundSurface", "RoofSurface"] + ["WallSurface"] * 4
    bare = found["bare"]["geometry"][0]["semantics"]
    assert bare["surfaces"] == [{"type": k, "h": 2 * i + 0.5} for i, k in enumerate(kinds)]
    assert bare["values"] == found["null"]["geometry"][0]["semantics"]["values"] == [[0, 1, 2, 3, 4, 5]]
    mixed = found["half"]["geometry"][0]["semantics"]
    assert mixed["values"] == [1, 0, 2, 3, 4, 5]
    assert [s["type"] for s in mixed["surfaces"]] == ["RoofSurface", "GroundSurface"] + ["WallSurface"] * 4
    assert mixed["surfaces"][0]["h"] == 14.5
    assert found["shell"]["geometry"][0]["semantics"]["values"] == [[1, 2, 3, 4, 5, 6]]
    assert found["pond"]["geometry"][0]["semantics"]["surfaces"][0]["type"] == "WaterSurface"
    assert found["bed"]["geometry"][0]["semantics"]["surfaces"][0]["type"] == "+Surface"
    for name, thing in found.items():
        assert stripped(thing, ["h", "attributes", "semantics"]) == stripped(objects[name], ["semantics"])


@pytest.mark.parametrize("suffix", ["json", "jsonl"])
def test_a_round_trip_reads_the_same_scene(tmp_path, suffix):
    document = sequence(everything()) if suffix == "jsonl" else everything()
    source, target = put(tmp_path, document, f"a.{suffix}"), tmp_path / f"b.{suffix}"
    before = at.load(source)
    values = np.random.default_rng(0).uniform(size=before.n_triangles)
    at.write_attributes(source, target, {"x": values, "y": np.where(values > 2, 1.0, np.nan)})
    after = at.load(target)
    np.testing.assert_array_equal(before.triangles().vertices, after.triangles().vertices)
    np.testing.assert_array_equal(before.city.surface_of_face, after.city.surface_of_face)
    assert [s.path for s in before.city.surfaces] == [s.path for s in after.city.surfaces]
    assert '"y"' not in target.read_text()  # no face has a value
    lines = [json.loads(line) for line in target.read_text().splitlines()]
    things = {name: thing for line in lines for name, thing in line["CityObjects"].items()}
    areas = np.cross(*(before.triangles().vertices[:, k] - before.triangles().vertices[:, 0] for k in (1, 2)))
    weights = np.linalg.norm(areas.astype(float), axis=1)
    for k, name in enumerate(before.city.objects):
        mine = before.city.object_of_face == k
        assert things[name]["attributes"]["x"] == pytest.approx(
            np.average(values[mine], weights=weights[mine]), rel=1e-5
        )
    assert "semantics" not in things["tree"]["geometry"][0]  # an instance shares its template with others
    assert lines[0]["geometry-templates"] == everything()["geometry-templates"]


def test_what_is_written_is_read_per_face(tmp_path):
    document = city({"a": building(solid(semantics=SEMANTICS)), "b": building(solid())})
    source = put(tmp_path, document)
    before = at.load(source).city
    of_surface = np.random.default_rng(0).random(len(before.surfaces))
    at.write_attributes(source, tmp_path / "out.city.json", {"hours": of_surface[before.surface_of_face]})
    after, faces = at.load(tmp_path / "out.city.json").city, np.arange(24)
    np.testing.assert_allclose(after.surface_attribute("hours", faces), of_surface[before.surface_of_face], rtol=1e-12)
    means = after.object_attribute("hours", faces)
    assert len(set(means.tolist())) == 2 and (means[:12] == means[0]).all()


def test_null_and_empty_members(tmp_path):
    objects = {"a": building(solid(), attributes=None), "b": building(solid(semantics=[]))}
    values = np.repeat([1.0, np.nan], 12)
    found = written(tmp_path, city(objects), {"x": values})["CityObjects"]
    assert found["a"]["attributes"] == {"x": 1.0} and "attributes" not in found["b"]
    assert len(found["b"]["geometry"][0]["semantics"]["surfaces"]) == 6


def test_only_the_chosen_level_of_detail_changes(tmp_path):
    document = city({"a": building(solid("1"), solid("2"))})
    found = written(tmp_path, document, {"x": np.ones(12)}, lod="1")["CityObjects"]["a"]["geometry"]
    assert found[1] == solid("2") and found[0]["semantics"]["surfaces"][0]["x"] == 1.0


@pytest.mark.parametrize(
    "values, target, word",
    [
        ({"x": np.ones(11)}, "b.json", "one for each of 12 faces"),
        ({"x": ["a"] * 12}, "b.json", "must be numbers"),
        ({"type": np.ones(12)}, "b.json", "choose another name"),
        ({"x": np.ones(12)}, "b.glb", "unknown suffix '.glb'"),
        ({"x": np.ones(12)}, "none/b.json", "does not exist"),
    ],
)
def test_bad_input_leaves_no_file(tmp_path, values, target, word):
    with pytest.raises(at.InputError, match=word):
        at.write_attributes(put(tmp_path, city()), tmp_path / target, values)
    assert [p.name for p in tmp_path.iterdir()] == ["a.city.json"]


def test_other_sources_are_refused(tmp_path):
    (tmp_path / "a.obj").write_text("v 0 0 0\n")
    with pytest.raises(at.InputError, match="attributes are written to CityJSON only"):
        at.write_attributes(tmp_path / "a.obj", tmp_path / "b.json", {})
