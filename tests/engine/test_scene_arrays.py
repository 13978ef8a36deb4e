"""Scenes from arrays, and the recentring of all scenes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from antumbra.base.errors import InputError
from antumbra.engine.scene import Scene
from gltf_files import TETRAHEDRON, TETRAHEDRON_FACES, assert_at
from strength import examples

GRID = 2.0**-20


def grid_mesh(seed, reach):
    """Float64 vertices on a grid of 2**-20, one of them beyond float32, and faces."""
    rng = np.random.default_rng(seed)
    vertices = np.round(rng.uniform(-reach, reach, (30, 3)) / GRID) * GRID
    vertices[0] = 64.0 + GRID
    faces = rng.integers(0, 30, (40, 3))
    faces[0, 0] = 0
    return vertices, faces


@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([0.01, 1.0, 37.5, 800.0]),
    st.tuples(*[st.sampled_from([0.0, 5e6, -5e6, 448262.5, 1234567.0, 3 * GRID])] * 3),
)
@examples(80)
def test_an_offset_leaves_the_bits(seed, reach, offset):
    vertices, faces = grid_mesh(seed, reach)
    here, there = Scene.from_arrays(vertices, faces), Scene.from_arrays(vertices + offset, faces)
    np.testing.assert_array_equal(here.triangles().vertices, there.triangles().vertices)
    np.testing.assert_array_equal(there.origin - here.origin, offset)
    np.testing.assert_array_equal(there.bounds - here.bounds, np.tile(offset, (2, 1)))


@given(st.integers(0, 2**32 - 1), st.floats(1e-6, 1e6), st.floats(-1e7, 1e7))
@examples(80)
def test_the_origin_rule(seed, scale, offset):
    rng = np.random.default_rng(seed)
    soup = rng.normal(size=(9, 3, 3)) * scale * rng.uniform(0.1, 1, 3) + offset
    scene = Scene.from_arrays(soup)
    lower, upper = soup.min(axis=(0, 1)), soup.max(axis=(0, 1))
    g = 2.0 ** (np.floor(np.log2((upper - lower).max())) - 20)
    np.testing.assert_array_equal(scene.origin, lower + np.round((upper - lower) / 2 / g) * g)
    np.testing.assert_array_equal(scene.triangles().vertices, (soup - scene.origin).astype(np.float32))
    assert (np.abs(scene.origin - (lower + upper) / 2) <= g).all()


def test_indexed_soup_and_corner_rows_agree():
    corners = TETRAHEDRON[TETRAHEDRON_FACES]
    scenes = [
        Scene.from_arrays(TETRAHEDRON, TETRAHEDRON_FACES),
        Scene.from_arrays(corners),
        Scene.from_arrays(corners.reshape(-1, 3)),
        Scene.from_arrays(corners.tolist()),
        Scene.from_arrays(corners.astype(np.int64)),
        Scene.from_arrays(corners.astype(np.float16)),
    ]
    for scene in scenes:
        assert_at(scene, corners)
        assert (scene.n_triangles, scene.duration, scene.animated) == (4, 0.0, False)
        assert scene.triangles().vertices.flags.c_contiguous
    assert scenes[0].meshes == [("arrays", 4, 1)]
    assert "4 triangles" in repr(scenes[0])


def test_the_caller_keeps_the_arrays():
    vertices, colours = TETRAHEDRON.copy(), np.full((4, 3), 0.5)
    scene = Scene.from_arrays(vertices, TETRAHEDRON_FACES, colours)
    vertices[:], colours[:] = 9.0, 0.0
    assert_at(scene, TETRAHEDRON[TETRAHEDRON_FACES])
    assert (scene.triangles().colour == 0.5).all()


def test_many_faces_are_gathered_in_blocks():
    rng = np.random.default_rng(0)
    vertices, faces = rng.normal(size=(1000, 3)), rng.integers(0, 1000, (150_000, 3))
    scene = Scene.from_arrays(vertices, faces)
    np.testing.assert_array_equal(scene.triangles().vertices, (vertices[faces] - scene.origin).astype(np.float32))


def test_colours():
    one = Scene.from_arrays(TETRAHEDRON, TETRAHEDRON_FACES, (0.1, 0.2, 0.3)).triangles().colour
    np.testing.assert_array_equal(one, np.tile(np.float32([0.1, 0.2, 0.3]), (4, 1)))
    each = np.random.default_rng(0).uniform(size=(4, 3))
    scene = Scene.from_arrays(TETRAHEDRON, TETRAHEDRON_FACES, each)
    np.testing.assert_array_equal(scene.triangles().colour, each.astype(np.float32))
    assert (Scene.from_arrays(TETRAHEDRON, TETRAHEDRON_FACES).colours == 1).all()


@pytest.mark.parametrize("scale", [1e-30, 1e-6, 1e6, 1e15])
def test_scales(scale):
    soup = np.random.default_rng(1).normal(size=(20, 3, 3)) * scale
    assert_at(Scene.from_arrays(soup), soup)


FACE = [[0, 1, 2]]
WRONG = {
    "vertices of two numbers": (dict(vertices=np.zeros((3, 2))), "vertices must be numbers"),
    "vertices of text": (dict(vertices=[["a", "b", "c"]]), "vertices must be numbers"),
    "ragged vertices": (dict(vertices=[[0, 0, 0], [1, 1]]), "vertices must be numbers"),
    "complex vertices": (dict(vertices=np.zeros((3, 3), complex)), "vertices must be numbers"),
    "vertices of objects": (dict(vertices=np.array([[None] * 3] * 3)), "vertices must be numbers"),
    "no vertices": (dict(vertices=np.zeros((0, 3)), faces=np.zeros((0, 3), int)), "no triangles"),
    "soup of quads": (dict(vertices=np.zeros((2, 4, 3))), "soup has shape"),
    "soup with faces": (dict(vertices=np.zeros((2, 3, 3)), faces=FACE), "leave faces out"),
    "four corners": (dict(vertices=np.zeros((4, 3))), "not a multiple of 3"),
    "NaN": (dict(vertices=[[0, 0, 0], [1, np.nan, 0], [0, 1, 0]], faces=FACE), "vertex 1"),
    "infinite": (dict(vertices=[[0, 0, 0], [1, 0, 0], [0, np.inf, 0]]), "vertex 2"),
    "too wide": (dict(vertices=[[0, 0, 0], [1e300, 0, 0], [-1e308, 1, 0]]), "at most"),
    "index too high": (
        dict(vertices=TETRAHEDRON, faces=[[0, 1, 2], [0, 1, 4]]),
        "face 1 uses the vertices 0, 1, 4",
    ),
    "index negative": (dict(vertices=TETRAHEDRON, faces=[[0, -1, 2]]), "face 0"),
    "float faces": (dict(vertices=TETRAHEDRON, faces=[[0.0, 1.0, 2.0]]), "faces must be whole numbers"),
    "quads": (dict(vertices=TETRAHEDRON, faces=[[0, 1, 2, 3]]), "faces must be whole numbers"),
    "no faces": (dict(vertices=TETRAHEDRON, faces=np.zeros((0, 3), int)), "no triangles"),
    "colours of whole numbers": (dict(vertices=TETRAHEDRON, faces=FACE, colours=np.zeros((1, 3), int)), "float"),
    "wrong number of colours": (dict(vertices=TETRAHEDRON, faces=FACE, colours=np.zeros((2, 3))), "vertex_colours"),
    "colours above one": (dict(vertices=TETRAHEDRON, faces=FACE, colours=(0, 0, 1.5)), "between 0 and 1"),
    "colours NaN": (dict(vertices=TETRAHEDRON, faces=FACE, colours=(0, 0, np.nan)), "between 0 and 1"),
    "up": (dict(vertices=TETRAHEDRON, faces=FACE, up="x"), 'up is \'x\'; it must be "y" or "z"'),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_arrays(case):
    arguments, words = WRONG[case]
    with pytest.raises(InputError) as caught:
        Scene.from_arrays(**arguments)
    message = str(caught.value)
    assert words in message and "\n" not in message
    assert case == "up" or message.startswith("arrays")
