"""The number of faces that repeat others, and the notes of readers about them."""

import numpy as np
import pytest

import antumbra as at
from antumbra.city.cityjson.repeated_faces import repeated_faces
from antumbra.scene.mesh import make_mesh
from baked_files import box, primitive
from gltf_files import Gltf


def mesh_of(corners):
    return make_mesh("made", corners.reshape(-1, 3), None, None, "made")


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_faces_repeat_others_whatever_corner_they_begin_with(kind):
    rng = np.random.default_rng(4)
    corners = rng.integers(-3, 4, (200, 3, 3)).astype(kind)
    corners[rng.random(corners.shape) < 0.2] *= -0.0
    keys, n = set(), 0
    for face in (corners + 0.0).tolist():
        if len({tuple(corner) for corner in face}) == 3:  # others have no area
            keys.add(repr(min(face[k:] + face[:k] for k in range(3))))
            n += 1
    assert repeated_faces(mesh_of(corners)) == n - len(keys) < 5 and n > 190
    again = np.concatenate([corners, np.roll(corners, 1, axis=1), corners[60:70, ::-1]])
    assert repeated_faces(mesh_of(again)) == 2 * n - len(keys)


def test_indexed_faces_at_the_same_place_repeat_each_other():
    points, faces = box((0, 0, 0), (1, 1, 1))
    twice = make_mesh("made", np.concatenate([points, points]), np.concatenate([faces, faces + 8]), None, "made")
    assert repeated_faces(twice) == 12 and repeated_faces(make_mesh("made", points, faces, None, "made")) == 0


def test_footprints_listed_twice_are_noted():
    geopandas = pytest.importorskip("geopandas")
    pytest.importorskip("mapbox_earcut")
    shapely = pytest.importorskip("shapely")
    squares = [shapely.box(0, 0, 1, 1), shapely.box(5, 0, 6, 1), shapely.box(0, 0, 1, 1)]
    table = geopandas.GeoDataFrame({"height": [3.0, 3.0, 3.0]}, geometry=squares, crs="EPSG:28992")
    notes = at.from_footprints(table).notes
    assert any("12 triangles repeat others" in note for note in notes)
    assert not any("repeat" in note for note in at.from_footprints(table[:2]).notes)


@pytest.mark.parametrize("places, count", [([0, 0, 3], 1), ([0, 1, 2], 0), ([4, 4, 4], 2)])
def test_nodes_with_the_same_mesh_at_the_same_place_are_noted(tmp_path, places, count):
    made = Gltf()
    mesh = made.mesh(primitive(made, *box((0, 0, 0), (1, 1, 1))))
    for x in places:
        made.node(mesh=mesh, translation=[float(x), 0.0, 0.0])
    path = made.write(tmp_path)
    notes = [note for note in at.load(path, up="y").notes if "repeat" in note]
    repeating = "1 node repeats another" if count == 1 else f"{count} nodes repeat another"
    assert [repeating in note for note in notes] == [True] * bool(count)
