"""A library call prints nothing when nobody watches."""

import inspect
import subprocess
import sys

import pytest

import antumbra as at
import city_files
from antumbra.base import progress
from antumbra.base.progress import show_progress
from study_cases import study_cases
from terminal import Terminal

CALLS = {
    "area_sensors": "at.area_sensors(scene, [[(-1, -1), (1, -1), (1, 1)]])",
    "bake": "at.bake(scene, 'baked.glb', spp=16)",
    "build_store": "at.build_store(scene, 'scene.antumbra')",
    "dataset": "at.dataset(scene, 'frames', random=1, size=(16, 16), spp=1)",
    "face_sensors": "at.face_sensors(scene)",
    "from_footprints": "at.from_footprints(houses, 3.0)",
    "from_raster": "at.from_raster((np.eye(3), (1, 0, 0, 0, -1, 0)))",
    "from_trees": "at.from_trees('trees.csv', scene=scene, base=0.0)",
    "grid_sensors": "at.grid_sensors(scene, 2.0)",
    "line_of_sight": "at.line_of_sight(scene, (0, 1, 0), (0, 2, 0))",
    "load": "at.load('scene.antumbra').closest_hit((0, 1, 0), (0, -1, 0))",
    "before_and_after": "at.before_and_after(*[at.sky_view(scene, [(0, 1, 0)], directions=16)] * 2)",
    "changed_scene": "at.changed_scene(scene, scene)",
    "scene_variant": "at.scene_variant(scene, scene)",
    "scene_change": "at.scene_change(scene, scene).compare(at.sky_view, at.point_sensors([(0, 1, 0)]), directions=16)",
    "place_of": "at.place_of(scene, latitude=52.0, longitude=4.4)",
    "point_sensors": "at.point_sensors([(0, 1, 0)])",
    "points_along": "at.points_along([(0, 0), (9, 0)], 2.0)",
    "polygon_points": "at.polygon_points([(0, 0, 0), (2, 0, 0), (0, 2, 0)], 0.5)",
    "procedural": "at.procedural('atrium', triangles=1000)",
    "pvlib_shading": "at.pvlib_shading(scene, (0, 1, 0), index, place=at.Place(52.0, 4.4))",
    "raster_sensors": "at.raster_sensors(scene, 2.0)",
    "render": "at.render(scene, camera, spp=1).save('picture.png')",
    "sensors_of": "at.sensors_of('face', scene)",
    "shadow": "at.shadow(scene, at='2026-06-21T12:00', place=at.Place(52.0, 4.4)).save('shadow.gpkg')",
    "sky_view": "at.sky_view(scene, directions=16)",
    "skyline": "at.skyline(scene, (0, 1, 0)).save('skyline.csv')",
    "module_shading": "at.module_shading(scene, at.PvModule((0, 1, 0)), index, place=at.Place(52.0, 4.4))",
    "route_shade": "at.route_shade(scene, [(0, 1, 0), (2, 1, 0)], 1.0, '2026-06-21', place=at.Place(52.0, 4.4))",
    "sun_calendar": "at.sun_calendar(scene, (0, 1, 0), '2026-06-21', place=at.Place(52.0, 4.4)).save('c.csv')",
    "sun_hours": "at.sun_hours(scene, 'face', '2026-06-21', place=at.Place(52.0, 4.4), matrix='sun.npy')",
    "suns_of": "at.suns_of(at.Place(52.0, 4.4), times, scene.up)",
    "surface_points": "at.surface_points(scene, 2.0)",
    "times_of": "times",
    "trimesh_nearest": "at.trimesh_nearest(trimesh.creation.box()).on_surface([(0, 1, 0)])",
    "trimesh_ray": "at.trimesh_ray(trimesh.creation.box()).intersects_any([(0, 1, 0)], [(0, -1, 0)])",
    "use_in_trimesh": "at.use_in_trimesh().undo()",
    "vertex_sensors": "at.vertex_sensors(scene)",
    "view": "at.view(scene, port=0, browser=False).close()",
    "viewshed": "at.viewshed(scene, at.raster_sensors(scene, 2.0), (0, 1, 0)).table.save('seen.csv')",
    "virtual_point_lights": "at.virtual_point_lights(scene, light, 8)",
    "visibility": "at.visibility(scene, (0, 1, 0), light)",
    "visibility_matrix": "at.visibility_matrix(scene, at.face_sensors(scene).part(0, 64), output='matrix.npy')",
    "visible_share": "at.visible_share(scene, [(0, 1, 0)], at.Turbine((0, 0, 9), 4, 2))",
    "write_attributes": "at.write_attributes('a.city.json', 'out.json', {'hours': np.zeros(12)})",
}
"""A call of each public function; `load` comes after `build_store`."""
CALLS |= {case.function: f"at.{case.function}(scene, **{case.keywords!r}).save('study.csv')" for case in study_cases()}

PRELUDE = """
from datetime import UTC, date
import warnings
import geopandas
import numpy as np
import pandas
import shapely
import trimesh
import antumbra as at
warnings.simplefilter("ignore", UserWarning)  # notes about the scene and the points
index = pandas.date_range("2026-06-21", periods=4, freq="6h", tz="UTC")
scene = at.procedural("atrium", triangles=1000)
camera, light = scene.cameras[0].resized(16, 16), at.PointLight((0, 2, 0))
houses = geopandas.GeoDataFrame(geometry=[shapely.box(0, 0, 1, 1)])
times = at.times_of([date(2026, 6, 21)], UTC, 240)
"""


def test_every_public_function_has_a_call():
    functions = {name for name in at.__all__ if inspect.isfunction(getattr(at, name))}
    assert functions == set(CALLS)


def test_the_library_is_silent(tmp_path):
    city_files.put(tmp_path, city_files.city({"a": city_files.building(city_files.solid())}))
    (tmp_path / "trees.csv").write_text("x,y,height,radius\n0,0,2,1\n")
    program = PRELUDE + "\n".join(CALLS.values())
    ran = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert (ran.returncode, ran.stdout, ran.stderr) == (0, "", ""), ran.stderr


def test_the_log_tells_begin_and_end_and_the_callers_function_tells_the_rest(caplog):
    scene, calls = at.procedural("atrium", triangles=1000), []
    with caplog.at_level("INFO", "antumbra"):
        at.line_of_sight(scene, (0, 1, 0), (0, 2, 0), progress=lambda *what: calls.append(what))
    begin, end = caplog.messages
    assert begin == "1 line of sight ..." and end.startswith("1 line of sight: ")
    assert calls[-1] == ("1 line of sight", 1, 1)


@pytest.mark.parametrize(
    "name", [name for name in CALLS if "progress" in inspect.signature(getattr(at, name)).parameters]
)
def test_progress_is_a_function_or_a_bool(name):
    parameters = inspect.signature(getattr(at, name)).parameters.values()
    positional = [each for each in parameters if each.kind == each.POSITIONAL_OR_KEYWORD and each.name != "progress"]
    with pytest.raises(at.InputError, match="progress is 'no'; it must be a function, True, False or None"):
        getattr(at, name)(*[None] * len(positional), progress="no")


def test_false_silences_what_is_called_too(monkeypatch):
    monkeypatch.setattr(sys, "stderr", Terminal())

    @progress.with_quiet_progress
    def work(progress=None):
        with show_progress("a", progress) as report:
            return progress, report is None

    assert [work(progress=value) for value in (False, True, None)] == [(False, True), (None, False), (None, False)]
