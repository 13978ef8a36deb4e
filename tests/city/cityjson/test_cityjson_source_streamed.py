"""CityJSONSeq files are stored a few lines at a time, with the bytes of the scene in memory."""

import json

import numpy as np
import pytest

import antumbra as at
from antumbra.base.memory import reading_limit
from antumbra.city.cityjson import city_geometries, cityjson_file
from antumbra.engine.scene_reading import read_scene_data
from antumbra.formats.scene_format import ReadOptions
from city_files import CUBE, building, city, everything, instances, polygons, put, sequence, solid, surfaces, transform

HEAD = {**city(), "CityObjects": {}, "vertices": []}
PLACED = {"transform": transform()}
FEET = {"referenceSystem": "urn:ogc:def:crs,crs:EPSG::28992,crs:EPSG::6360"}


@pytest.fixture(autouse=True)
def line_by_line(monkeypatch):
    monkeypatch.setattr(cityjson_file, "_TEXT", 1)


def line(name, *geometry, move=(0, 0, 0), vertices=CUBE, **more):
    vertices = (np.asarray(vertices) + move).tolist()
    return {"type": "CityJSONFeature", "id": name, "CityObjects": {name: building(*geometry, **more)}} | {
        "vertices": vertices
    }


def text_of(*lines, head=HEAD, end="\n"):
    return end.join(json.dumps(each) for each in (head, *lines)) + end


def levels():
    twice = surfaces("1"), solid("1")  # of which one is read
    return line("a", *twice), line("b", solid("2.2"), surfaces("1.3"), move=(5, 0, 0)), line("c", surfaces("0"))


def parts_of_one():
    whole, part = building(solid("1"), children=["p"]), building(solid("1"), kind="BuildingPart", parents=["w"])
    beside = {"v": building(solid("1"), children=["q"]), "q": building(solid("1"), kind="BuildingPart", parents=["v"])}
    beside["q"]["geometry"][0]["boundaries"] = [polygons([[f + 8 for f in face] for face in [[0, 3, 2, 1]]])]
    vertices = np.concatenate([CUBE, CUBE + 9]).tolist()
    one = {"type": "CityJSONFeature", "CityObjects": {"w": whole, "p": part}, "vertices": CUBE.tolist()}
    return one, {"type": "CityJSONFeature", "CityObjects": beside, "vertices": vertices}


def listed_again():
    """Objects of an earlier line: at the same place, elsewhere, and at that of the second, which does not count."""
    lines = [line("a", solid()), line("b", solid(), move=(3, 0, 0)), line("a", surfaces(), solid())]
    return [*lines, line("a", solid(), move=(9, 0, 0)), line("a", solid(), move=(9, 0, 0)), line("b", solid())]


def bad_polygons():
    bow_tie, flat = [[0, 2, 1, 3]], [[0, 1, 0]]
    vertices = [[0, 0, 0], [3, 0, 0], [2, 2, 0], [0, 1, 0]]
    return [line("a", surfaces(boundaries=[bow_tie]), vertices=vertices)] + [
        line(name, surfaces(boundaries=[flat, flat, *polygons()]), move=(k, 0, 0)) for k, name in enumerate("bcd")
    ]


FILES = {
    "everything": sequence(everything()),
    "levels": text_of(*levels()),
    "parts": text_of(*parts_of_one()),
    "listed again": text_of(*listed_again()),
    "bad polygons": text_of(*bad_polygons()),
    "repeated faces": text_of(line("a", solid()), line("b", solid()), line("c", solid(), move=(7, 0, 0))),
    "instances": sequence(instances(anchor=1)),
    "heights in feet": text_of(line("a", solid()), head=HEAD | {"metadata": FEET}),
    "map coordinates": text_of(
        line("a", solid()), line("b", solid(), move=(1, 0, 0)), head=HEAD | {"transform": transform()}
    ),
    "carriage returns": text_of(line("a", solid()), {**line("b", solid(), move=(3, 0, 0))}, end="\r\n\r\n"),
    "old ends of lines": text_of(*listed_again(), end="\r"),
    "objects in the head": text_of(line("a", solid()), head=city()),
}


def streamed(path, **options):
    return read_scene_data(path, ReadOptions(streamed=True, **options))


@pytest.mark.parametrize("name", FILES)
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_store_of_lines_has_the_bytes_of_the_scene_in_memory(tmp_path, name):
    path = put(tmp_path, FILES[name], "a.city.jsonl")
    scene, data = at.load(path), streamed(path)
    assert not data.resident and (data.name, data.up, data.crs) == (scene.name, scene.up, scene.crs)
    assert data.notes == scene.notes and data.bounds.tolist() == scene.bounds.tolist()
    at.build_store(scene, tmp_path / "whole.antumbra", chunk=16)
    at.build_store(path, tmp_path / "streamed.antumbra", chunk=16)
    assert (tmp_path / "streamed.antumbra").read_bytes() == (tmp_path / "whole.antumbra").read_bytes()


def test_the_cases_have_notes_that_count_over_all_lines(tmp_path):
    notes = {name: "\n".join(streamed(put(tmp_path, text, "a.jsonl")).notes) for name, text in FILES.items()}
    assert "(a Solid is preferred); choose another level of 0, 1, 1.3, 2.2 with lod: 1" in notes["levels"]
    assert "whose parts repeat them: 1" in notes["parts"] and "beside those of their parts" in notes["parts"]
    assert "an earlier line has at the same place: 1" in notes["listed again"]
    assert "an earlier line has at the same place: 1" in notes["old ends of lines"]
    assert "6 polygons without area" in notes["bad polygons"] and "1 polygon has rings" in notes["bad polygons"]
    assert "12 triangles repeat others" in notes["repeated faces"]
    assert "heights are converted" in notes["heights in feet"]


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_options_count_as_in_memory(tmp_path, cli):
    path = put(tmp_path, text_of(*levels()), "a.city.jsonl")
    for options in ({"lod": "1"}, {"lod": "2.2"}, {"crs": "EPSG:28992", "up": "y"}):
        data, scene = streamed(path, **options), at.load(path, **options)
        assert (data.notes, data.up, data.crs) == (scene.notes, scene.up, scene.crs)
        assert data.n_triangles == scene.n_triangles and data.bounds.tolist() == scene.bounds.tolist()
    at.build_store(at.load(path, lod="1"), tmp_path / "whole.antumbra")
    assert cli("build", f"{path}?lod=1", "-o", tmp_path / "a.antumbra", "-q").code == 0
    assert (tmp_path / "a.antumbra").read_bytes() == (tmp_path / "whole.antumbra").read_bytes()


MANY = [line(f"b{k}", solid(), move=(2 * k, 0, 0)) for k in range(4)]
DAMAGED = {
    "no level": (text_of(*levels()), "no geometry has lod '7'; there are 0, 1, 1.3, 2.2"),
    "no features": (text_of(*MANY, city()), "line 6"),
    "no JSON": (text_of(*MANY)[:-9], "line 5"),
    "no vertex": (text_of(*MANY, line("c", surfaces(boundaries=[[[0, 1, 9]]]))), 'CityObjects "c" uses vertex 9'),
    "no surface": (text_of(line("a")), "no object has a surface with an area"),
    "empty": ("\n \n", "the file is empty"),
    "no version": (text_of(*MANY, head={**HEAD, "version": "3"}), "CityJSON version is '3'"),
}


@pytest.mark.parametrize("name", DAMAGED)
def test_damage_is_named_as_in_memory(tmp_path, name):
    text, words = DAMAGED[name]
    path, options = put(tmp_path, text, "a.jsonl"), {"lod": "7"} if name == "no level" else {}
    with pytest.raises(at.InputError) as in_memory:
        at.load(path, **options)
    with pytest.raises(at.InputError) as by_line:
        streamed(path, **options)
    assert str(by_line.value) == str(in_memory.value) and words in str(by_line.value)


def test_instances_of_all_lines_are_counted(tmp_path, monkeypatch):
    monkeypatch.setattr(city_geometries, "_MOST_POLYGONS", 10)
    monkeypatch.setattr(city_geometries, "_MOST_PER_INSTANCE", 1)
    document = instances()
    document["CityObjects"] |= {f"tree {k}": document["CityObjects"]["tree"] for k in range(3)}
    path = put(tmp_path, sequence(document), "a.jsonl")
    with pytest.raises(at.InputError, match=r"3 instances of templates have 18 polygons, more than 1 each"):
        streamed(path)


def test_a_file_of_too_many_objects_is_refused_with_a_cure(tmp_path):
    path = put(tmp_path, text_of(*MANY), "a.jsonl")
    with reading_limit(1500), pytest.raises(at.InputError, match=r"first 4 objects takes about 1\.6 kB"):
        streamed(path)
