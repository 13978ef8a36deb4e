"""``mesh.antumbra``: results of triangles come back to the cells and points of every kind of data set."""

import importlib
import os
import subprocess
import sys
import tomllib
import types
from inspect import signature

import numpy as np
import pytest

import antumbra as at
from repository import ROOT

pv = pytest.importorskip("pyvista", reason="no PyVista: its accessor is NOT checked")
accessor = importlib.import_module("antumbra.integrations.pyvista")

UP, DOWN = [0, 0, 1], [0, 0, -1]
PLAIN = {"algorithm": "dataset_surface"} if "algorithm" in signature(pv.DataSet.extract_surface).parameters else {}


def of(mesh):
    """The accessor of a mesh, in every version of PyVista."""
    return mesh.antumbra if hasattr(pv, "register_dataset_accessor") else accessor.DatasetAccessor(mesh)


def table() -> "pv.PolyData":
    """A square floor, below a pentagon, a point, a line and a polygon without area; cells 0 to 4."""
    angles = np.linspace(0, 2 * np.pi, 5, endpoint=False)
    pentagon = np.column_stack([2.5 * np.cos(angles), 2.5 * np.sin(angles), np.ones(5)])
    floor = np.array([[-4, -4, 0], [4, -4, 0], [4, 4, 0], [-4, 4, 0]], float)
    points = np.concatenate([pentagon, floor, [[9, 9, 9], [8, 9, 9], [7, 9, 9]]])
    return pv.PolyData(points, verts=[1, 9], lines=[2, 9, 10], faces=[4, 5, 6, 7, 8, 5, *range(5), 3, 9, 10, 11])


def test_the_accessor_is_announced():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert project["entry-points"]["pyvista.accessors"] == {"antumbra": accessor.__name__}
    if hasattr(pv, "registered_accessors"):
        (found,) = [each for each in pv.registered_accessors() if each.name == "antumbra"]
        assert found.accessor is accessor.DatasetAccessor and found.target is pv.DataSet


def test_the_accessor_is_found_without_an_import_of_antumbra(tmp_path):
    """As a fresh installation announces it."""
    if not hasattr(pv, "register_dataset_accessor"):
        pytest.skip(f"PyVista {pv.__version__} has no accessors, so their discovery is NOT checked")
    folder = tmp_path / "announced-1.dist-info"
    folder.mkdir()
    (folder / "METADATA").write_text("Metadata-Version: 2.1\nName: announced\nVersion: 1\n")
    (folder / "entry_points.txt").write_text(f"[pyvista.accessors]\nantumbra = {accessor.__name__}\n")
    code = "import sys, pyvista; print('antumbra' in sys.modules, type(pyvista.Sphere().antumbra).__name__)"
    settings = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=settings)
    assert done.stdout.split() == ["False", "DatasetAccessor"], done.stderr


def test_copies_keep_the_accessor_and_are_read_for_themselves():
    mesh = pv.Sphere()
    points = np.array([[3.0, 0.1, 0.2], [0.0, 0.2, -4.0]])

    def seen(dataset, points):
        found = of(dataset).visible_from(points)
        return np.asarray(found.cell_data[found.cell_data.keys()[-1]])

    usual = seen(mesh, points)
    assert usual.any() and not usual.all()
    for other in mesh.copy(deep=True), mesh.copy(deep=False):
        assert type(of(other)) is type(of(mesh)) and (seen(other, points) == usual).all()
    other = mesh.copy()
    other.points = np.asarray(other.points) * 2.0
    assert (seen(other, 2.0 * points) == usual).all() and (seen(mesh, points) == usual).all()


def test_versions_without_accessors_are_told(monkeypatch):
    old = types.SimpleNamespace(__version__="0.45.0", DataSet=pv.DataSet, PolyData=pv.PolyData)
    monkeypatch.setattr(accessor, "pyvista", old)
    with pytest.warns(
        UserWarning, match=r"PyVista 0\.45\.0 has no accessors, so no mesh\.antumbra; update it to 0\.48"
    ):
        accessor._register()
    assert accessor.DatasetAccessor(pv.Sphere())


def test_cells_of_all_kinds_have_their_results():
    """A polygon has the mean of its triangles; what has no area has no result."""
    mesh = table()
    found = of(mesh).sky_view()
    sky = found.cell_data["sky_view"]
    assert found is not mesh and "sky_view" not in mesh.cell_data and len(sky) == mesh.n_cells == 5
    assert np.isnan(sky[[0, 1, 4]]).all() and sky[3] == 1.0 and 0.1 < sky[2] < 0.9
    floor, pentagon = (mesh.extract_cells([k]).extract_surface(**PLAIN).triangulate() for k in (2, 3))
    parts = [np.asarray(each.points)[np.asarray(each.faces).reshape(-1, 4)[:, 1:]] for each in (floor, pentagon)]
    whole = at.Scene.from_arrays(np.concatenate(parts), up="z")
    alone = at.sky_view(whole)
    assert alone.sensors.areas[:2].tolist() == [32.0, 32.0]
    assert sky[2] == alone["sky_view"][:2].mean()
    assert np.isnan(found.cell_data["sky_share"]).sum() == 3


def test_polygons_that_collapse_keep_the_others_in_place():
    """Polygons of six corners in a line, or in a point, among others that are not convex."""
    angles = np.linspace(0, 2 * np.pi, 6, endpoint=False)
    star = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(6)]) * np.where(np.arange(6) % 2, 0.4, 1)[:, None]
    line = np.column_stack([np.arange(6.0), np.full((6, 2), 9.0)])
    parts = [star, line, star + [0, 0, 1], line * 0 + 7, star + [0, 0, 2]]
    faces = np.column_stack([np.full(5, 6), np.arange(30).reshape(5, 6)]).ravel()
    mesh = pv.PolyData(np.concatenate(parts), faces=faces)
    blocked = of(mesh).occluded([UP, DOWN]).cell_data["occluded"]
    assert np.isnan(blocked[[1, 3]]).all() and blocked[[0, 2, 4]].tolist() == [[1, 1], [1, 1], [0, 1]]


def test_triangle_strips_and_vertex_cells():
    """A strip is one cell, after the polygons."""
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 2, 0], [5, 0, 0], [6, 0, 0], [5, 1, 0]], float)
    mesh = pv.PolyData(points, verts=[1, 0], faces=[3, 5, 7, 6], strips=[5, 0, 1, 2, 3, 4])
    assert mesh.n_cells == 3
    blocked = of(mesh).occluded(UP).cell_data["occluded"]
    assert np.isnan(blocked[0]) and blocked[1:].tolist() == [1.0, 0.0]  # the triangle faces down, the strip up
    assert of(mesh).occluded(DOWN).cell_data["occluded"][1:].tolist() == [0.0, 1.0]


@pytest.mark.parametrize("kind", ["hexahedra", "image", "tetrahedra", "structured"])
def test_grids_have_results_on_their_surface(kind):
    image = pv.ImageData(dimensions=(4, 4, 4))
    make = {
        "hexahedra": lambda: image.cast_to_unstructured_grid(),
        "image": lambda: image,
        "tetrahedra": lambda: image.triangulate(),
        "structured": lambda: image.cast_to_structured_grid(),
    }
    mesh = make[kind]()
    open_ = of(mesh).ambient_occlusion(spp=16).cell_data["ambient_occlusion"]
    surface = mesh.extract_surface(pass_cellid=True, **PLAIN)
    outside = np.unique(surface.cell_data["vtkOriginalCellIds"])
    assert len(open_) == mesh.n_cells and (np.flatnonzero(~np.isnan(open_)) == outside).all()
    assert (open_[outside] == 1.0).all() and 0 < len(outside) < mesh.n_cells
    bottom = np.unique(np.round(of(mesh).occluded(DOWN).cell_data["occluded"][outside], 3))
    assert bottom[-1] == 1.0 and bottom[0] < 1.0  # a cell at an edge has faces that are free, and others
    free = of(mesh).visible_from([[1.5, 1.5, 9], [1.5, 1.5, -9]])["visible_from"]
    assert free.shape == (mesh.n_cells, 2) and np.nanmax(free[:, 0]) > 0 and np.nanmax(free.min(axis=1)) < 1


def test_points_have_results():
    mesh = table()
    found = of(mesh).occluded([UP, DOWN], on="points")
    blocked = found.point_data["occluded"]
    assert blocked.shape == (mesh.n_points, 2) and "occluded" not in found.cell_data
    assert np.isnan(blocked[9:]).all() and (blocked[:9, 1] == 1).all() and not blocked[:9, 0].any()
    grid = pv.ImageData(dimensions=(3, 3, 3))
    sky = of(grid).sky_view(on="points")["sky_view"]
    assert np.isnan(sky).sum() == 1 and np.isnan(sky[13])  # the middle


def test_visibility_is_that_of_points():
    mesh, eye = pv.Sphere(), [0.0, 0.0, 3.0]
    seen = of(mesh).visible_from(eye).cell_data["visible_from"]
    sensors = at.face_sensors(at.load(mesh))
    towards = ((np.array(eye) - sensors.points) * sensors.normals).sum(1)
    assert len(seen) == mesh.n_cells and ((towards > 0) == (seen == 1)).all() and 0 < seen.sum() < len(seen)


def test_sun_hours_and_in_place():
    pytest.importorskip("pvlib", reason="no pvlib: sun hours are NOT checked")
    mesh = table()
    same = of(mesh).sun_hours("2026-06-21", place=at.Place(52.0, 4.0), inplace=True, step=30)
    hours = mesh.cell_data["sun_hours"]
    assert same is mesh and np.isnan(hours).sum() == 3 and 1 < hours[2] < hours[3] < 17
    assert {"sun_share", "longest"} <= set(mesh.cell_data.keys()) and "first" not in mesh.cell_data
    mesh.points[:5, 2] = -1  # below the floor
    assert of(mesh).sun_hours("2026-06-21", place=at.Place(52.0, 4.0), step=30)["sun_hours"][2] == hours[3]


@pytest.mark.parametrize(
    "call, words",
    [
        (lambda: of(table()).sky_view(on="faces"), 'on is \'faces\'; .*it must be "cells" or "points"'),
        (lambda: of(table()).occluded([0, 0]), r"directions must be numbers \(\.\.\., 3\)"),
        (lambda: of(table()).occluded([0, 0, 0]), "direction"),
        (lambda: of(table()).sky_view(inplace=1), "inplace is 1"),
        (lambda: of(pv.Line()).sky_view(), "the PolyData has no surface"),
        (lambda: accessor.DatasetAccessor(pv.MultiBlock()), "the mesh is a MultiBlock; give a pyvista.DataSet"),
    ],
)
def test_wrong_values_are_refused(call, words):
    with pytest.raises(at.InputError, match=words):
        call()


# --- PyVista's own filters --------------------------------------------------------------------------------------------


def blob() -> "pv.PolyData":
    """A closed surface of triangles that is not convex, from numbers that float32 holds."""
    ball = pv.Sphere(theta_resolution=24, phi_resolution=19)
    points = np.asarray(ball.points, np.float64)
    ball.points = np.float32(np.round(points * (2 + np.sin(7 * points[:, :1])) * 2**12) / 2**12)
    return ball


def test_ray_trace_is_that_of_pyvista():
    """But for the order: PyVista's points ascend in x, and its cells are in another order."""
    mesh, rng = blob(), np.random.default_rng(5)
    found = 0
    for start, end in zip(rng.uniform(-2, 2, (40, 3)), rng.uniform(-2, 2, (40, 3))):
        points, cells = of(mesh).ray_trace(start, end)
        wanted, of_wanted = mesh.ray_trace(start, end)
        assert points.dtype == wanted.dtype and points.shape == wanted.shape
        assert sorted(cells.tolist()) == sorted(of_wanted.tolist())
        np.testing.assert_allclose(sorted_by_x(points), sorted_by_x(wanted), rtol=0, atol=1e-5)
        assert (np.diff(np.linalg.norm(points - start, axis=1)) > 0).all()
        first, of_first = of(mesh).ray_trace(start, end, True)
        assert first.tolist() == (points[0] if len(points) else points).tolist() and (of_first == cells).all()
        for point, cell in zip(points, cells):
            assert mesh.find_closest_cell(point) == cell
        found += len(cells)
    assert found > 10


def sorted_by_x(points: np.ndarray) -> np.ndarray:
    return points[np.argsort(points[:, 0])]


def test_multi_ray_trace_is_that_of_pyvista():
    pytest.importorskip("embreex", reason="no embreex: multi_ray_trace of PyVista is NOT checked")
    mesh, rng = blob(), np.random.default_rng(6)
    origins, directions = rng.uniform(-2, 2, (200, 3)), rng.normal(size=(200, 3))
    for first in False, True:
        mine = of(mesh).multi_ray_trace(origins, directions, first)
        other = mesh.multi_ray_trace(origins, directions, first_point=first)
        assert [each.dtype for each in mine] == [each.dtype for each in other] and len(mine[0]) > 30
        assert (mine[1] == other[1]).all() and (mine[2] == other[2]).all()
        np.testing.assert_allclose(mine[0], other[0], rtol=0, atol=1e-5)
    by_ray = of(mesh).multi_ray_trace(origins, directions, retry=True)[1]
    assert (np.diff(by_ray) >= 0).all()


def test_rays_name_cells_of_polygons_and_notice_changes():
    mesh = table()
    ray = [[0.25, 0.5, 3.0]], [[0, 0, -1.0]]
    points, rays, cells = of(mesh).multi_ray_trace(*ray)
    assert points.tolist() == [[0.25, 0.5, 1.0], [0.25, 0.5, 0.0]] and rays.tolist() == [0, 0]
    assert cells.tolist() == [3, 2]  # polygons follow the vertex and the line
    mesh.points[:, 2] += 0.5
    assert of(mesh).multi_ray_trace(*ray)[0][:, 2].tolist() == [1.5, 0.5]
    assert of(mesh).ray_trace([0.25, 0.5, 3], [0.25, 0.5, 1], True)[0].tolist() == [0.25, 0.5, 1.5]


def test_rays_are_plotted(monkeypatch):
    shown = []
    monkeypatch.setattr(pv.Plotter, "show", lambda self: shown.append(len(self.actors)))
    for end in 1.0, 2.9:  # with and without an intersection
        of(table()).ray_trace([0.25, 0.5, 3], [0.25, 0.5, end], plot=True, off_screen=True)
    assert len(shown) == 2 and min(shown) > 2


def test_interior_points_are_those_of_pyvista():
    mesh, grid = blob(), pv.ImageData(dimensions=(9, 9, 9), spacing=(0.31,) * 3, origin=(-1.3,) * 3)
    before = grid.array_names
    inside = of(grid).select_interior_points(mesh)
    assert grid.array_names == before and inside.active_scalars_name == "selected_points"
    found = inside["selected_points"]
    assert found.dtype == bool and 20 < found.sum() < len(found) - 20
    if hasattr(pv.DataSet, "select_interior_points"):
        assert (found == grid.select_interior_points(mesh)["selected_points"]).all()
    outside = of(grid).select_interior_points(mesh, inside_out=True, method="cell_locator", locator_tolerance=0.1)
    assert (outside["selected_points"] == ~found).all()
    assert not of(grid).select_interior_points(pv.PolyData())["selected_points"].any()
    with pytest.raises(at.InputError, match="open edges; close it, or set check_surface=False"):
        of(grid).select_interior_points(pv.Plane())
