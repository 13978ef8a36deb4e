"""Small CityJSON files."""

import json

import numpy as np

CUBE = np.array([[x, y, z] for z in (0, 1) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))])
CUBE_FACES = [[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]]  # outwards
SCALE, TRANSLATION = [0.001, 0.001, 0.001], [84616.467, 447422.999, -0.452]


def polygons(faces=CUBE_FACES):
    """Boundaries of polygons without holes."""
    return [[face] for face in faces]


def surfaces(lod="1", boundaries=None, **more):
    return {"type": "MultiSurface", "lod": lod, "boundaries": boundaries or polygons(), **more}


def solid(lod="1", **more):
    return {"type": "Solid", "lod": lod, "boundaries": [polygons()], **more}


def building(*geometry, kind="Building", **more):
    return {"type": kind, "geometry": list(geometry), **more}


def city(objects=None, vertices=CUBE, version="2.0", crs="https://www.opengis.net/def/crs/EPSG/0/7415", **more):
    """A CityJSON document. Without a transform, vertices are in world space."""
    document = {"type": "CityJSON", "version": version}
    if crs is not None:
        document["metadata"] = {"referenceSystem": crs}
    vertices = vertices.tolist() if isinstance(vertices, np.ndarray) else vertices
    return {**document, "CityObjects": objects or {"a": building(solid())}, "vertices": vertices, **more}


def transform():
    return {"scale": SCALE, "translate": TRANSLATION}


def instances(matrix=None, anchor=0):
    """A document with a template, and one instance of it at vertex `anchor`."""
    matrix = np.eye(4) if matrix is None else np.asarray(matrix)
    instance = {
        "type": "GeometryInstance",
        "template": 1,
        "boundaries": [anchor],
        "transformationMatrix": matrix.reshape(-1).tolist(),
    }
    faces = [[[5 + i for i in face]] for face in CUBE_FACES]
    templates = {
        "templates": [surfaces(boundaries=[[[0, 1, 2]]]), {**solid("2"), "boundaries": [faces]}],
        "vertices-templates": [[0.0, 0.0, 0.0]] * 5 + CUBE.astype(float).tolist(),
    }
    trees = {"tree": building(instance, kind="SolitaryVegetationObject")}
    return city(trees, [[10, 20, 30], [0, 0, 0]], **{"geometry-templates": templates})


def everything():
    """A document with each kind of part: semantics, holes, children, templates, a transform, several levels."""
    faces = [[face] for face in CUBE_FACES]
    hole = [[0, 3, 2, 1], [8, 9, 10]]
    semantics = {"surfaces": [{"type": "WallSurface"}, {"type": "RoofSurface"}], "values": [[0, 1, 0, None, 0, 0]]}
    document = instances()
    document["vertices"] = [[1000 * x, 1000 * y, 1000 * z] for x, y, z in CUBE.tolist()] + [
        [200, 200, 0],
        [200, 600, 0],
        [600, 200, 0],
    ]
    document["transform"] = transform()
    document["CityObjects"] |= {
        "house": building(surfaces("0"), solid("2.2", semantics=semantics), children=["part"]),
        "part": building(
            {"type": "MultiSolid", "lod": "1.2", "boundaries": [[faces]]}, kind="BuildingPart", parents=["house"]
        ),
        "pond": building(surfaces("1", [hole]), kind="WaterBody"),
    }
    return document


def sequence(document):
    """The text of a CityJSONSeq file: each object becomes a feature with its own vertices."""
    head = {**document, "CityObjects": {}, "vertices": []}
    features = [
        {"type": "CityJSONFeature", "id": name, "CityObjects": {name: thing}, "vertices": document["vertices"]}
        for name, thing in document["CityObjects"].items()
    ]
    return "".join(json.dumps(line) + "\n" for line in [head, *features])


def put(folder, document, name="a.city.json"):
    path = folder / name
    path.write_text(document if isinstance(document, str) else json.dumps(document), encoding="utf-8")
    return path
