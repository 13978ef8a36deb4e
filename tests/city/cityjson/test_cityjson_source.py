"""CityJSON: objects, levels of detail, semantics, templates, and coordinates of a map."""

import gc
import json

import numpy as np
import pytest

import antumbra as at
from antumbra.city.cityjson.cityjson_source import colours_of
from city_files import (
    CUBE,
    CUBE_FACES,
    TRANSLATION,
    building,
    city,
    everything,
    instances,
    polygons,
    put,
    sequence,
    solid,
    surfaces,
    transform,
)
from scenes import scene_path


def corners(scene):
    """(n, 3, 3) float64, world."""
    return scene.triangles().vertices.astype(np.float64) + scene.origin


def vector_areas(scene):
    a, b, c = corners(scene).transpose(1, 0, 2)
    return np.cross(b - a, c - a) / 2.0


def volume(triangles):
    """Of a closed mesh, positive if its normals point outwards."""
    return np.einsum("ij,ij->i", triangles[:, 0], np.cross(triangles[:, 1], triangles[:, 2])).sum() / 6.0


def refused(path, *words, **options):
    with pytest.raises(at.InputError) as caught:
        at.load(path, **options)
    message = str(caught.value)
    assert "\n" not in message and all(word in message for word in words), message


@pytest.mark.parametrize("version", ["1.0", "1.1", "2.0", "2.0.1"])
@pytest.mark.parametrize("name", ["a.json", "a.city.json", "A.CITY.JSON"])
def test_a_cube(tmp_path, version, name):
    scene = at.load(put(tmp_path, city(version=version), name))
    assert scene.n_triangles == 12 and scene.up == "z" and scene.name.lower().startswith("a")
    np.testing.assert_array_equal(scene.bounds, [[0, 0, 0], [1, 1, 1]])
    assert volume(corners(scene)) == pytest.approx(1.0)
    assert scene.city.crs == "EPSG:7415" and scene.city.lods == ["1"] and scene.city.types == ["Building"]
    assert at.load(put(tmp_path, city(version=version), name), up="y").up == "y"


@pytest.mark.parametrize(
    "kind, depth",
    [("MultiSurface", 0), ("CompositeSurface", 0), ("Solid", 1), ("MultiSolid", 2), ("CompositeSolid", 2)],
)
def test_all_geometries_with_surfaces(tmp_path, kind, depth):
    boundaries = polygons()
    for _ in range(depth):
        boundaries = [boundaries]
    scene = at.load(put(tmp_path, city({"a": building({"type": kind, "lod": "1", "boundaries": boundaries})})))
    assert volume(corners(scene)) == pytest.approx(1.0)
    assert [s.path for s in scene.city.surfaces] == [(*[0] * depth, k) for k in range(6)]
    assert [s.type for s in scene.city.surfaces] == [None] * 6


def test_points_and_lines_are_no_surfaces(tmp_path):
    thing = building({"type": "MultiPoint", "lod": "9", "boundaries": [0, 1]}, solid("1"))
    assert at.load(put(tmp_path, city({"a": thing, "b": {"type": "CityObjectGroup"}}))).n_triangles == 12


def test_map_coordinates_are_exact(tmp_path):
    rng = np.random.default_rng(0)
    vertices = rng.integers(0, 400_000, (60, 3))
    faces = np.arange(60).reshape(-1, 3).tolist()
    document = city({"a": building(surfaces(boundaries=polygons(faces)))}, vertices, transform=transform())
    scene = at.load(put(tmp_path, document))
    world = vertices[np.array(faces)] * 0.001 + np.array(TRANSLATION)
    assert (scene.origin > [84000, 447000, -10]).all() and scene.origin.dtype == np.float64
    np.testing.assert_array_equal(scene.triangles().vertices, (world - scene.origin).astype(np.float32))


def test_faces_know_objects_and_surfaces(tmp_path):
    semantics = {
        "surfaces": [{"type": "GroundSurface"}, {"type": "RoofSurface"}, {"type": "Window"}, {"type": "WallSurface"}],
        "values": [[0, 1, 3, 3, 3, None]],
    }
    objects = {"b": building(solid("2", semantics=semantics)), "nothing": building(), "a": building(solid("1"))}
    scene = at.load(put(tmp_path, city(objects)))
    model = scene.city
    assert model.objects == ["b", "a"] == [m.name for m in scene.meshes]
    assert scene.objects == [("b", 0, 0, "Building", ""), ("a", 1, 0, "Building", "")]
    assert (scene.object_of_face == model.object_of_face).all()
    assert model.surface_types([[2, -1], [11, 23]]).tolist() == [["RoofSurface", ""], ["", ""]]
    assert [m.triangles for m in scene.meshes] == [12, 12]
    np.testing.assert_array_equal(model.object_of_face, np.repeat([0, 1], 12))
    np.testing.assert_array_equal(model.surface_of_face[:12], [0, 0, 1, 1, 2, 2, 2, 2, 2, 2, 3, 3])
    assert len(set(model.surface_of_face[12:].tolist())) == 6
    kinds = [(s.type, s.semantic, s.path) for s in model.surfaces[:4]]
    assert kinds == [
        ("GroundSurface", 0, (0, 0)), ("RoofSurface", 1, (0, 1)), ("WallSurface", 3, (0, 2)), (None, None, (0, 5)),
    ]  # fmt: skip
    assert model.object_of_face.dtype == model.surface_of_face.dtype == np.int32
    areas = vector_areas(scene)
    np.testing.assert_allclose(areas[model.surface_of_face == 1].sum(axis=0), [0, 0, 1], atol=1e-7)
    assert len(np.unique(scene.colours, axis=0)) == 3  # a wall without semantics has the colour of the building


def test_colours():
    kinds, owners = ["RoofSurface", None, None, None, "+New"], ["Building", "BuildingPart", "Building", "+X", "+X"]
    colours = colours_of(kinds, owners)
    assert colours.dtype == np.float32 and colours.shape == (5, 3) and (colours > 0.05).all() and (colours < 1).all()
    assert (colours[1] == colours[2]).all() and (colours[3] == colours[4]).all() and (colours[0] != colours[1]).any()


def test_levels_of_detail(tmp_path):
    small = [[0, 3, 2, 1]]
    objects = {
        "a": building(surfaces("0", polygons(small)), surfaces(1.3, polygons(CUBE_FACES[:2])), solid("2.2")),
        "b": building(surfaces(1, polygons(small))),
    }
    path = put(tmp_path, city(objects))
    assert [m.triangles for m in at.load(path).meshes] == [12, 2]
    assert [(m.name, m.triangles) for m in at.load(path, lod="1.3").meshes] == [("a", 4)]
    assert [(m.name, m.triangles) for m in at.load(path, lod="1.0").meshes] == [("b", 2)]
    assert at.load(path, lod="0").city.surfaces[0].geometry == 0
    assert at.load(path).city.lods == ["0", "1", "1.3", "2.2"]
    refused(path, "a.city.json: no geometry has lod '3'; there are 0, 1, 1.3, 2.2", lod="3")
    glb = tmp_path / "a.glb"
    refused(glb, "a.glb: lod is for CityJSON files", lod="1")


def test_parts_stand_for_the_whole(tmp_path):
    def names(*geometry, kind="BuildingPart"):
        objects = {"house": building(*geometry, children=["child"]), "child": building(solid("2.2"), kind=kind)}
        return [m.name for m in at.load(put(tmp_path, city(objects))).meshes]

    assert names(surfaces("0")) == ["child"]
    assert names(surfaces("0"), solid("2.2")) == ["child"]
    assert names(solid("1"), kind="BuildingInstallation") == ["house", "child"]


def test_parts_name_their_building(tmp_path):
    objects = {
        "district": {"type": "CityObjectGroup", "children": ["house"]},
        "house": building(children=["part"], parents=["district"]),
        "part": building(solid(), kind="BuildingPart", parents=["house"], children=["balcony"]),
        "balcony": building(solid(), kind="BuildingInstallation", parents=["part", "gone"]),
        "shed": building(solid(), parents=["nowhere"]),
        "loop": building(solid(), parents=["loop"]),
    }
    head = {**city(), "CityObjects": {}}
    lines = json.dumps(head) + "\n" + json.dumps(feature(objects))
    for scene in at.load(put(tmp_path, city(objects))), at.load(put(tmp_path, lines, "a.city.jsonl")):
        parents = {each.name: (each.type, each.parent) for each in scene.objects}
        assert parents == {
            "part": ("BuildingPart", "house"),
            "balcony": ("BuildingInstallation", "house"),
            "shed": ("Building", ""),
            "loop": ("Building", ""),
        }


def test_children_count_where_parents_are_missing(tmp_path):
    objects = {
        "group": {"type": "CityObjectGroup", "children": ["house"], "members": ["house"]},
        "house": building(children=["part"]),
        "part": building(solid(), kind="BuildingPart", children=["house"]),
    }
    (only,) = at.load(put(tmp_path, city(objects))).objects
    assert (only.name, only.parent) == ("part", "house")


def attributed():
    """A house whose part has faces, and a shed; with attributes of surfaces and objects."""
    kinds = [
        {"type": "RoofSurface", "slope": 12.5, "tiles": True},
        {"type": "WallSurface", "slope": None, "children": [2]},
        {"type": "Window", "parent": 1, "slope": 3, "glass": "double"},
    ]
    part = solid("2", semantics={"surfaces": kinds, "values": [[None, 0, 1, 2, 1, 1]]})
    return {
        "house": building(children=["part"], attributes={"year": 1900, "name": "Tür", "use": "home", "codes": [1, 2]}),
        "part": building(part, kind="BuildingPart", parents=["house"], attributes={"use": 7, "year": None}),
        "shed": building(solid("2"), attributes={"use": "tools"}),
    }


@pytest.mark.parametrize("version", ["1.0", "1.1", "2.0"])
def test_attributes_of_faces(tmp_path, version):
    for document, name in (
        (city(attributed(), version=version), "a.city.json"),
        (sequence(city(attributed(), version=version)), "a.city.jsonl"),
    ):
        model = at.load(put(tmp_path, document, name)).city
        faces = [[2, 4], [6, 0], [12, -1]]
        assert model.surface_types(faces).tolist() == [["RoofSurface", "WallSurface"], ["Window", ""], ["", ""]]
        slopes = model.surface_attribute("slope", faces)
        assert slopes.dtype == np.float64 and slopes.shape == (3, 2)
        np.testing.assert_array_equal(slopes, [[12.5, np.nan], [3.0, np.nan], [np.nan, np.nan]])
        np.testing.assert_array_equal(model.surface_attribute("tiles", [2, 4]), [1.0, np.nan])
        assert model.surface_attribute("glass", faces).tolist() == [["", ""], ["double", ""], ["", ""]]
        assert [s.parent for s in model.surfaces if s.type == "Window"] == [1]
        assert model.surface_attribute_names == ["glass", "slope", "tiles"]
        if name.endswith("l"):  # features of other lines are out of reach
            assert model.object_attribute_names == ["use"]
            continue
        assert model.objects == ["part", "shed"] and model.parents == ["house", ""]
        assert model.object_attribute_names == ["codes", "name", "use", "year"]
        assert model.object_attribute("use", [0, 12, -1]).tolist() == ["7", "tools", ""]
        assert model.object_attribute("codes", [0, 12]).tolist() == ["[1, 2]", ""]
        assert model.object_attribute("name", 0) == "Tür"
        np.testing.assert_array_equal(model.object_attribute("year", [0, 12]), [1900.0, np.nan])


def test_one_feature_holds_a_building_and_its_parts(tmp_path):
    head = {**city(), "CityObjects": {}, "vertices": []}
    text = json.dumps(head) + "\n" + json.dumps(feature(attributed())) + "\n"
    one, other = at.load(put(tmp_path, text, "b.city.jsonl")).city, at.load(put(tmp_path, city(attributed()))).city
    assert one.attributes == other.attributes and one.surfaces == other.surfaces and one.parents == other.parents


def test_attributes_of_templates(tmp_path):
    document = instances()
    semantics = {"surfaces": [{"type": "+Crown", "leaves": 0.8}], "values": [[0] * 6]}
    document["geometry-templates"]["templates"][1]["semantics"] = semantics
    document["CityObjects"]["tree"]["attributes"] = {"species": "oak"}
    model = at.load(put(tmp_path, document)).city
    assert (model.surface_attribute("leaves", np.arange(12)) == 0.8).all()
    assert (model.object_attribute("species", np.arange(12)) == "oak").all()
    assert (model.surface_types(np.arange(12)) == "+Crown").all()


@pytest.mark.parametrize(
    "call, words",
    [
        (
            lambda c: c.surface_attribute("colour", 0),
            "no surface of the city has the attribute 'colour'; there are glass",
        ),
        (lambda c: c.object_attribute("slope", 0), "no object of the city has the attribute 'slope'; there are codes"),
        (lambda c: c.object_attribute("use", 24), "faces must be whole numbers from -1 to 23"),
        (lambda c: c.object_attribute("use", 0.5), "faces must be whole numbers"),
        (lambda c: c.object_attribute(3, 0), "name"),
    ],
)
def test_bad_attributes(tmp_path, call, words):
    with pytest.raises(at.InputError, match=words):
        call(at.load(put(tmp_path, city(attributed()))).city)


def test_no_attributes(tmp_path):
    model = at.load(put(tmp_path, city())).city
    assert model.object_attribute_names == model.surface_attribute_names == []
    with pytest.raises(at.InputError, match="there are no attributes"):
        model.surface_attribute("slope", 0)


def feature(objects):
    return {"type": "CityJSONFeature", "CityObjects": objects, "vertices": CUBE.tolist()}


def test_templates(tmp_path):
    turn = np.array([[0, -2, 0, 1], [2, 0, 0, 0], [0, 0, 2, 0], [0, 0, 0, 1.0]])
    for matrix, turned in ((np.eye(4), False), (turn, False), (np.diag([1.0, 1, -1, 1]), True)):
        scene = at.load(put(tmp_path, instances(matrix)))
        world = CUBE @ matrix[:3, :3].T + matrix[:3, 3] + [10, 20, 30]
        np.testing.assert_allclose(scene.bounds, [world.min(axis=0), world.max(axis=0)])
        assert volume(corners(scene)) == pytest.approx(abs(np.linalg.det(matrix)), rel=1e-5), turned
        assert scene.city.lods == ["2"]
        assert scene.city.types == ["SolitaryVegetationObject"]


@pytest.mark.parametrize(
    "text, crs",
    [
        ("urn:ogc:def:crs:EPSG::7415", "EPSG:7415"),
        ("https://www.opengis.net/def/crs/EPSG/0/28992", "EPSG:28992"),
        ("EPSG:25832", "EPSG:25832"),
        ("urn:ogc:def:crs,crs:EPSG::28992,crs:EPSG::5709", "EPSG:28992+5709"),
        (None, None),
    ],
)
def test_reference_systems(tmp_path, text, crs):
    assert at.load(put(tmp_path, city(crs=text))).city.crs == crs


def test_an_unknown_reference_system_is_noted(tmp_path):
    with pytest.warns(UserWarning, match="'my own grid' is left out: it has no EPSG code"):
        assert at.load(put(tmp_path, city(crs="my own grid"))).city.crs is None


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_sequences_are_the_same_scene(tmp_path):
    one = at.load(put(tmp_path, everything()))
    other = at.load(put(tmp_path, sequence(everything()), "a.city.jsonl"))
    np.testing.assert_array_equal(one.triangles().vertices, other.triangles().vertices)
    assert one.city.objects == other.city.objects == ["tree", "house", "part", "pond"]
    assert one.city.surfaces == other.city.surfaces and one.name == other.name == "a"
    assert (one.city.object_of_face == other.city.object_of_face).all()


def test_other_scenes_are_no_cities():
    assert at.procedural("atrium", triangles=1000).city is None


def test_garbage_is_collected_again_after_errors(tmp_path):
    refused(put(tmp_path, city(version="0.9")), "CityJSON version is '0.9'; convert it to 2.0 with: cjio")
    assert gc.isenabled()


def broken(**changes):
    return {**city(), **changes}


@pytest.mark.parametrize(
    "document, words",
    [
        ({"type": "FeatureCollection"}, ["is GeoJSON; rename it to a.city.geojson"]),
        ({}, ["not a CityJSON file (its type is None)"]),
        ([1], ["a list of 1; it must be a JSON object"]),
        ('{"type": "CityJSON"', ["JSON cannot be read"]),
        ({"type": "CityJSONFeature"}, ["put the line of type CityJSON before it"]),
        (broken(version=None), ["version is missing"]),
        (broken(vertices=[[0, 0]]), ["vertices is a list of 1; it must be a list of vertices"]),
        (broken(vertices=[[0, 0, "x"]]), ["vertices"]),
        (broken(CityObjects={"a": 3}), ["CityObjects has 'a', which is not an object"]),
        (broken(CityObjects={"a": building(3)}), ['CityObjects "a" geometry[0] is not an object']),
        (broken(CityObjects={}), ["no object has a surface with an area"]),
        (broken(transform={"scale": [1, 1]}), ["transform.scale"]),
        (
            city({"a": building({**solid(), "boundaries": [[[0, 1, 2]]]})}),
            ['"a" has boundaries that are not nested lists'],
        ),
        (city({"a": building({**solid(), "boundaries": [0, 1, 2]})}), ['"a" geometry[0].boundaries are not nested']),
        (city({"a": building(surfaces(boundaries=[[[0, 1, 88]]]))}), ['"a" uses vertex 88, but there are 8 vertices']),
        (
            city({"a": building(surfaces(boundaries=[[[0, 1, 0.5]]]))}),
            ['"a" has boundaries that are not nested lists of vertices'],
        ),
        ({**instances(), "geometry-templates": {}}, ['"tree" geometry[0].template is 1; there are 0 templates']),
        (instances(anchor=7), ['"tree" geometry[0].boundaries is 7; it must be a whole number from 0 to 1']),
    ],
)
def test_errors_name_the_problem(tmp_path, document, words):
    refused(put(tmp_path, document), "a.city.json", *words)


def test_errors_in_sequences_name_the_line(tmp_path):
    lines = sequence(everything()).splitlines()
    refused(put(tmp_path, "\n".join([lines[0], "", '{"type": 3}']), "a.jsonl"), "a.jsonl, line 2", "type is 3")
    refused(put(tmp_path, lines[0] + "\n" + json.dumps(city()), "a.jsonl"), "line 2", 'must be "CityJSONFeature"')


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_real_city_has_the_area_of_its_polygons(tmp_path):
    """The shared scene was cut by another program. Written as CityJSON, it is read with the same triangles."""
    real = at.load(scene_path("delft_city/scene.glb"), up="z").triangles().vertices.astype(np.float64)
    vertices = np.round(real.reshape(-1, 3) * 1000).astype(int)
    faces = polygons(np.arange(len(vertices)).reshape(-1, 3).tolist())
    document = city({"a": building(surfaces(boundaries=faces), kind="LandUse")}, vertices, transform=transform())
    areas = np.linalg.norm(vector_areas(at.load(put(tmp_path, document))), axis=1)
    cross = np.cross(*(vertices[k::3] - vertices[::3] for k in (1, 2)))
    expected = np.linalg.norm(cross, axis=1) / 2e6
    assert len(expected) > 30_000
    assert areas.sum() == pytest.approx(expected.sum(), rel=1e-6)
