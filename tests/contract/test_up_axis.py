"""The axis that points up: one for a mesh in memory however it arrives, and named by every result that needs it."""

import importlib
from contextlib import nullcontext
from importlib.util import find_spec

import numpy as np
import pytest

import antumbra as at
from study_cases import study_cases

trimesh = pytest.importorskip("trimesh", reason="no trimesh: the up axis of meshes in memory is NOT checked")

TOWER = ((0, 0, 0), (20, 20, 1)), ((3, 0, 6.5), (4, 4, 12))  # middles and sizes of boxes: a floor, and a tower on it


def tower():
    """A floor in x and y with a tower along z."""
    parts = [trimesh.creation.box(size).apply_translation(middle) for middle, size in TOWER]
    return trimesh.util.concatenate(parts)


def of_pyvista():
    pyvista = pytest.importorskip("pyvista", reason="no PyVista: the up axis of its meshes is NOT checked")
    return pyvista.PolyData.from_regular_faces(tower().vertices, tower().faces)


def of_meshio():
    meshio = pytest.importorskip("meshio", reason="no meshio: the up axis of its meshes is NOT checked")
    return meshio.Mesh(tower().vertices, [("triangle", tower().faces)])


def of_open3d():
    try:  # it may be installed without the libraries of the system that it needs
        open3d = importlib.import_module("open3d")
    except (ImportError, OSError):
        pytest.skip("no Open3D: the up axis of its meshes is NOT checked")
    mesh = tower()
    return open3d.t.geometry.TriangleMesh(mesh.vertices.astype(np.float32), mesh.faces.astype(np.int32))


MESHES = {"trimesh": tower, "pyvista": of_pyvista, "meshio": of_meshio, "Open3D": of_open3d}
WAYS = {"load": at.load, "from_mesh": at.Scene.from_mesh}


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("library", MESHES)
def test_meshes_of_other_libraries_have_z_up_unless_another_axis_is_given(library, way):
    mesh = MESHES[library]()
    assert WAYS[way](mesh).up == WAYS[way](mesh, up="z").up == "z" and WAYS[way](mesh, up="y").up == "y"
    assert not WAYS[way](mesh).notes


def test_drop_ins_use_the_axis_of_load():
    assert at.trimesh_ray(tower()).scene.up == at.load(tower()).up
    mesh = of_pyvista()
    importlib.import_module("antumbra.integrations.pyvista")
    table = at.sky_view(at.load(mesh), at.face_sensors(at.load(mesh)))
    found = mesh.antumbra.sky_view().cell_data["sky_view"]
    np.testing.assert_allclose(found, table["sky_view"], rtol=0, atol=1e-12)


@pytest.mark.parametrize("way", WAYS)
def test_a_mesh_that_seems_to_have_y_up_has_a_note(way):
    town = np.concatenate([tower().triangles + [25 * k, 0, 0] for k in range(9)])
    lying = trimesh.Trimesh(**trimesh.triangles.to_kwargs(town[..., [0, 2, 1]] * (1, 1, -1)))
    told = pytest.warns(UserWarning, match='seems to have y up, and is read as z up; pass up="y"')
    with told if way == "load" else nullcontext():
        scene = WAYS[way](lying)
    assert scene.up == "z" and any("seems to have y up" in note for note in scene.notes)
    assert not WAYS[way](lying, up="y").notes


TABLES = [case for case in study_cases() if case.function not in ("line_of_sight", "visibility_matrix", "view_factors")]


@pytest.mark.parametrize("case", TABLES, ids=lambda case: case.function)
@pytest.mark.parametrize("up", ["y", "z"])
def test_results_name_the_axis(case, up):
    corners = np.array([(-9, 0, -9), (9, 0, -9), (9, 0, 9), (-9, 0, 9)], float)
    if up == "z":
        corners = corners[:, [0, 2, 1]] * (1, -1, 1)
    scene = at.Scene.from_arrays(corners, [[0, 2, 1], [0, 3, 2]], up=up)
    result = case.call(scene)
    about = getattr(result, "about", None) or result.table.about
    assert about["up"] == up


COMMANDS = {
    "sun": ("--latitude", "52", "--longitude", "4", "--days", "2026-06-21", "-o", "out.csv"),
    "shadow": ("--latitude", "52", "--longitude", "4", "--at", "2026-06-21T12:00", "-o", "out.gpkg"),
    "skyline": ("--point", "5,5,0.5", "-o", "out.csv"),
    "bake": ("-o", "out.glb", "--spp", "4"),
    "los": ("--from", "5,5,0.5", "--to", "5,6,0.5", "-o", "out.csv"),
}


@pytest.mark.parametrize("command", COMMANDS)
def test_reports_of_commands_name_the_axis(cli, tmp_path, command):
    path = tmp_path / "town.ply"
    tower().export(path)
    for up in "yz":
        report = cli(command, path, "--up", up, *COMMANDS[command], "--json").json()
        assert report["up"] == up
    assert "up z axis" in " ".join(cli(command, path, "--up", "z", *COMMANDS[command]).out.split())


def test_pvlib_shading_names_the_axis_and_obeys_a_closed_form():
    """A wall to the south, as high as it is away, hides the sun below 45 degrees when it stands in the south."""
    if not find_spec("pandas") or not find_spec("pvlib"):
        pytest.skip("no pandas or pvlib: the shading of modules is NOT checked")
    import pandas

    times = pandas.date_range("2026-06-21T10:40", periods=4, freq="30min", tz="Etc/GMT")
    wall = np.array([(-900, -10, 0), (900, -10, 0), (900, -10, 10), (-900, -10, 10)], float)
    place = at.Place(52.0, 0.0)
    shaded = {}
    for up in "yz":
        corners = wall if up == "z" else wall[:, [0, 2, 1]] * (1, 1, -1)
        scene = at.Scene.from_arrays(corners, [[0, 1, 2], [0, 2, 3]], up=up)
        for day in 0, 182:
            found = at.pvlib_shading(scene, (0.0, 0.0, 0.0), times + pandas.Timedelta(days=day), samples=1, place=place)
            assert found.attrs["up"] == up
            south = np.cos(np.radians(found["solar_azimuth"] - 180.0))
            height = np.tan(np.radians(found["solar_elevation"])) / south  # over the wall's foot, in its distance
            assert (found["shaded_fraction"] == (height < 1.0)).all()
            shaded[up, day] = found["shaded_fraction"].tolist()
    assert shaded["y", 0] == shaded["z", 0] == [0.0] * 4 and shaded["y", 182] == shaded["z", 182] == [1.0] * 4
