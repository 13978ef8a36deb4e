"""A bake of a store is that of the scene in memory if vertices are in the order of their use, as a store finds them."""

import numpy as np
import pytest

import antumbra as at
from antumbra.baking import stored_shapes
from antumbra.baking.stored_shapes import merged
from baked_files import Glb, box, grid

GROUND = grid(np.arange(-4.0, 5.0), np.arange(-4.0, 5.0))
HOUSE = box((-0.9, 0, -0.9), (0.9, 2, 0.9))  # without a corner where the ground has one
COLOURS = np.array([[0.8, 0.2, 0.1], [0.3, 0.3, 0.3], [0.1, 0.5, 0.2]], np.float32)


def in_order_of_use(vertices, faces):
    """The same faces, whose vertices are in the order in which faces use them."""
    used, first, corners = np.unique(faces, return_index=True, return_inverse=True)
    order = np.argsort(first)
    return vertices[used[order]], np.argsort(order)[corners].reshape(-1, 3)


def house(up="y", unit=None, kinds=3, offset=(0, 0, 0)):
    """A house on a ground, in several colours."""
    vertices = np.concatenate([GROUND[0], HOUSE[0]]).astype(np.float64) + offset
    faces = np.concatenate([GROUND[1], HOUSE[1].astype(np.int64) + len(GROUND[0])])
    if up == "z":
        vertices = vertices[:, [0, 2, 1]] * (1, -1, 1)
    vertices, faces = in_order_of_use(vertices, faces)
    colours = COLOURS[np.arange(len(faces)) * kinds // len(faces)]
    return at.Scene.from_arrays(vertices, faces, colours, up=up, unit=unit)


def stored(folder, scene, **options):
    at.build_store(scene, folder / "a.antumbra", chunk=16, **options)
    return at.load(folder / "a.antumbra")


QUANTITIES = [
    {"what": "ao", "spp": 64},
    {"what": "ao", "radius": 1.5, "attribute": "_AO", "spp": 16},
    {"what": "light", "bounces": 2, "spp": 16},
    {"what": "bent-normal", "spp": 16},
    {"what": "sun", "keep_hidden": True, "spp": 4},
    {"what": "ao", "texture": 64, "spp": 16},
    {"what": "light", "texture": 64, "spp": 16, "denoise": True},
]


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("options", QUANTITIES, ids=str)
def test_the_file_is_that_of_the_scene_in_memory(tmp_path, options):
    if "texture" in options:
        pytest.importorskip("xatlas")
    scene = house()
    whole = at.bake(scene, tmp_path / "whole.glb", **options)
    paged = at.bake(stored(tmp_path, scene), tmp_path / "paged.glb", **options)
    assert (tmp_path / "whole.glb").read_bytes() == (tmp_path / "paged.glb").read_bytes()
    assert whole.mean == paged.mean and whole.rays == paged.rays and whole.hidden == paged.hidden


@pytest.mark.parametrize(
    "scene",
    [{"up": "z"}, {"unit": "ft"}, {"up": "z", "unit": "ft", "offset": (5e6, 10, -3e5)}, {"kinds": 1}],
    ids=str,
)
def test_other_frames(tmp_path, scene):
    scene = house(**scene)
    at.bake(scene, tmp_path / "whole.glb", spp=16)
    at.bake(stored(tmp_path, scene), tmp_path / "paged.glb", spp=16)
    assert (tmp_path / "whole.glb").read_bytes() == (tmp_path / "paged.glb").read_bytes()


def test_tiles_and_files_of_several_meshes(tmp_path, cli):
    text, start = "", 1
    for name, mesh in {"ground": GROUND, "house": HOUSE}.items():
        vertices, faces = in_order_of_use(*mesh)
        lines = [f"usemtl {name}", *("v {} {} {}".format(*vertex) for vertex in vertices.tolist())]
        text += "\n".join([*lines, *("f {} {} {}".format(*face) for face in (faces + start).tolist())]) + "\n"
        start += len(vertices)
    (tmp_path / "a.obj").write_text(text)
    scene = at.load(tmp_path / "a.obj")
    assert len(scene.objects) == 2
    at.bake(scene, tmp_path / "whole.glb", spp=16)
    at.build_store(tmp_path / "a.obj", tmp_path / "a.tiles", chunk=16, tile=50)
    assert cli("bake", "a.tiles", "-o", "paged.glb", "--spp", 16, "-q").code == 0
    assert (tmp_path / "whole.glb").read_bytes() == (tmp_path / "paged.glb").read_bytes()
    assert len(Glb(tmp_path / "paged.glb").json["meshes"]) == 2


def test_triangles_that_share_no_vertices_share_them_in_the_file(tmp_path):
    soup = house().triangles().vertices
    at.bake(stored(tmp_path, at.Scene.from_arrays(soup)), tmp_path / "a.glb", spp=4)
    assert len(Glb(tmp_path / "a.glb").attribute("POSITION", 1)) == len(np.unique(soup.reshape(-1, 3), axis=0))


def test_smooth_normals_are_kept_and_faces_without_area_left_out(tmp_path):
    vertices, faces = in_order_of_use(*GROUND)
    waves = vertices + np.float32([0, 1, 0]) * np.sin(vertices[:, :1])
    normals = np.stack([-np.cos(vertices[:, 0]), np.ones(len(vertices)), 0 * vertices[:, 0]], 1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    faces = np.concatenate([faces, [[3, 3, 4]]])
    scene = at.Scene.from_arrays(waves, faces, normals=normals)
    at.bake(stored(tmp_path, scene), tmp_path / "a.glb", spp=64, attribute="_AO")
    at.bake(scene, tmp_path / "b.glb", spp=64, attribute="_AO")
    a, b = Glb(tmp_path / "a.glb"), Glb(tmp_path / "b.glb")
    np.testing.assert_array_equal(a.attribute("POSITION", 1), b.attribute("POSITION", 1))
    np.testing.assert_allclose(a.attribute("NORMAL", 1), b.attribute("NORMAL", 1), atol=1e-6)
    np.testing.assert_allclose(a.attribute("_AO", 1), b.attribute("_AO", 1), atol=1 / 32)
    assert a.json["accessors"][a.primitive(1)["indices"]]["count"] == 3 * (len(faces) - 1)


def test_corners_with_other_normals_are_other_vertices():
    corners = np.float32([[[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 0, 0], [0, 1, 0], [0, 0, 1]]])
    same = np.broadcast_to([0.0, 0.0, 1.0], (2, 3, 3))
    shape = merged(corners, same, COLOURS[:2])
    assert len(shape.vertices) == 4 and shape.faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    other = same.copy()
    other[1] = [1.0, 0.0, 0.0]
    assert len(merged(corners, other, COLOURS[:2]).vertices) == 6
    corners[1, 0] = -0.0
    assert len(merged(corners, None, COLOURS[:2]).vertices) == 4


def test_a_store_that_does_not_fit_is_refused_in_one_line(tmp_path, monkeypatch):
    scene = stored(tmp_path, house())
    monkeypatch.setattr(stored_shapes, "BAKE_BYTES", 1 << 40)
    with pytest.raises(at.InputError, match=r"a.antumbra: this needs all \d+ triangles at once, .* raise max_memory"):
        at.bake(scene, tmp_path / "a.glb")
    assert not (tmp_path / "a.glb").exists()


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("in_store", [False, True])
def test_values_on_a_page_are_those_of_its_faces(tmp_path, in_store):
    """Primitives have the faces of one colour, so the file has other faces first than the scene."""
    plain = house(kinds=1)
    mixed = at.Scene.from_arrays(plain.triangles().vertices, colours=COLOURS[np.arange(plain.n_triangles) % 3])
    baked = [
        at.bake(each, tmp_path / "a.glb", spp=256) for each in (plain, stored(tmp_path, mixed) if in_store else mixed)
    ]
    one, other = (each.vertices.values[each.vertices.corners] for each in baked)
    assert np.ptp(one) > 0.5
    flat = np.abs(one - other).max((1, 2))  # corners of the house have the mean normals of the faces of one colour
    assert np.median(flat) < 0.02 and (flat < 0.1).mean() > 0.8
    assert baked[1].page(tmp_path / "a.html").triangles == plain.n_triangles
