"""Turn a scene, its lights and its cameras by a quarter: pictures and jobs give the same numbers.

Quarter turns are exact, and so are bits. Sums of three products may be rounded otherwise. Soft lights are sampled
around an axis of their own, so other rays are traced, and only means are equal.
"""

import inspect
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas
import pytest
import typer
from PIL import Image

import antumbra as at
from antumbra.baking.bake_options import QUANTITIES
from antumbra.cli.app import program
from antumbra.scene.default_picture import KINDS
from baked_files import Glb
from study_cases import study_cases
from turned import FIRST, SHARP, SOFT, TURNS, UPRIGHT, Turned, camera_in, corners, lights_in, scene_in

EYES = np.array([[3.0, 1.5, 2.5], [-3.5, 1.0, -2.5], [0.0, 4.0, 0.0]])


class Found(NamedTuple):
    """What a function finds in a frame, as names and arrays. Vectors are turned back to the first frame."""

    exact: dict
    close: dict


FINDS = {}
"""Name of a public function -> what finds its answers: ``(frame, scene, folder) -> Found``."""

OTHERS = {
    "area_sensors": "areas are given on a map, which does not turn",
    "build_store": "its scenes are asked by the tests of stores; `build` is below",
    "place_of": "the coordinates of a place on earth do not turn",
    "surface_points": "a grid on a level face follows the first axis of the scene",
    "sky_view": "its directions lie on a spiral that does not turn; its own tests compare it with closed forms",
    "sensors_of": "text for the sensors below",
    "view": "its pictures are those of render",
    "write_attributes": "writes columns into a file",
}
"""Name of a public function that is not compared -> why."""


def finds(*names):
    def keep(function):
        FINDS.update(dict.fromkeys(names, function))
        return function

    return keep


def sensors_in(frame: Turned) -> at.Sensors:
    points, faces = corners()
    a, b, c = (points[faces[:, k]].astype(float) for k in range(3))
    return at.point_sensors(frame.of((a + b + c) / 3.0), frame.of(np.cross(b - a, c - a)))


@finds("render")
def _render(frame, scene, folder):
    shot = at.render(scene, camera_in(frame), lights_in(frame), layers=True, ground=True)
    exact = {"face": shot.gbuffer.face, "object": shot.layers.object, "ground": shot.ground.mask, "rays": shot.rays}
    exact |= {f"bits {k}": bits for k, bits in enumerate([*shot.bits, *shot.ground.bits])}
    close = {"image": shot.image, "ambient": shot.ambient, "share": shot.ground.share}
    close |= {f"light {k}": image for k, image in enumerate(shot.layers.lights)} | {"height": shot.ground.height}
    close |= {name: frame.back(getattr(shot.gbuffer, name)) for name in ("position", "normal")}
    return Found(exact, close)


@finds("visibility")
def _visibility(frame, scene, folder):
    sensors = sensors_in(frame)
    found = at.visibility(scene, sensors.points, lights_in(frame), sensors.normals, spp=64)
    return Found({"bits": found.bits, "fraction": found.fraction}, {})


@finds("line_of_sight")
def _lines(frame, scene, folder):
    found = at.line_of_sight(scene, frame.of(EYES)[:, None], frame.of(corners()[0] + (0, 0.25, 0)))
    exact = {name: getattr(found, name) for name in ("visible", "face", "object")}
    return Found(exact, {"point": frame.back(found.point), "distance": found.distance, "length": found.length})


@finds("visibility_matrix")
def _matrix(frame, scene, folder):
    return Found({"bits": at.visibility_matrix(scene, sensors_in(frame)).bits}, {})


@finds("viewshed")
def _viewshed(frame, scene, folder):
    exact, close = {}, {}
    asked = {"eye_height": 0.5, "elevation": (-80.0, 60.0), "max_distance": 7.0, "bits": True}
    asked["azimuth"] = 20.0 + frame.north, 250.0 + frame.north
    for name, more in {"flat": {"on_surface": True}, "round": {"curvature": True, "earth_radius": 500.0}}.items():
        found = at.viewshed(scene, sensors_in(frame), frame.of(EYES), **asked, **more)
        exact |= {f"{name} bits": found.bits, f"{name} seen": found.table["seen"]}
        close |= {f"{name} eyes": frame.back(found.observers), f"{name} distance": found.table["distance"]}
    return Found(exact, close)


@finds("visible_share")
def _visible(frame, scene, folder):
    target = frame.of(corners()[0] + (0, 0.25, 0))
    table = at.visible_share(scene, sensors_in(frame), target)
    return Found({"visible": table["visible"]}, {})


@finds("skyline")
def _skyline(frame, scene, folder):
    found = at.skyline(scene, frame.of(EYES), azimuth_step=5.0, north=frame.north)
    return Found({"n": len(found.azimuth)}, {"elevation": found.elevation, "highest": found.highest})


@finds("shadow")
def _shadow(frame, scene, folder):
    place = at.Place(52.0, 4.5, north=frame.north)
    found = at.shadow(scene, at="2026-06-21T15:00", place=place)
    apart = at.shadow(scene, at="2026-06-21T15:00", place=place, per="object", footprints=False)
    cells = at.shadow(scene, at="2026-06-21T15:00", place=place, cell=0.25)
    hours = at.shadow(scene, days="2026-06-21", place=place, cell=0.5, classes=[0, 1, 2, 4, 8])
    exact = {"cells": np.sort(cells.columns["area"]), "classes": hours.columns["hours_from"]}
    exact |= {"hours": np.sort(hours.table["shadow_hours"]), "of classes": hours.columns["area"]}
    return Found(exact, {"area": np.sort(found.columns["area"]), "open ground": apart.columns["area"]})


@finds("from_trees")
def _trees(frame, scene, folder):
    """Crowns have eight sides, so they turn into themselves."""
    feet = frame.of([[3.0, 0, 2.25], [-3.25, 0, 0.5], [0, 0, -2]])
    east, north = feet[:, 0], feet[:, 1] if frame.up == "z" else -feet[:, 2]
    rows = [f"{x:g},{y:g},3,0.75\n" for x, y in zip(east, north)]
    (folder / "trees.csv").write_text("x,y,height,radius\n" + "".join(rows))
    planted = at.from_trees(folder / "trees.csv", transmittance=0.25, trunk_radius=0, scene=scene)
    sensors, place = sensors_in(frame), at.Place(52.0, 4.5, north=frame.north)
    hours = at.sun_hours(planted, sensors, "2026-03-21", place=place)["sun_hours"]
    assert (hours < at.sun_hours(scene, sensors, "2026-03-21", place=place)["sun_hours"]).any()
    shade = at.shadow(planted, surface=scene, days="2026-06-21", place=place, cell=0.5).table["shadow_hours"]
    skyline = at.skyline(planted, frame.of(EYES), azimuth_step=5.0, north=frame.north)
    exact = {"hours": hours, "bits": at.visibility_matrix(planted, sensors).bits, "shade": np.sort(shade)}
    return Found(exact, {"bounds": np.sort(frame.back(planted.bounds), axis=0), "elevation": skyline.elevation})


@finds("changed_scene", "scene_change", "scene_variant")
def _change(frame, scene, folder):
    tower = np.array([[x, y, z] for x in (0.0, 2.0) for y in (0.0, 6.0) for z in (-3.5, -1.5)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))]
    added = at.Scene.from_arrays(frame.of(tower), faces, up=frame.up, name="tower")
    change, place = at.scene_change(scene, added), at.Place(52.0, 4.5, north=frame.north)
    assert at.scene_variant(scene, change.after).notes[0].startswith("variant")
    table = change.compare(at.sun_hours, sensors_in(frame), days="2026-03-21", place=place)
    assert (table["sun_hours_loss"] > 0.0).any() and at.changed_scene(scene, added).n_triangles == len(
        faces
    ) + scene.n_triangles
    return Found({"loss": table["sun_hours_loss"]}, {"bounds": np.sort(frame.back(change.after.bounds), axis=0)})


@finds("pvlib_shading")
def _pvlib(frame, scene, folder):
    times = pandas.date_range("2026-03-21", periods=24, freq="h", tz="UTC")
    place = at.Place(52.0, 4.5, north=frame.north)
    found = at.pvlib_shading(scene, frame.of(EYES), times, samples=1, place=place)
    return Found({"shaded": found["shaded_fraction"].to_numpy()}, {"elevation": found["solar_elevation"].to_numpy()})


@finds("module_shading")
def _modules(frame, scene, folder):
    times, place = (
        pandas.date_range("2026-03-21", periods=24, freq="h", tz="UTC"),
        at.Place(52.0, 4.5, north=frame.north),
    )
    modules = {str(k): at.PvModule(eye, 0.5, 0.25, 30.0, 170.0) for k, eye in enumerate(frame.of(EYES))}
    found = at.module_shading(scene, modules, times, samples=1, place=place)
    return Found({"shaded": found.shaded_fraction}, {"sky": found.sky_view_factor})


@finds("route_shade", "points_along")
def _route(frame, scene, folder):
    place = at.Place(52.0, 4.5, north=frame.north)
    found = at.route_shade(scene, frame.of(EYES), 0.7, "2026-03-21", place=place, step=30.0)
    return Found({"shade": found.shade, "stations": len(found.table)}, {"distance": found.table["distance"]})


@finds("sun_calendar")
def _calendar(frame, scene, folder):
    place = at.Place(52.0, 4.5, north=frame.north)
    found = at.sun_calendar(scene, frame.of(EYES), "2026-03-21", place=place, step=15.0)
    return Found({"hours": found.hours}, {"first": (found.first - found.days).astype(np.int64) // 60})


@finds("sun_hours", "suns_of", "times_of")
def _sun(frame, scene, folder):
    place = at.Place(52.0, 4.5, north=frame.north)
    level = (
        {} if frame.around else {"sky_view": 64}
    )  # the directions of the sky lie on a spiral, which does not turn along
    table = at.sun_hours(scene, sensors_in(frame), "2026-03-21", place=place, energy=True, **level)
    rows = {name: column.values for name, column in table.columns.items()}
    if frame.around:
        rows = {name: values for name, values in rows.items() if "sky" not in name and "diffuse" not in name}
    return Found({name: rows.pop(name) for name in ("sun_hours", "longest", "first", "last")}, rows)


@finds("face_sensors", "vertex_sensors", "grid_sensors", "raster_sensors", "point_sensors")
def _sensors(frame, scene, folder):
    made = {"face": at.face_sensors(scene), "vertex": at.vertex_sensors(scene), "raster": at.raster_sensors(scene, 0.5)}
    made["level"] = at.raster_sensors(scene, 0.5, 1.0, follow=False)
    if not frame.around:  # a grid on a level face follows the first axis of the scene
        made["grid"] = at.grid_sensors(scene, 1.5)
    close = {}
    for name, sensors in made.items():
        rows = np.c_[frame.back(sensors.points), frame.back(sensors.normals), sensors.areas]
        close[name] = rows[np.lexsort(rows.round(6).T)]
    return Found({name: len(sensors) for name, sensors in made.items()}, close)


@finds("virtual_point_lights")
def _virtual(frame, scene, folder):
    sun = at.DirectionalLight(frame.of((1, -2, -1)), 0.0, intensity=2.0)
    found = at.virtual_point_lights(scene, sun, 1024, interleave=False)  # other photons: only their sum is equal
    return Found({}, {"power": float((found.intensities[:, None] * found.colours).sum().round(-1))})


@finds("dataset")
def _dataset(frame, scene, folder):
    import OpenEXR

    cameras, orbit = [camera_in(frame, 16)], 0 if frame.around else 3
    at.dataset(scene, folder, cameras, lights_in(frame)[:3], orbit=orbit, size=(16, 16), spp=4)
    exact = {}
    for path in sorted(folder.rglob("*.exr")):
        with OpenEXR.File(str(path), separate_channels=True) as file:
            exact |= {
                f"{path.name} {name}": channel.pixels
                for name, channel in file.channels().items()
                if name.endswith(("Blocker.X", "Visibility.X", "Triangle.X"))
            }
    assert len(exact) == 7 * (1 + orbit)
    return Found(exact, {})


@finds("bake")
def _bake(frame, scene, folder):
    exact, close = {}, {}
    for what in QUANTITIES:
        both = [SHARP["point"](frame), SHARP["sun"](frame)]
        sharp = {"shadow": both, "sun": both[1], "light": both}.get(what)
        at.bake(scene, folder / "out.glb", what, lights=sharp, attribute="_X", spp=64, keep_hidden=True)
        glb = Glb(folder / "out.glb")
        node = next(i for i, node in enumerate(glb.json["nodes"]) if "mesh" in node)
        points, values = (glb.attribute(name, node) for name in ("POSITION", "_X"))
        values = frame.back(values) if what == "bent-normal" else values  # positions are turned, these in their frame
        exact[f"{what} points"] = frame.back(points + scene.origin)
        if sharp is None:  # directions around normals: other rays
            close[f"{what} mean"] = values.mean(0).round(1)
        else:
            close[what] = values
    return Found(exact, close)


for case in study_cases():

    @finds(case.function)
    def _case(frame, scene, folder, case=case):
        result = case.call(scene)
        return Found(case.exact(result), case.close(result, 1.0))


def same(one: Found, other: Found) -> None:
    for name, values in other.exact.items():
        np.testing.assert_array_equal(values, one.exact[name], err_msg=name)
    for name, values in other.close.items():
        np.testing.assert_allclose(values, one.close[name], rtol=1e-5, atol=2e-6, err_msg=name)


def of_scenes() -> set[str]:
    """The public functions that take a scene."""
    functions = {name: getattr(at, name) for name in at.__all__ if inspect.isfunction(getattr(at, name))}
    return {name for name, function in functions.items() if "scene" in inspect.signature(function).parameters}


def test_each_function_of_a_scene_is_compared():
    assert of_scenes() <= FINDS.keys() | OTHERS.keys() and not FINDS.keys() & OTHERS.keys()


@pytest.mark.parametrize("find", dict.fromkeys(FINDS.values()), ids=lambda find: find.__name__.strip("_"))
def test_jobs_and_pictures(find, tmp_path):
    found = {}
    for name, frame in {"first": FIRST, **TURNS}.items():
        (tmp_path / name).mkdir()
        found[name] = find(frame, scene_in(frame), tmp_path / name)
    first = found.pop("first")
    assert found["upright"].exact.keys() == first.exact.keys() and found["upright"].close.keys() == first.close.keys()
    for other in found.values():
        assert other.exact or other.close
        same(first, other)


@pytest.mark.parametrize("per", ["surface", "facade", "building"])
def test_tables_of_surfaces(per):
    """With the north of the first frame, azimuths of surfaces are those of the turned scene.

    Planar parts are numbered by their coordinates, so their rows are compared by their places.
    """
    tables, order = {}, {}
    for name, frame in {"first": FIRST, **TURNS}.items():
        scene, place = scene_in(frame), at.Place(52.0, 4.5, north=frame.north)
        facing = None if per == "building" else (100.0, 290.0)
        tables[name] = at.sun_hours(scene, "face", "2026-03-21", place=place, per=per, facing=facing, energy=True)
        order[name] = np.lexsort(np.round(frame.back(tables[name].sensors.points), 4).T)
        unturned = at.sun_hours(scene, "face", "2026-03-21", place=place._replace(north=0.0), energy=True)
        turned = at.sun_hours(scene, "face", "2026-03-21", place=place, energy=True)
        steep = np.isfinite(turned["azimuth"])
        shift = (unturned["azimuth"] - turned["azimuth"] - frame.north)[steep]
        assert np.abs((shift + 180.0) % 360.0 - 180.0).max() < 1e-5 and steep.sum() > 10
        assert np.allclose(unturned["tilt"], turned["tilt"])
    first = tables.pop("first")
    assert len(first) > (0 if per == "building" else 3) and first["sun_hours"].max() > 0
    for frame, other in tables.items():
        assert other.columns.keys() == first.columns.keys()
        for name in first.columns.keys() - {"surface", "facade"}:
            mine, its = first[name][order["first"]], other[name][order[frame]]
            if mine.dtype.kind in "fiu":
                np.testing.assert_allclose(its, mine, rtol=1e-6, atol=1e-5, err_msg=name)
            else:
                assert its.tolist() == mine.tolist(), name


def test_skylines_shift_by_a_quarter():
    found = {
        name: at.skyline(scene_in(frame), frame.of(EYES), azimuth_step=5.0, north=0.0)
        for name, frame in {"first": FIRST, **TURNS}.items()
    }
    first = found.pop("first")
    assert np.ptp(first.elevation) > 60
    for name, other in found.items():
        shift = round(TURNS[name].north / 5.0)
        for row in "elevation", "highest":
            turned = np.roll(getattr(first, row), shift, 1)
            np.testing.assert_allclose(getattr(other, row), turned, rtol=1e-5, atol=1e-5)


def test_polygons_of_shadows_turn_along():
    shapely = pytest.importorskip("shapely")
    shapes = []
    for frame in (FIRST, *TURNS.values()):
        place = at.Place(52.0, 4.5, north=frame.north)
        found = at.shadow(scene_in(frame), at="2026-06-21T15:00", place=place, plane=0.0)
        shape = shapely.union_all(found.polygons)
        shapes.append(shapely.affinity.rotate(shape, -frame.around, origin=(0, 0)))
    assert shapes[0].area > 10 and not shapes[0].equals_exact(
        shapely.affinity.rotate(shapes[0], 90, origin=(0, 0)), 0.1
    )
    for other in shapes[1:]:
        assert shapes[0].symmetric_difference(other).area < 1e-4


def test_view_factors_are_equal_within_their_errors():
    found = [at.view_factors(scene_in(frame), "object", samples=1 << 16) for frame in (FIRST, *TURNS.values())]
    by_face = [at.view_factors(scene_in(frame), "face", samples=1 << 12) for frame in (FIRST, *TURNS.values())]
    for first, *others in (found, by_face):
        assert ((first.matrix.toarray() > 0.05) & (first.matrix.toarray() < 0.95)).sum() > 1
        for other in others:
            apart = np.abs((first.matrix - other.matrix).toarray())
            sigma = np.sqrt((first.errors.power(2) + other.errors.power(2)).toarray())
            assert (apart <= 6.0 * sigma + 3.0 / first.about["samples"]).all()


LEAVES = [0.75, 0.625, 0.5, 0.375, 0.25, 0.25, 0.25, 0.25, 0.375, 0.5, (0.5, 0.75, 1.0), 0.75]


@pytest.mark.parametrize("share", [0.5, (0.75, 0.5, 0.25), LEAVES], ids=["grey", "coloured", "months"])
def test_hours_through_leaves(share):
    """The place of the scene turns along, and so do its suns."""
    found = {}
    for name, frame in {"first": FIRST, **TURNS}.items():
        scene, sensors = scene_in(frame), sensors_in(frame)
        opaque = at.sun_hours(scene, sensors, "2026-03-21", place=at.Place(52.0, 4.5, north=frame.north))
        scene = scene_in(frame)
        scene.set_transmittance({"blocks": share})
        place = at.Place(52.0, 4.5, north=frame.north)
        table = at.sun_hours(scene, sensors, "2026-03-21,2026-11-21", place=place, energy=True, by=["month"])
        assert (table["hours_mar"] > opaque["sun_hours"]).sum() > 5
        rows = {name: column.values for name, column in table.columns.items()}
        close = {name: rows.pop(name) for name in ("direct_kwh_m2", "sun_share")}
        found[name] = Found(rows, close)
    first = found.pop("first")
    for other in found.values():
        same(first, other)


@pytest.mark.parametrize("frame", TURNS.values(), ids=TURNS)
@pytest.mark.parametrize("kind", SOFT)
def test_soft_lights_differ_by_their_noise_alone(kind, frame, tmp_path):
    one, other = (at.render(scene_in(f), camera_in(f), SOFT[kind](f), spp=64) for f in (FIRST, frame))
    assert ((one.visibility[0] > 0.02) & (one.visibility[0] < 0.98)).any()
    for a, b in ((one.visibility[0], other.visibility[0]), (one.image, other.image)):
        assert np.abs(a - b).mean() < 0.03 * a.mean() and abs(a.mean() - b.mean()) < 0.002 * a.mean()
    what = {"wide sun": "sun", "ambient": "ao"}.get(kind, "light")
    means = []
    for f in (FIRST, frame):
        more = {"radius": 2.0} if what == "ao" else {"lights": SOFT[kind](f)}
        means.append(at.bake(scene_in(f), tmp_path / "out.glb", what, attribute="_X", spp=256, **more).mean)
    assert means[0] > 0.0 and abs(means[0] - means[1]) < 0.01 * means[0]


def test_defaults_follow_the_up_axis():
    one, other = (scene_in(f) for f in (FIRST, UPRIGHT))
    close = lambda a, b: np.testing.assert_allclose(UPRIGHT.back(b), a, atol=1e-12)
    for kind in KINDS:
        a, b = (scene.default_camera(64, 32, kind) for scene in (one, other))
        close(a.frame, b.frame)
        close(a.position, b.position)
        assert a.extent == pytest.approx(b.extent)
    (sun, sky), (other_sun, other_sky) = (scene.default_lights() for scene in (one, other))
    close(sun.direction, other_sun.direction)
    close(sky.points, other_sky.points)
    close(one.default_light().corner, other.default_light().corner)
    assert one.ground_height() == other.ground_height()


def triple(frame: Turned, vector) -> str:
    return ",".join(f"{x:g}" for x in frame.of(vector))


SUN, SIZE = (1, -2, -1), ("--size", "32x32")
COMMANDS = {
    "render": lambda f: ["-o", "out.png", *SIZE, "--light", f"sun:{triple(f, SUN)}:0"],
    "sun": lambda f: ["-o", "out.csv", "--latitude", 52, "--longitude", 4.5, "--days", "2026-03-21"],
    "bake": lambda f: ["-o", "out.glb", "--what", "sun", "--light", f"sun:{triple(f, SUN)}:0", "--spp", 4],
    "los": lambda f: ["--from", triple(f, EYES[0]), "--to", triple(f, (0.0, 0.5, -2.5))],
    "viewshed": lambda f: ["-o", "out.csv", "--observer", triple(f, EYES[0])],
    "matrix": lambda f: ["-o", "out.npy"],
    "visible": lambda f: ["-o", "out.csv", "--turbine", triple(f, EYES[0]), "--hub-height", 2, "--rotor", 1],
    "skyline": lambda f: ["-o", "out.csv", "--point", triple(f, EYES[0])],
    "shadow": lambda f: [
        "-o",
        "out.gpkg",
        "--at",
        "2026-06-21T15:00",
        "--latitude",
        52,
        "--longitude",
        4.5,
        "--north",
        f.north,
    ],
    "dataset": lambda f: ["-o", f"data-{f.up}", "--orbit", 2, "--spp", 4, *SIZE, "--light", f"sun:{triple(f, SUN)}:0"],
    "build": lambda f: ["-o", f"{f.up}.antumbra"],
    "info": lambda f: [],
    "culling": lambda f: ["-o", "out.png", *SIZE, "--light", f"sun:{triple(f, SUN)}:0"],
    "explain": lambda f: ["-o", "out.png", *SIZE, "--light", f"sun:{triple(f, SUN)}:0"],
    "compare": lambda f: [
        *SIZE,
        "--spp",
        4,
        "--light",
        f"sun:{triple(f, SUN)}:0",
        "--plan",
        "bsah+single",
        "--plan",
        "bsah+wide",
    ],
}
_PLACED = "--latitude", 52, "--longitude", 4.5, "--days", "2026-06-21"


def points_file(frame: Turned) -> str:
    """Write the eyes as a table."""
    rows = [f"{triple(frame, eye)}\n" for eye in EYES]
    Path("eyes.csv").write_text("x,y,z\n" + "".join(rows))
    return "eyes.csv"


COMMANDS |= {
    "pv": lambda f: ["-o", "out.csv", "--modules", points_file(f), *_PLACED, "--north", f.north, "--samples", 1],
    "route": lambda f: ["-o", "out.csv", "--line", points_file(f), "--spacing", 1, *_PLACED, "--north", f.north],
    "calendar": lambda f: ["-o", "out.csv", "--points", points_file(f), *_PLACED, "--north", f.north, "--step", 20],
}
COMMANDS |= {case.command: lambda f, case=case: case.words for case in study_cases() if case.command}
"""Command -> its arguments in a frame. Pages of `view` are those of render."""

NUMBERS = {
    "render": ["rays"], "sun": ["suns", "hours", "rays", "means"], "bake": ["receivers", "rays", "mean"],
    "los": ["pairs", "visible"], "viewshed": ["seen", "area", "area_seen"], "matrix": ["visible"],
    "pv": ["modules", "times"], "route": ["stations", "shade"], "calendar": ["points", "hours"],
    "visible": ["sensors"], "skyline": ["points", "azimuths"], "shadow": ["polygons"],
    "dataset": ["frames", "lights", "rendered"],
    "build": ["triangles", "chunks", "bytes"], "info": ["triangles"],
    "culling": ["kept", "marked"], "explain": ["rays", "blocked"], "compare": ["rays"],
}  # fmt: skip
NUMBERS |= {case.command: case.numbers for case in study_cases() if case.command}
"""Command -> numbers of its answer that do not depend on the frame. Tests of boxes do."""


def test_each_command_with_an_up_axis_is_compared():
    commands = typer.main.get_command(program()).commands
    turning = {name for name, command in commands.items() if any("--up" in p.opts for p in command.params)}
    assert turning - {"page", "view"} == COMMANDS.keys()


@pytest.mark.parametrize("command", COMMANDS)
def test_commands(command, cli, tmp_path):
    answers, pictures = [], []
    for frame in (FIRST, UPRIGHT):
        points, faces = corners()
        lines = [f"v {x:g} {y:g} {z:g}\n" for x, y, z in frame.of(points)]
        lines += [f"f {a} {b} {c}\n" for a, b, c in faces + 1]
        (tmp_path / "scene.obj").write_text("".join(lines))
        answers.append(cli(command, "scene.obj", "--up", frame.up, *COMMANDS[command](frame), "--json").json())
        pictures += [np.asarray(Image.open(path).convert("RGB"), float) for path in tmp_path.glob("out.png")]
    one, other = ([answer.get(name) for name in NUMBERS[command]] for answer in answers)
    assert one == other and None not in one
    if command == "render":
        assert np.ptp(pictures[0]) > 100 and np.abs(pictures[0] - pictures[1]).max() <= 1.0
