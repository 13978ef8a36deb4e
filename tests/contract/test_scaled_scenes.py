"""The same scene in metres, feet, millimetres and a CRS in feet, and turned: every job finds the same physical results.

Lengths are in the unit of the scene, areas in square metres, and energies in kWh. With a unit of half a metre, numbers
are scaled by a power of two, so even the bits are equal.
"""

import csv
import inspect
import json
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas
import pytest

import antumbra as at
from antumbra.scene.units import LengthUnit
from baked_files import Glb, box
from study_cases import study_cases

ORIGIN = (85_000.0, 447_000.0)  # metres
PLACE = at.Place(52.0, 4.36, timezone="Europe/Amsterdam")
DAY = "2026-03-21"


class Scaled(NamedTuple):
    """A frame of the scene: its unit, and whether it is turned by a quarter about the vertical."""

    unit: LengthUnit
    turned: bool = False

    def of(self, points) -> np.ndarray:
        """Points in metres, in the frame."""
        x, y, z = np.moveaxis(np.asarray(points, float), -1, 0)
        return np.stack([-y, x, z] if self.turned else [x, y, z], -1) / self.unit.metres

    def length(self, metres: float) -> float:
        return metres / self.unit.metres

    @property
    def place(self) -> at.Place:
        return PLACE._replace(north=-90.0 if self.turned else 0.0)


METRES = Scaled(LengthUnit("m", 1.0))
FRAMES = {
    "half metres": Scaled(LengthUnit("half metre", 0.5)),
    "feet": Scaled(LengthUnit("ft", 0.3048)),
    "survey feet": Scaled(LengthUnit("us-ft", 1200.0 / 3937.0)),
    "millimetres": Scaled(LengthUnit("mm", 0.001)),
    "turned": Scaled(LengthUnit("m", 1.0), True),
    "turned feet": Scaled(LengthUnit("ft", 0.3048), True),
}

BLOCKS = {
    "ground": ((-30, -32, -0.25), (30, 28, 0)),
    "house": ((0.25, 0, 0), (10, 8, 6)),
    "tower": ((-4, -15, 0), (14, -12, 20)),
    "paving": ((0, 10, 0), (10, 20, 0.125)),
    "canopy": ((-20, 3, 2.5), (-14, 9, 2.75)),
}
EYES = np.array([[-20.0, -25.0, 1.75], [5.25, 4.125, 8.0], [25.0, 20.0, 1.75]])
GARDEN = np.array([[-5.0, 9.0], [15.0, 9.0], [15.0, 25.0], [-5.0, 25.0]])


def corners_in(frame: Scaled) -> np.ndarray:
    parts = [box(*BLOCKS[name]) for name in BLOCKS]
    return frame.of(np.concatenate([np.asarray(points, float)[faces] for points, faces in parts]))


def scene_in(frame: Scaled) -> at.Scene:
    return at.Scene.from_arrays(corners_in(frame), up="z", unit=frame.unit, name="blocks")


def points_in(frame: Scaled) -> at.Sensors:
    """Points on roofs and the ground."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.linspace(-27, 27, 8) + 0.375, np.linspace(-28, 24, 7) + 0.125))
    inside = (x > -0.5) & (x < 10.5) & (y > -0.5) & (y < 8.5)
    return at.point_sensors(frame.of(np.stack([x, y, np.where(inside, 6.5, 0.5)], 1)))


FINDS = {}
"""Name of a public function -> ``(frame, scene) -> (exact results, close results)``, in metres, m2 and kWh."""

OTHERS = {
    "build_store": "keeps the unit, as the tests of units find",
    "dataset": "pictures",
    "from_trees": "lengths of its table are in world units",
    "place_of": "of a CRS, whose tests have feet",
    "render": "pictures",
    "sensors_of": "text for the sensors below",
    "view": "pictures",
    "virtual_point_lights": "pictures",
    "visibility": "which points see which lights, in world units",
}


def finds(*names):
    def keep(function):
        FINDS.update(dict.fromkeys(names, function))
        return function

    return keep


@finds("sun_hours")
def _sun(frame, scene):
    table = at.sun_hours(scene, points_in(frame), DAY, place=frame.place, step=15)
    roofs = at.sun_hours(scene, "face", DAY, place=frame.place, energy=True, per="building")
    assert roofs.columns["direct_kwh"].unit == "kWh" and roofs.about["length_unit"] == frame.unit.name
    energy = {name: roofs[name] for name in ("direct_kwh", "direct_kwh_m2", "sun_hours")}
    return {"hours": table["sun_hours"], "longest": table["longest"]}, energy


@finds("changed_scene", "scene_change", "scene_variant")
def _change(frame, scene):
    points, faces = box((20, -10, 0), (24, -6, 30))
    tower = at.Scene.from_arrays(frame.of(np.asarray(points, float)), faces, up="z", unit=frame.unit, name="tower")
    change = at.scene_change(scene, tower)
    assert at.scene_variant(scene, change.after).after.unit.name == frame.unit.name
    table = change.compare(at.sun_hours, points_in(frame), days=DAY, place=frame.place, step=15)
    assert (table["sun_hours_loss"] > 0.0).any() and at.changed_scene(scene, tower).unit.name == frame.unit.name
    return {"loss": table["sun_hours_loss"]}, {}


@finds("area_sensors")
def _areas(frame, scene):
    ring = frame.of(np.c_[GARDEN, np.zeros(4)])[:, :2]
    table = at.sun_hours(scene, None, areas={"garden": ring}, place=frame.place, rule="br209-amenity")
    again = at.area_sensors(scene, {"garden": ring})
    (area,) = table.about["areas"]
    heights = np.unique((again.points[:, 2] * frame.unit.metres).round(6))
    exact = {name: area[name] for name in ("cells", "left_out", "passes")} | {"again": len(again), "heights": heights}
    return exact, {"share": area["share"], "hours": area["sun_hours"]}


@finds("sky_view")
def _sky(frame, scene):
    if frame.turned:  # the directions of the sky lie on a spiral, which does not turn along
        return {}, {}
    table = at.sky_view(scene, points_in(frame), directions=256)
    return {"share": table["sky_share"]}, {"view": table["sky_view"]}


@finds("shadow")
def _shadow(frame, scene):
    more = {"place": frame.place, "casters": "blocks"}
    found = at.shadow(scene, at="2026-03-21T15:00", **more)
    hours = at.shadow(scene, days=DAY, place=frame.place, step=60, classes=[0, 1, 4])
    assert found.about["length_unit"] == hours.about["length_unit"] == frame.unit.name
    classes = dict(zip(hours.columns["hours_from"], hours.columns["area"]))
    return {"classes": list(classes)}, {"area": found.area, "areas": list(classes.values())}


@finds("skyline")
def _skyline(frame, scene):
    found = at.skyline(scene, frame.of(EYES), azimuth_step=5.0, north=frame.place.north)
    return {}, {"elevation": found.elevation, "highest": found.highest}


@finds("viewshed")
def _viewshed(frame, scene):
    exact, close = {}, {}
    for name, more in {"flat": {}, "round": {"curvature": True, "refraction": -0.9}}.items():
        asked = {"max_distance": frame.length(40.0), "bits": True, **more}
        found = at.viewshed(scene, points_in(frame), frame.of(EYES), **asked)
        assert found.table.columns["distance"].unit == frame.unit.name
        exact[name] = found.bits
        close[name] = found.table["distance"] * frame.unit.metres
    return exact, close


@finds("visibility_matrix")
def _matrix(frame, scene):
    return {"bits": at.visibility_matrix(scene, points_in(frame)).bits}, {}


@finds("visible_share", "surface_points")
def _visible(frame, scene):
    turbine = at.Turbine(frame.of([20.0, -28.0, 0.0]), frame.length(25.0), frame.length(12.0))
    of_facade = at.surface_points(scene, frame.length(2.1))
    close = {} if frame.turned else {"rotor": at.visible_share(scene, points_in(frame), turbine, samples=16)["share"]}
    close |= {"area": of_facade.areas.sum() * frame.unit.square_metres}
    return {"facade": len(of_facade)} if not frame.turned else {}, close


@finds("line_of_sight")
def _lines(frame, scene):
    found = at.line_of_sight(scene, frame.of(EYES)[:, None], points_in(frame).points)
    metres = frame.unit.metres
    return {"visible": found.visible}, {"length": found.length * metres, "distance": found.distance * metres}


@finds("bake")
def _bake(frame, scene):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "out.glb"
        at.bake(scene, path, "ao", radius=frame.length(15.0), attribute="_AO", spp=16, keep_hidden=True)
        glb = Glb(path)
        node = next(i for i, node in enumerate(glb.json["nodes"]) if "mesh" in node)
        values, bounds = glb.attribute("_AO", node), at.load(path).bounds
    size = np.ptp(bounds, axis=0)
    if frame.turned:  # directions around normals do not turn along
        return {}, {"size": size[[2, 1, 0]]}
    return {"n": len(values)}, {"values": values, "size": size}


@finds("pvlib_shading")
def _pvlib(frame, scene):
    times = pandas.date_range(DAY, periods=24, freq="h", tz="UTC")
    found = at.pvlib_shading(scene, frame.of(EYES), times, samples=1, place=frame.place)
    return {"shaded": found["shaded_fraction"].to_numpy()}, {"sky": found["sky_view_factor"].to_numpy()}


@finds("module_shading")
def _modules(frame, scene):
    times, size = pandas.date_range(DAY, periods=24, freq="h", tz="UTC"), (frame.length(2.0), frame.length(1.0))
    modules = {str(k): at.PvModule(at_eye, *size, 30.0, 170.0) for k, at_eye in enumerate(frame.of(EYES))}
    found = at.module_shading(scene, modules, times, samples=1, place=frame.place)
    return {"shaded": found.shaded_fraction}, {"sky": found.sky_view_factor}


@finds("route_shade")
def _route(frame, scene):
    found = at.route_shade(scene, frame.of(EYES), frame.length(7.0), DAY, place=frame.place, step=30.0)
    metres = frame.unit.metres
    close = {"shade": found.shade, "at": found.table["distance"] * metres}
    return {"stations": len(found.table)}, {"length": found.table["length"] * metres, **close}


@finds("sun_calendar")
def _calendar(frame, scene):
    found = at.sun_calendar(scene, frame.of(EYES), DAY, place=frame.place, step=15.0)
    seconds = (found.first - found.days).astype(np.int64), (found.last - found.days).astype(np.int64)
    return {"hours": found.hours}, {"first": seconds[0] // 60, "last": seconds[1] // 60}


@finds("face_sensors", "vertex_sensors", "grid_sensors", "raster_sensors")
def _sensors(frame, scene):
    made = {"face": at.face_sensors(scene), "vertex": at.vertex_sensors(scene)}
    made["raster"] = at.raster_sensors(scene, frame.length(1.0))
    return {n: len(s) for n, s in made.items()}, {n: s.areas.sum() * frame.unit.square_metres for n, s in made.items()}


for case in study_cases():

    @finds(case.function)
    def _case(frame, scene, case=case):
        result = case.call(scene)
        return case.exact(result), case.close(result, frame.unit.metres)


def test_each_function_of_a_scene_is_compared():
    functions = {name: getattr(at, name) for name in at.__all__ if inspect.isfunction(getattr(at, name))}
    of_scenes = {name for name, function in functions.items() if "scene" in inspect.signature(function).parameters}
    assert of_scenes <= FINDS.keys() | OTHERS.keys() and not FINDS.keys() & OTHERS.keys()


@pytest.fixture(scope="module")
def in_metres():
    """The results in metres, of each function once."""
    return {find: find(METRES, scene_in(METRES)) for find in dict.fromkeys(FINDS.values())}


@pytest.mark.parametrize("name", FRAMES)
@pytest.mark.parametrize("find", dict.fromkeys(FINDS.values()), ids=lambda find: find.__name__.strip("_"))
def test_jobs_find_the_same_in_every_unit(find, name, in_metres):
    frame = FRAMES[name]
    exact, close = find(frame, scene_in(frame))
    first_exact, first_close = in_metres[find]
    assert first_exact or first_close
    for key, values in exact.items():
        np.testing.assert_array_equal(values, first_exact[key], err_msg=key)
    for key, values in close.items():
        if name == "half metres":
            np.testing.assert_array_equal(values, first_close[key], err_msg=key)
        else:
            np.testing.assert_allclose(values, first_close[key], rtol=2e-5, atol=2e-5, err_msg=key)


# --- Closed forms -----------------------------------------------------------------------------------------------------


def test_the_energy_of_a_roof_in_feet_is_that_of_929_square_metres():
    square = np.array([[0.0, 0, 60], [100, 0, 60], [100, 100, 60], [0, 100, 60]])
    for crs, foot, origin in ("EPSG:2263", 1200.0 / 3937.0, (985320.0, 219464.0, 0.0)), (None, 0.3048, (0.0, 0.0, 0.0)):
        unit = None if crs else "ft"
        roof = at.Scene.from_arrays(square + origin, [[0, 1, 2], [0, 2, 3]], up="z", crs=crs, unit=unit)
        table = at.sun_hours(roof, "face", "2026-06-21", place=PLACE, energy=True, per="building")
        area = table["direct_kwh"] / table["direct_kwh_m2"]
        assert area == pytest.approx((100.0 * foot) ** 2, rel=1e-12) and round(area[0], 2) == 929.03
        factors = at.view_factors(roof, "object", samples=64)
        assert factors.areas == pytest.approx((100.0 * foot) ** 2, rel=1e-6)


@pytest.mark.parametrize("frame", FRAMES.values(), ids=FRAMES)
def test_the_shadow_of_a_tower_has_the_area_of_its_width_times_its_length(frame):
    """A tower of a x b and the height h casts a shadow of a b + h cot(e) (a |cos s| + b |sin s|)."""
    points, faces = box((0, 0, 0), (10, 6, 20))
    scene = at.Scene.from_arrays(frame.of(points), faces, up="z", unit=frame.unit)
    found = at.shadow(scene, at="2026-03-21T15:00", place=frame.place, plane=0.0)
    elevation, azimuth = (np.radians(found.about[f"sun_{name}"]) for name in ("elevation", "azimuth"))
    across = 10.0 * abs(np.cos(azimuth)) + 6.0 * abs(np.sin(azimuth))
    assert found.area == pytest.approx(60.0 + 20.0 / np.tan(elevation) * across, rel=1e-6)


# --- Commands ---------------------------------------------------------------------------------------------------------


def write_obj(path, frame: Scaled) -> None:
    lines, start = [], 1
    for name, ends in BLOCKS.items():
        points, faces = box(*ends)
        lines += [f"o {name}", *("v {:.9f} {:.9f} {:.9f}".format(*point) for point in frame.of(points))]
        lines += ["f {} {} {}".format(*(start + face)) for face in np.asarray(faces)]
        start += len(points)
    path.write_text("\n".join(lines) + "\n")


@pytest.mark.parametrize("form", ["option", "text"])
def test_commands_take_the_unit_of_a_file(cli, tmp_path, form):
    """Gardens, energies and default cells of a file in millimetres are those of the file in metres."""
    answers = {}
    for unit, frame in ("m", METRES), ("mm", FRAMES["millimetres"]):
        write_obj(tmp_path / f"{unit}.obj", frame)
        ring = frame.of(np.c_[GARDEN, np.zeros(4)])[:, :2].tolist()
        shape = {"type": "Polygon", "coordinates": [[*ring, ring[0]]]}
        (tmp_path / "g.json").write_text(
            json.dumps({"type": "Feature", "properties": {"name": "a"}, "geometry": shape})
        )
        scene = [f"{unit}.obj?unit={unit}"] if form == "text" else [f"{unit}.obj", "--unit", unit]
        place = ["--up", "z", "--latitude", "52", "--longitude", "4.36", "--json"]
        garden = cli("sun", *scene, *place, "--rule", "br209-amenity", "--areas", "g.json", "-o", "a.csv").json()
        cli("sun", *scene, *place, "--days", DAY, "--energy", "--per", "building", "-o", "b.csv").json()
        with open(tmp_path / "b.csv") as file:
            energy = [float(row["direct_kwh"]) for row in csv.DictReader(file)]
        shadow = cli("shadow", *scene, *place, "--at", "2026-03-21T15:00", "-o", "a.gpkg").json()
        seen = cli(
            "viewshed", *scene, "--up", "z", "--observer", ",".join(map(str, frame.of(EYES[0]))), "--json"
        ).json()
        assert garden["length_unit"] == unit and cli("info", *scene, "--json").json()["unit"] == unit
        answers[unit] = garden["areas"], energy, shadow["area"], seen["area"], seen["area_seen"]
    (areas, energy, *rest), (areas_mm, energy_mm, *rest_mm) = answers["m"], answers["mm"]
    assert areas == areas_mm and areas[0]["cells"] == 1280 and sum(energy) > 1000.0
    assert energy == pytest.approx(energy_mm, rel=1e-5) and rest == pytest.approx(rest_mm, rel=1e-5)


def test_a_unit_is_given_once_and_known(cli, tmp_path):
    write_obj(tmp_path / "a.obj", METRES)
    cli("info", "a.obj", "--unit", "fathom").refused("unit is 'fathom'; it must be one of m, mm")
    cli("info", "a.obj?unit=mm", "--unit", "mm").refused("unit is empty or repeated; write FILE?unit=UNIT")
    cli("info", "a.obj?unit=").refused("unit is empty or repeated")
    cli("info", "procedural:atrium", "--unit", "ft").refused("--unit ft is for files", "leave it out")
    answer = cli("info", "a.obj?cutouts=off&unit=ft", "--json").json()
    assert answer["unit"] == "ft"
