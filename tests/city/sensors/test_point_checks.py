"""Points of all jobs: refused in degrees and where there is no surface; noted beside, below, on and behind surfaces."""

import inspect
import warnings
from pathlib import Path

import numpy as np
import pytest

import antumbra as at
import city_files
from antumbra.city.sensors.point_checks import NEAR, depths_below_ground, tell
from antumbra.scene.crs import reproject
from study_cases import study_cases

CRS = "EPSG:28992"
PLACE, DELFT = (5.0, 0.0, 84000.0, 0.0, -5.0, 447000.0), at.Place(52.0, 4.36)
WEST, NORTH = 84002.5, 446997.5
GOOD = [[WEST + 50.0, NORTH - 50.0, 30.0], [WEST + 60.0, NORTH - 40.0, 31.0]]
DEGREES = [[4.36, 52.01, 30.0]]
BELOW = [[WEST + 50.0, NORTH - 50.0, 3.0]]
BESIDE = [[WEST + 50.0, NORTH + 9.0, 30.0]]
ON = [[WEST + 52.0, NORTH - 51.0, 5.0]]


def heights():
    """(21, 21) float64: a plain at 5 with a hole."""
    out = np.full((21, 21), 5.0)
    out[4:8, 4:8] = np.nan
    return out


def raster():
    return at.from_raster((heights(), PLACE, CRS))


def meshed(up="z"):
    """The same plain as any mesh."""
    scene = raster()
    corners = scene.triangles().vertices.astype(float) + scene.origin
    corners = corners if up == "z" else corners[..., [0, 2, 1]] * (1, 1, -1)
    return at.Scene.from_arrays(corners, up=up, crs=CRS)


def pvlib_shading(scene, points):
    import pandas

    index = pandas.date_range("2026-06-21", periods=2, freq="6h", tz="UTC")
    return at.pvlib_shading(scene, points, index, place=DELFT)


JOBS = {
    "line_of_sight observers": lambda scene, points: at.line_of_sight(scene, points, GOOD[0]),
    "line_of_sight targets": lambda scene, points: at.line_of_sight(scene, GOOD[0], points),
    "pvlib_shading points": pvlib_shading,
    "sky_view sensors": lambda scene, points: at.sky_view(scene, points, directions=16),
    "skyline points": lambda scene, points: at.skyline(scene, points, azimuth_step=30.0, north=0.0),
    "sun_calendar points": lambda scene, points: at.sun_calendar(scene, points, "2026-06-21", place=DELFT, step=60),
    "sun_hours sensors": lambda scene, points: at.sun_hours(scene, points, "2026-06-21", place=DELFT, step=240),
    "viewshed observers": lambda scene, points: at.viewshed(scene, GOOD, points),
    "viewshed sensors": lambda scene, points: at.viewshed(scene, points, GOOD),
    "visibility_matrix sensors": lambda scene, points: at.visibility_matrix(scene, points, GOOD),
    "visibility_matrix targets": lambda scene, points: at.visibility_matrix(scene, GOOD, points),
    "visible_share sensors": lambda scene, points: at.visible_share(scene, points, GOOD),
    "visible_share target": lambda scene, points: at.visible_share(scene, GOOD, points),
}
JOBS |= {
    f"{case.function} {case.points}": lambda scene, points, case=case: case.call_with(points)(scene)
    for case in study_cases()
    if case.points
}
"""WarmUp and parameter -> a call with these points."""

NO_JOBS = {"visibility", "render", "view"}
"""Functions that take points or cameras of any scene, as queries and pictures do."""


def noted(call):
    """The notes of a call."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        call()
    return [str(each.message) for each in caught if each.category is UserWarning]


def test_every_job_with_points_is_tested():
    names = {"observers", "sensors", "targets", "target", "points", "cameras", "camera"}
    functions = [f for name in at.__all__ if inspect.isfunction(f := getattr(at, name))]
    taken = {
        f"{f.__name__} {name}"
        for f in functions
        for name in names & set(inspect.signature(f).parameters)
        if f.__name__ not in NO_JOBS
    }
    assert taken == {*JOBS, "dataset cameras"}


@pytest.mark.parametrize("make", [raster, meshed, lambda: meshed("y")], ids=["raster", "mesh", "y up"])
@pytest.mark.parametrize("job", JOBS)
def test_points_in_degrees_are_refused_over_a_map_with_their_place_on_it(job, make):
    scene = make()
    x, y = reproject(np.array([[4.36, 52.01]]), "EPSG:4326", CRS)[0]
    for degrees in (DEGREES, np.array(DEGREES)[:, [1, 0, 2]]):
        points = np.array([*degrees, *GOOD])
        points = points if scene.up == "z" else points[:, [0, 2, 1]] * (1, 1, -1)
        with pytest.raises(at.InputError, match=rf"are in degrees \(.*; project them: this one is at {x:.2f},{y:.2f}$"):
            JOBS[job](scene, points)


@pytest.mark.parametrize("make", [raster, meshed], ids=["raster", "mesh"])
@pytest.mark.parametrize("job", JOBS)
@pytest.mark.parametrize(
    "points, words",
    [
        (BELOW, "1 of 3 .* lies below the ground or inside a solid; the first is 84052.5,446947.5,3"),
        (ON, "1 of 3 .* lies on a surface without a normal, so it may block the view; give normals, or move"),
        (BESIDE, "1 of 3 .* lies beside terrain; the first is 84052.5,447006.5,30"),
    ],
    ids=["below", "on", "beside"],
)
def test_points_below_on_and_beside_the_ground_are_noted_with_their_number(job, make, points, words):
    if make is meshed and points is BESIDE:
        return  # other scenes are seen from beside them
    with pytest.warns(UserWarning, match=words):
        JOBS[job](make(), np.array([*GOOD, *points]))


@pytest.mark.parametrize("make", [raster, meshed], ids=["raster", "mesh"])
@pytest.mark.parametrize("job", JOBS)
def test_points_above_the_ground_get_no_note(job, make):
    assert not noted(lambda: JOBS[job](make(), np.array(GOOD)))


def test_notes_are_metadata_of_tables():
    for job in ("viewshed observers", "visible_share target", "sun_hours sensors", "sky_view sensors"):
        with pytest.warns(UserWarning, match="below the ground"):
            table = JOBS[job](raster(), np.array([*GOOD, *BELOW]))
        about = getattr(table, "table", table).about
        assert len(about["warnings"]) == 1 and "below the ground" in about["warnings"][0]
    assert "warnings" not in JOBS["sky_view sensors"](raster(), np.array(GOOD)).about


def test_notes_reach_callers_whose_code_is_in_no_module():
    with pytest.warns(UserWarning, match="a note"):
        exec("told = tell(['a note'])", {"tell": tell})


def test_cameras_in_degrees_are_refused(tmp_path):
    camera = at.Camera((4.36, 52.01, 9.0), (4.37, 52.02, 5.0), (0, 0, 1), 60.0, 8, 8)
    with pytest.raises(at.InputError, match=r"cameras are in degrees \(4.36,52.01\)"):
        at.dataset(raster(), tmp_path / "frames", [camera], spp=1)
    with pytest.raises(at.InputError, match=r"camera positions are in degrees \(4.36,52.01\)"):
        at.render(raster(), camera, spp=1)


def test_trees_in_degrees_are_refused(tmp_path):
    (tmp_path / "trees.csv").write_text("x,y,height,radius,base\n84050,446950,5,2,5\n4.36,52.01,5,2,5\n")
    with pytest.raises(at.InputError, match=r"the trees of trees\.csv are in degrees \(4\.36,52\.01\), and terrain"):
        at.from_trees(tmp_path / "trees.csv", scene=raster(), base="base")


def test_areas_and_bounds_in_degrees_are_refused():
    corners = [(4.36, 52.01), (4.37, 52.01), (4.37, 52.02)]
    with pytest.raises(at.InputError, match="sensors are in degrees"):
        at.sun_hours(raster(), "raster:0.001@9", "2026-06-21", areas=[corners], place=DELFT)
    with pytest.raises(at.InputError, match="sensors are in degrees"):
        at.sky_view(raster(), at.raster_sensors(raster(), 0.001, bounds=(corners[0], corners[2])), directions=16)


def test_points_far_beside_a_mesh_are_noted_and_those_near_it_are_not():
    scene = meshed()
    near, far = [[WEST + 150.0, NORTH - 50.0, 30.0]], [[WEST + 350.0, NORTH - 50.0, 30.0]]
    assert not noted(lambda: at.line_of_sight(scene, near, GOOD[0]))
    assert "1 of 1 observer lies far beside arrays" in noted(lambda: at.line_of_sight(scene, far, GOOD[0]))[0]


@pytest.mark.parametrize("make", [raster, meshed], ids=["raster", "mesh"])
@pytest.mark.parametrize("job", ["viewshed", "skyline"])
@pytest.mark.parametrize("place", [(WEST + 25.0, NORTH - 25.0), (WEST - 9.0, NORTH)], ids=["hole", "beside"])
def test_points_without_a_surface_to_be_placed_on_are_refused(job, place, make):
    points, options = np.array([[*GOOD[0][:2], 0.0], [*place, 0.0]]), {"on_surface": True, "eye_height": 1.7}
    calls = {
        "viewshed": lambda: at.viewshed(make(), GOOD, points, **options),
        "skyline": lambda: at.skyline(make(), points, north=0.0, **options),
    }
    words = (
        r"1 of 2 (observers|points) lies beside .* or on a hole, where no surface is to place points on; the first is "
    )
    with pytest.raises(at.InputError, match=words + f"{place[0]:.10g},{place[1]:.10g},0; move such points"):
        calls[job]()


def test_rasters_below_the_surface_are_noted():
    scene = raster()
    (note,) = noted(lambda: at.viewshed(scene, "raster+-1.5", GOOD))
    assert note.startswith("425 of 441 sensors lie below the ground")
    assert not noted(lambda: at.viewshed(scene, "raster+1.5", GOOD))
    (note,) = noted(lambda: at.viewshed(scene, "raster:5@2", GOOD))
    assert "sensors lie below the ground" in note and not noted(lambda: at.viewshed(scene, "raster:5@9", GOOD))


@pytest.mark.parametrize("up", ["y", "z"])
def test_depths_below_the_ground_and_in_solids_are_distances_to_the_surface_above(up):
    box = np.array([[x, y, z] for x in (0, 2) for y in (0, 3) for z in (0, 4)], float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    walls = box[np.array([tri for a, b, c, d in quads for tri in ((a, b, c), (a, c, d))])] + (5, 5, 0)
    ground = np.array([[[-9, -9, 0], [20, -9, 0], [20, 20, 0]], [[-9, -9, 0], [20, 20, 0], [-9, 20, 0]]], float)
    places = {
        (6.0, 6.0, 1.5): 2.5,  # in the box
        (6.0, 6.0, 9.0): 0.0,
        (1.0, 1.5, -2.25): 2.25,  # in the ground
        (1.0, 1.5, 0.25): 0.0,
        (-5.5, -7.5, -1.0): 0.0,  # below a sheet with two sides
    }
    sheet = ground[::-1, ::-1] * (0.1, 0.1, 1.0) - (5.0, 7.0, 0.5)
    sheets = np.concatenate([sheet, sheet[:, ::-1], sheet - (0, 0, 3), sheet[:, ::-1] - (0, 0, 3)])
    turn = (lambda v: v) if up == "z" else lambda v: v[..., [0, 2, 1]] * (1, 1, -1)
    for offset in (np.zeros(3), np.array([584321.0, 5746123.0, 12.0])):
        scene = at.Scene.from_arrays(turn(np.concatenate([ground, walls, sheets]) + offset), up=up)
        depths = depths_below_ground(scene, turn(np.array(list(places)) + offset))
        assert np.allclose(depths, list(places.values()), rtol=0.0, atol=1e-5)


# --- Wind turbines ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("make", [raster, meshed], ids=["raster", "mesh"])
def test_a_turbine_whose_rotor_reaches_below_the_ground_is_refused_with_the_height_of_the_ground(make):
    x, y = GOOD[0][:2]
    with pytest.raises(at.InputError, match=r"rotor reaches 2.5 below the ground; the ground there is at 5$"):
        at.visible_share(make(), GOOD, at.Turbine((x, y, -7.0), 12.0, 5.0))
    with pytest.raises(
        at.InputError, match=r"rotor reaches 1 below the ground; its lowest point is -1 above its foot$"
    ):
        at.visible_share(make(), GOOD, at.Turbine((x, y, 5.0), 4.0, 10.0))
    (note,) = noted(lambda: at.visible_share(make(), GOOD, at.Turbine((x, y, 4.0), 12.0, 5.0)))
    assert note.startswith("1 of 1 turbine lies below the ground")
    assert not noted(lambda: at.visible_share(make(), GOOD, at.Turbine((x, y, 5.0), 12.0, 5.0)))


# --- Surfaces drawn on others -----------------------------------------------------------------------------------------


def facade(angle, scale, wall=True):
    """A wall with 15 windows drawn on it, rounded to a scale; 0: float64."""
    turn = np.radians(angle)
    along, corner = np.array([np.cos(turn), np.sin(turn), 0.0]), np.array([84321.37, 446123.91, 1.23])
    rectangles = [(0.0, 0.0, 40.0, 12.0)] if wall else []
    rectangles += [
        (2.13 + 7.61 * i, 1.07 + 3.83 * j, 3.6 + 7.61 * i, 2.68 + 3.83 * j) for i in range(5) for j in range(3)
    ]
    corners = [corner + x * along + (0, 0, z) for a, b, c, d in rectangles for x, z in ((a, b), (c, b), (c, d), (a, d))]
    corners = np.array(corners) if scale == 0 else np.round(np.array(corners) / scale) * scale
    faces = np.arange(len(corners)).reshape(-1, 4)[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
    return at.Scene.from_arrays(corners, faces, up="z"), 2 * int(wall)


def hours(angle, scale, form, wall=True):
    """The hours of the windows' sensors, and the notes."""
    scene, first = facade(angle, scale, wall)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", UserWarning)
        table = at.sun_hours(scene, form, "2026-06-21", place=DELFT, step=60)
    notes = [str(each.message) for each in caught if each.category is UserWarning]
    return table["sun_hours"][table.sensors.faces >= first], notes


@pytest.mark.parametrize("angle", [0.0, 31.7, 90.0, 117.3, 203.9, 290.1])
def test_hours_of_windows_drawn_on_a_wall_are_those_of_the_windows_alone_or_noted(angle):
    right, none = hours(angle, 0.001, "face", wall=False)
    drawn, notes = hours(angle, 0.001, "face")
    lifted, no_notes = hours(angle, 0.001, "face+0.01")
    exact, nothing = hours(angle, 0, "face")
    assert right.max() > 3.0 and np.array_equal(lifted, right) and np.array_equal(exact, right)
    wrong = int((drawn != right).sum())
    assert none == no_notes == nothing == [] and bool(notes) >= (wrong > 0)
    if notes:
        assert int(notes[0].split(" of ")[0]) >= wrong and f"less than {NEAR:g} behind" in notes[0]


def test_windows_drawn_on_walls_are_wrong_and_noted_at_some_angles():
    counts = [(hours(angle, 0.001, "face"), hours(angle, 0.001, "face", wall=False)) for angle in (31.7, 290.1)]
    assert all((drawn != right).any() and len(notes) == 1 for (drawn, notes), (right, _) in counts)


JOBS_ON_FACES = {
    "sun_hours": lambda scene, form: at.sun_hours(scene, form, "2026-06-21", place=DELFT, step=240),
    "sky_view": lambda scene, form: at.sky_view(scene, form, directions=16),
    "viewshed": lambda scene, form: at.viewshed(scene, form, scene.bounds[1] + 9.0),
    "visibility_matrix": lambda scene, form: at.visibility_matrix(scene, form),
    "targets": lambda scene, form: at.visibility_matrix(scene, [scene.bounds[1] + 9.0], form),
    "visible_share": lambda scene, form: at.visible_share(scene, form, [scene.bounds[1] + 9.0]),
    "target": lambda scene, form: at.visible_share(scene, [scene.bounds[1] + 9.0], at.sensors_of(form, scene)),
    "skyline": lambda scene, form: at.skyline(scene, form, azimuth_step=30.0),
    "line_of_sight": lambda scene, form: sightlines(scene, at.sensors_of(form, scene)),
}


def sightlines(scene, sensors):
    return at.line_of_sight(scene, sensors.points, scene.bounds[1] + 9.0, normals=sensors.normals)


@pytest.mark.parametrize("form", ["face", "vertex", "grid:0.8"])
@pytest.mark.parametrize("job", JOBS_ON_FACES)
def test_sensors_closely_behind_another_surface_are_noted_in_every_job_until_they_are_lifted(job, form):
    scene, _ = facade(290.1, 0.001)
    assert any("behind another surface" in note for note in noted(lambda: JOBS_ON_FACES[job](scene, form)))
    assert not noted(lambda: JOBS_ON_FACES[job](scene, f"{form}+0.01"))


def test_party_walls_are_not_noted():
    square = np.array([[0, 0, 0], [4, 0, 0], [4, 0, 3], [0, 0, 3]], float)
    corners = np.concatenate([square, square + (0, 0.001, 0)])
    back_to_back = [[0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7]]  # each wall faces the other one
    scene = at.Scene.from_arrays(corners, back_to_back, up="z")
    assert not noted(lambda: at.sky_view(scene, "face", directions=16))
    same = at.Scene.from_arrays(corners, [[0, 2, 1], [0, 3, 2], [4, 6, 5], [4, 7, 6]], up="z")
    assert noted(lambda: at.sky_view(same, "face", directions=16))[0].startswith("2 of 4 sensors")


@pytest.mark.parametrize("side", ["front", "back"])
def test_faces_closely_behind_others_are_noted_in_view_factors(side):
    square = np.array([[0, 0, 0], [4, 0, 0], [4, 0, 3], [0, 0, 3]], float)
    quads = np.array([[0, 1, 2], [0, 2, 3]])
    quads = quads if side == "front" else quads[:, ::-1]
    near, far = (at.Scene.from_arrays(np.r_[square, square - (0, d, 0)], np.r_[quads, quads + 4]) for d in (0.001, 0.1))
    (note,) = noted(lambda: at.view_factors(near, "face", samples=64, side=side))
    assert note.startswith("2 of 4 faces lie less than 0.005 behind another face")
    assert not noted(lambda: at.view_factors(far, "face", samples=64, side=side))


@pytest.mark.parametrize("form", ["face", "vertex", "grid:0.5"])
def test_lifted_sensors_lie_off_their_surface_along_their_normals(form):
    scene, _ = facade(31.7, 0)
    flat, lifted = at.sensors_of(form, scene), at.sensors_of(f"{form}+0.25", scene)
    assert np.allclose(lifted.points, flat.points + 0.25 * flat.normals, rtol=0.0, atol=1e-9)
    assert np.array_equal(lifted.faces, flat.faces) and lifted.kind == flat.kind
    with pytest.raises(at.InputError, match="the lift of sensors is -1"):
        at.sensors_of(f"{form}+-1", scene)


def test_points_of_a_target_are_lifted_too(tmp_path):
    scene = at.load(city_files.put(Path(tmp_path), city_files.city({"a": city_files.building(city_files.solid())})))
    flat, lifted = at.surface_points(scene, 1.0), at.surface_points(scene, 1.0, lift=0.5)
    assert np.allclose(lifted.points, flat.points + 0.5 * flat.normals) and len(flat) > 5
