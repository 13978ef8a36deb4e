"""Points inside solids, and points below sheets, which are dark but visible."""

import numpy as np
import pytest

import antumbra as at
from antumbra.baking.solids import Solids, is_closed
from antumbra.baking.surface_meter import ReceiverPoints
from baked_files import Glb, box, grid, primitive
from gltf_files import Gltf

HEIGHT, HALF = 0.3, 4.0
QUARTER = {"upright": np.eye(3), "turned": np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])}


def tiles(n=6):
    """((v, 3), (f, 3)): square tiles with gaps between them, each a chart of its own, that face up."""
    meshes = [grid([x, x + 0.9], [z, z + 0.9]) for x in range(-n, n) for z in range(-n, n)]
    faces = np.concatenate([faces + 4 * k for k, (_, faces) in enumerate(meshes)])
    return np.concatenate([points for points, _ in meshes]), faces


def awning(folder, turn=QUARTER["upright"], double_sided=True):
    """Tiles on the ground below a sheet of one layer that faces up."""
    made = Gltf()
    for mesh, sides in ((tiles(), False), (grid([-HALF, HALF], [-HALF, HALF], HEIGHT), double_sided)):
        material = made.add("materials", doubleSided=sides)
        part = primitive(made, (mesh[0] @ turn.T).astype(np.float32), mesh[1])
        made.node(mesh=made.mesh({**part, "material": material}))
    return made.write(folder, "awning.glb")


def open_sky(x, z):
    """The cosine-weighted share of the sky at points below the sheet: 1 minus the four rectangles seen from there."""
    covered = 0.0
    for a in (HALF - x, HALF + x):
        for b in (HALF - z, HALF + z):
            u, v = a / HEIGHT, b / HEIGHT
            covered = covered + u / np.hypot(1, u) * np.arctan(v / np.hypot(1, u))
            covered = covered + v / np.hypot(1, v) * np.arctan(u / np.hypot(1, v))
    return 1.0 - covered / (2.0 * np.pi)


@pytest.mark.parametrize("turn", QUARTER.values(), ids=QUARTER)
@pytest.mark.parametrize("double_sided", [False, True])
def test_the_ground_below_a_sheet_has_its_closed_form(tmp_path, turn, double_sided):
    path = awning(tmp_path, turn, double_sided)
    made = at.bake(path, tmp_path / "out.glb", attribute="_AO", spp=1024, up="y")
    file = Glb(tmp_path / "out.glb")
    points, values = file.attribute("POSITION") @ turn, file.attribute("_AO")[:, 0]
    below = np.abs(points[:, [0, 2]]).max(1) < HALF - 0.05
    error = values[below] - open_sky(points[below, 0], points[below, 2])
    assert made.hidden == 0 and below.sum() > 200 and values[below].max() < 0.6
    assert np.sqrt((error**2).mean()) < 4e-3 and np.abs(error).max() < 0.02
    scene = at.load(path, up="y")
    normals = np.tile(turn @ (0.0, 1.0, 0.0), (len(points), 1))
    same = at.visibility(scene, file.attribute("POSITION"), at.AmbientOcclusion(), normals, spp=1024).fraction
    assert np.sqrt(((values - same) ** 2).mean()) < 5e-3


@pytest.mark.parametrize("radius", [None, 2.0])
def test_no_texel_below_a_sheet_is_filled_from_another_tile(tmp_path, radius):
    pytest.importorskip("xatlas")
    path = awning(tmp_path)
    made = at.bake(path, tmp_path / "out.glb", texture=256, spp=64, radius=radius)
    kept = at.bake(path, tmp_path / "kept.glb", texture=256, spp=64, radius=radius, keep_hidden=True)
    assert made.hidden == 0 and made.mean == kept.mean
    assert (Glb(tmp_path / "out.glb").image() == Glb(tmp_path / "kept.glb").image()).all()


def test_hidden_texels_take_values_of_their_own_chart(tmp_path):
    """A closed box covers some tiles as a whole, and parts of others, beside a wall that darkens one side."""
    pytest.importorskip("xatlas")
    made = Gltf()
    for mesh in (tiles(3), box((-1.5, -0.5, -1.5), (1.5, 0.5, 1.5))):
        made.node(mesh=made.mesh(primitive(made, *mesh)))
    path = made.write(tmp_path, "covered.glb")
    moved = at.bake(path, tmp_path / "out.glb", texture=256, spp=64)
    kept = at.bake(path, tmp_path / "kept.glb", texture=256, spp=64, keep_hidden=True)
    assert moved.hidden > 100 and kept.hidden == 0
    file, dark = Glb(tmp_path / "out.glb"), Glb(tmp_path / "kept.glb").image()
    uv, points, image = file.attribute("TEXCOORD_0"), file.attribute("POSITION"), file.image()
    faces = file.array(file.primitive()["indices"]).reshape(-1, 3).astype(int)
    middle, place = points[faces].mean(1), (uv[faces].mean(1) * 256).astype(int)
    covered = np.abs(middle[:, [0, 2]]).max(1) < 1.0  # tiles wholly below the box
    found = image[place[covered, 1], place[covered, 0]]
    assert covered.sum() >= 8 and (found == 0).all() and (dark[place[covered, 1], place[covered, 0]] == 0).all()
    outside = np.abs(middle[:, [0, 2]]).max(1) > 2.2
    assert (image[place[outside, 1], place[outside, 0]] > 127).all()


def solids_of(scene, double_sided):
    return Solids(scene, np.full(scene.n_triangles, double_sided), 0.0, None)


def floor_points(*places):
    points = np.array([(x, 0.0, z) for x, z in places])
    return ReceiverPoints(points, np.tile([0.0, 1.0, 0.0], (len(points), 1)))


@pytest.mark.parametrize("double_sided", [False, True])
def test_a_closed_box_is_a_solid_whatever_its_material(double_sided):
    points, faces = box((-1, -1, -1), (1, 1, 1))
    solids = solids_of(at.Scene.from_arrays(points, faces), double_sided)
    np.testing.assert_array_equal(solids.contain(floor_points((0, 0), (0.9, 0.9), (1.1, 0), (5, 5))), [1, 1, 0, 0])


@pytest.mark.parametrize("double_sided", [False, True])
def test_a_box_without_a_bottom_is_a_solid_unless_its_backs_are_visible(double_sided):
    points, faces = box((-1, 0, -1), (1, 1, 1))
    sides = faces[(points[faces][..., 1] != 0.0).any(1)]
    scene = at.Scene.from_arrays(points, sides)
    assert len(sides) == 10 and not is_closed(scene.triangles().vertices).any()
    contained = solids_of(scene, double_sided).contain(floor_points((0, 0), (0.9, 0.9), (1.1, 0)))
    np.testing.assert_array_equal(contained, [not double_sided, not double_sided, False])


def test_solids_may_contain_parts_of_others():
    """A beam ends inside a wall, beside a bolt that is inside as well."""
    wall, beam = box((0, -3, -3), (2, 3, 3)), box((1, -0.2, -0.2), (9, 0.2, 0.2))
    bolt = box((0.45, 0.9, -1), (0.55, 1.1, 1))
    meshes = [wall, beam, bolt]
    faces = np.concatenate([faces + 8 * k for k, (_, faces) in enumerate(meshes)])
    scene = at.Scene.from_arrays(np.concatenate([points for points, _ in meshes]), faces)
    ends = ReceiverPoints(np.array([[1.0, 0, 0], [9.0, 0, 0]]), np.array([[-1.0, 0, 0], [1.0, 0, 0]]))
    np.testing.assert_array_equal(solids_of(scene, False).contain(ends), [True, False])


def test_closed_surfaces_are_told_from_open_ones():
    points, faces = box((-1, -1, -1), (1, 1, 1))
    closed = points[faces]
    lid = closed[:-1] + np.float32(5.0)  # one triangle is missing
    reversed_one = np.concatenate([closed[:1, ::-1], closed[1:]]) - np.float32(9.0)
    sheet = points[faces[:1]] + np.float32(20.0)
    both = np.concatenate([sheet, sheet[:, ::-1]]) + np.float32(7.0)  # a sheet with two sides
    soup = [closed, lid, reversed_one, sheet, both]
    expected = np.repeat([True, False, False, False, True], [len(part) for part in soup])
    order = np.random.default_rng(2).permutation(len(expected))
    np.testing.assert_array_equal(is_closed(np.concatenate(soup)[order]), expected[order])
    assert is_closed(np.empty((0, 3, 3), np.float32)).shape == (0,)
