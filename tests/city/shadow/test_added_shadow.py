"""The shadow of a new building beside that before it: its area in closed form, and added hours of cells."""

import numpy as np
import pytest

from gltf_files import Gltf

gpd = pytest.importorskip("geopandas")

HERE = "--latitude", 52, "--longitude", 4.36, "--timezone", "+00:00", "--north", 0
OLD = 30.0, 0.0, 10.0, 12.0  # x, y, side and height of a building that stands
NEW = -20.0, 0.0, 8.0, 20.0  # of one that is added


def solid(x, y, side, height):
    """The corners and the faces of a square building, z up."""
    corners = [(x + a * side, y + b * side, c * height) for c in (0, 1) for a, b in ((0, 0), (1, 0), (1, 1), (0, 1))]
    quads = [(3, 2, 1, 0), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]
    return np.array(corners), np.array([face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))])


@pytest.fixture
def plain(tmp_path):
    """A plain with a building as glTF, with y up, and the new building as OBJ, with z up."""
    gltf, ground = (
        Gltf(),
        (np.array([[-300, -300, 0], [300, -300, 0], [300, 300, 0], [-300, 300, 0]]), [[0, 1, 2], [0, 2, 3]]),
    )
    for name, (corners, faces) in {"plain": ground, "old": solid(*OLD)}.items():
        upright = (corners[:, [0, 2, 1]] * (1.0, 1.0, -1.0)).astype(np.float32)
        gltf.node(mesh=gltf.mesh(gltf.primitive(upright, np.array(faces, np.uint16))), name=name)
    gltf.write(tmp_path, "plain.glb")
    corners, faces = solid(*NEW)
    lines = [*(f"v {x} {y} {z}" for x, y, z in corners), *(f"f {a + 1} {b + 1} {c + 1}" for a, b, c in faces)]
    (tmp_path / "new.obj").write_text("\n".join(lines) + "\n")
    return tmp_path


def area_of(box, about):
    """The area of the shadow of a box on the ground, with the ground below it: a swept square."""
    _, _, side, height = box
    reach = height / np.tan(np.radians(about["sun_elevation"]))
    azimuth = np.radians(about["sun_azimuth"])
    return side * side + side * reach * (abs(np.sin(azimuth)) + abs(np.cos(azimuth)))


@pytest.mark.parametrize("cell", [None, 0.5])
def test_new_and_gone_shadows_have_the_areas_of_swept_squares(cli, plain, cell):
    words = "shadow", "plain.glb", *HERE, "--at", "2026-03-21T10:00+00:00", "--add", "new.obj?up=z", "--before"
    words += () if cell is None else ("--cell", cell)
    told = cli(*words, "-o", "a.gpkg", "--map", "a.png", "--json").json()
    rows = gpd.read_file(plain / "a.gpkg")
    areas = {name: float(rows[rows["change"] == name]["area"].sum()) for name in ("new", "gone", "both")}
    if cell is None:
        assert areas["gone"] == 0.0 and (plain / "a.png").stat().st_size > 10_000
        assert np.isclose(areas["new"], area_of(NEW, told), rtol=1e-5)
        assert np.isclose(areas["both"], area_of(OLD, told), rtol=1e-5)
        words = "shadow", "plain.glb", *HERE, "--at", "2026-03-21T10:00+00:00", "--remove", "old", "--before"
        told = cli(*words, "-o", "b.gpkg", "--json").json()
        rows = gpd.read_file(plain / "b.gpkg")
        assert set(rows["change"]) == {"gone"} and np.isclose(rows["area"].sum(), area_of(OLD, told), rtol=1e-5)
    else:
        assert np.isclose(
            areas["new"], area_of(NEW, told) - NEW[2] ** 2, rtol=0.03
        )  # cells inside the building are left out


def test_cells_of_days_have_the_added_hours(cli, plain):
    done = cli("shadow", "plain.glb", *HERE, "--days", "2026-03-21", "--cell", 4, "--step", 60, "--add", "new.obj?up=z",
               "--before", "--classes", "0,1,2,4", "-o", "a.gpkg", "-o", "a.tif", "--json").json()  # fmt: skip
    rows = gpd.read_file(plain / "a.gpkg")
    rasterio = pytest.importorskip("rasterio")
    with rasterio.open(plain / "a.tif") as file:
        bands = dict(zip(file.descriptions, file.read()))
    added = bands["shadow_hours"] - bands["shadow_hours_before"]
    assert np.nanmin(added) == 0.0 and np.nanmax(added) > 2.0 and np.isnan(added).sum() == 4
    assert (
        rows["area"].sum() == (added > 0.0).sum() * 16.0 == done["area"]
        and (rows["hours_to"] > rows["hours_from"]).all()
    )


def test_rows_of_objects_are_not_compared(cli, plain):
    done = cli(
        "shadow", "plain.glb", *HERE, "--at", "2026-03-21T10:00", "--per", "object", "--add", "new.obj?up=z", "--before"
    )
    assert done.code == 2 and "--before compares the whole shadow; leave --per object out" in done.err
