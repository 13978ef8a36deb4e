"""Everything that the library gives can be pickled, for worker processes."""

import pickle

import numpy as np
import pytest

import antumbra as at


@pytest.fixture(scope="module")
def things(tmp_path_factory):
    pandas = pytest.importorskip("pandas")
    scene = at.procedural("atrium", triangles=1000)
    path = tmp_path_factory.mktemp("pickles") / "a.antumbra"
    report = at.build_store(scene, path)
    store, light, camera = at.load(path), at.PointLight((0, 2, 0)), scene.cameras[0].resized(16, 16)
    some, place = at.face_sensors(scene).part(0, 8), at.Place(52.0, 4.4)
    table = at.sun_hours(scene, some, "2026-06-21", place=place, step=240)
    given = [scene, store, report, light, camera, some, place, table, table.columns["sun_hours"]]
    given += [at.Sky(), at.AmbientOcclusion(), at.PointLights([(0, 1, 0)]), at.DirectionalLights([(0, -1, 0)])]
    given += [at.DirectionalLight((0, -1, 0)), at.SphereLight((0, 2, 0), 0.1), at.DiskLight((0, 2, 0), (0, -1, 0), 0.1)]
    given += [at.QuadLight((0, 2, 0), (1, 0, 0), (0, 0, 1)), at.Plan(), at.SrdhRays()]
    given += [at.RenderOptions(), scene.objects[0]]
    given += [at.render(each, camera, light, spp=1) for each in (scene, store)]
    given += [each.closest_hit((0, 1, 0), (0, -1, 0)) for each in (scene, store)]
    given += [scene.all_hits((0, 1, 0), (0, -1, 0)), scene.closest_points((0, 1, 0))]
    given += [at.visibility(scene, (0, 1, 0), light), at.line_of_sight(scene, (0, 1, 0), (0, 2, 0))]
    given += [at.viewshed(scene, some, (0, 1, 0)), at.visibility_matrix(scene, some), scene.triangles()]
    given += [at.Turbine((0, 0, 0), 2.0, 1.0), at.points_along([(0, 0), (1, 0)], 0.5)]
    given += [at.view_factors(scene, "object", samples=64), at.scene_change(scene, scene)]
    given += [at.Renderer(scene), at.raster_sensors(scene, 2.0), at.raster_sensors(scene, 2.0).raster]
    given += [
        scene.unit,
        at.skyline(scene, (0, 1, 0), azimuth_step=30.0),
        at.shadow(scene, at="2026-06-21T12:00", place=place),
    ]
    module, index = at.PvModule((0, 1, 0)), pandas.date_range("2026-06-21", periods=4, freq="6h", tz="UTC")
    given += [module, at.module_shading(scene, module, index, place=place), at.Sheet(project="a")]
    given += [at.sun_calendar(scene, (0, 1, 0), "2026-06-21", place=place)]
    given += [at.route_shade(scene, [(0, 1, 0), (2, 1, 0)], 1.0, "2026-06-21", place=place)]
    given += [at.Engine(scene, "bsah+single"), at.Receivers.in_space(np.zeros((1, 3)), scene.origin)]
    return {type(each).__name__: each for each in given}


LEFT_OUT = {
    "Baked",
    "CityModel",
    "Dataset",
    "GBuffer",
    "InputError",
    "Light",
    "MeshInfo",
    "Suns",
    "UnavailableError",
    "Viewer",
}
"""Public classes that this test does not make: plain tuples of what it does make, an error, and a server."""


def test_all_public_classes_are_made(things):
    public = {name for name in at.__all__ if isinstance(getattr(at, name), type)}
    assert public - set(things) == LEFT_OUT


def test_all_come_back(things):
    for name, thing in things.items():
        again = pickle.loads(pickle.dumps(thing))
        assert type(again) is type(thing), name
        assert repr(again) == repr(thing) or " object at " in repr(thing), name
