"""Every public function, method and class refuses wrong values by an `InputError`, whatever the parameter.

Parameters and their kinds come from signatures. `examples` has a call that works for each public name.
"""

import decimal
import inspect
import warnings
from collections.abc import Callable, Iterator
from contextlib import suppress
from datetime import UTC, date
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import geopandas
import numpy as np
import pandas
import pytest
import shapely
import trimesh

import antumbra as at
from antumbra.sun.sun_positions import Times
from study_cases import study_cases

CORNERS = np.array([[[0, 0, 0], [4, 0, 0], [0, 0, -4]], [[0, 1, 0], [1, 1, 0], [0, 1, -1]]], np.float32)
"""A floor, and a smaller triangle above it."""

CAMERA = at.Camera((1.0, 3.0, 1.0), (1.0, 0.0, -1.0), width=4, height=4)
LIGHT = at.PointLight((0.5, 3.0, -0.5))
RECEIVERS = at.Receivers.in_space(np.array([[1.0, 3.0, -1.0]]), np.zeros(3))
PLACE = at.Place(52.0, 4.0)

PLUMBING = {
    "patch", "samples", "area", "weights", "upright", "drawn",  # of lights, for tracers and scenes
    "summary",  # of results, for commands
    "view", "rays",  # of cameras, for tracers
    "from_rows", "rows", "see",  # of a Renderer, for commands and workers: they take what its other methods made
    "of_scene", "surfaces",  # of a Hit
    "of_data",  # of a scene
    "shadows", "queries", "accelerated", "frame_tracer", "segment_hits",  # of an Engine, for jobs and pictures
    "of", "moved_off", "seeing_all_around", "take",  # of Receivers, for jobs
    "block",  # of Sensors, for jobs
    "blocks", "whole",  # of a Table, for files
    "reshaped",  # of a Visibility
    "exposed", "state",  # of a SceneChange, for commands
    "middles", "places",  # of a Raster, for sensors
    "of_metres", "same_as",  # of a LengthUnit, for jobs
    "ignore_alpha", "refusal", "wait", "close",  # without parameters
}  # fmt: skip
"""Methods without a face for users."""

RAY_METHODS = "occluded", "closest_hit", "all_hits", "count_hits", "contains", "closest_points", "signed_distance"


@cache
def scene() -> at.Scene:
    return at.Scene.from_arrays(CORNERS)


class Thing:
    """Something that no function takes."""


class Mesh:
    """A mesh as trimesh has it, with z up."""

    vertices, faces, visual = CORNERS.reshape(-1, 3)[:, [0, 2, 1]] * (1, -1, 1), np.arange(6).reshape(-1, 3), None


CITY = """{"type": "CityJSON", "version": "2.0", "transform": {"scale": [1, 1, 1], "translate": [0, 0, 0]},
"CityObjects": {"a": {"type": "Building", "attributes": {"height": 3}, "geometry": [{"type": "MultiSurface", "lod": "1",
"semantics": {"surfaces": [{"type": "RoofSurface", "slope": 0}], "values": [0]}, "boundaries": [[[0, 1, 2]]]}]}},
"vertices": [[0, 0, 0], [1, 0, 0], [0, 1, 0]]}"""


@cache
def wrong_values() -> list[Any]:
    """Values that most parameters refuse. Some parameters take some of them: extreme numbers come first."""
    return [
        np.nan, -(10**400), 1e300, np.inf, -np.inf, 1e39, 2**64, 2**32, 7, -1, 0, -1.5, 0.5, None, True, 1j,
        "", "x", "two\nlines", "1", "nowhere/x.glb", b"x", [], [1], ["front"], [[1, 2], [3]], [None], (1e39, 0, 0),
        (np.nan, 0, 0), {}, {"a": 1}, {3}, Thing(), Path("nowhere"), decimal.Decimal("nan"), np.zeros(0),
        np.zeros((2, 2)), np.array("x"), np.array([None]), np.float32(np.nan), np.datetime64("NaT"),
        np.full((1, 3), np.nan), scene(), CAMERA, LIGHT, [CAMERA], [LIGHT],
    ]  # fmt: skip


class Example(NamedTuple):
    """A call, and whether it works: a store refuses some questions."""

    call: Callable
    arguments: dict[str, Any]
    works: bool = True


def ex(call, works=True, **arguments) -> Example:
    return Example(call, arguments, works)


def _of_faces(scene, stored: bool) -> dict[str, Example]:
    opaque = scene if stored else at.Scene.from_arrays(np.eye(3)[None])
    return {
        "camera": ex(scene.camera, works=False),
        "light": ex(scene.light, works=False),
        "page": ex(scene.page),
        "clamped": ex(scene.clamped, time=0.0),
        "default_camera": ex(scene.default_camera),
        "default_light": ex(scene.default_light),
        "default_lights": ex(scene.default_lights),
        "ground_height": ex(scene.ground_height),
        "set_transmittance": ex(opaque.set_transmittance, not stored, shares={"*": 0.5}),
        "triangles": ex(scene.triangles),
        "update": ex(opaque.update, not stored, objects=[0], transform=np.eye(4), threads=1),
    }


def scene_methods(scene, stored: bool) -> dict[str, Example]:
    rays = {"origins": [[1.0, 3.0, -1.0]], "directions": [0.0, -1.0, 0.0]}
    segments = {"origins": rays["origins"], "targets": [0.5, 0.5, -0.5]}
    more = {"tmin": 0.0, "tmax": 9.0, "skip_face": 1, "time": 0.0, "cull_faces": None, "threads": 1}
    rest = {} if isinstance(scene, at.Engine) else _of_faces(scene, stored)
    return rest | {
        "occluded": ex(scene.occluded, **rays, **more),
        "occluded of segments": ex(scene.occluded, **segments),
        "closest_hit": ex(scene.closest_hit, **rays, **more),
        "all_hits": ex(scene.all_hits, **rays, **more, max_hits=2),
        "all_hits of segments": ex(scene.all_hits, **segments),
        "count_hits": ex(scene.count_hits, **rays, **more, merge="surface"),
        "contains": ex(scene.contains, points=[[1.0, 0.5, -1.0]], threads=1),
        "closest_points": ex(scene.closest_points, not stored, points=[[1.0, 0.5, -1.0]], threads=1),
        "signed_distance": ex(scene.signed_distance, not stored, points=[[1.0, 0.5, -1.0]], threads=1),
    }


def examples(folder: Path) -> dict[str, Example]:
    """Name -> a call of each function, class and method of the public face."""
    own, points = scene(), [[1.0, 0.5, -1.0], [0.2, 1.5, -0.2]]
    sensors, days = at.face_sensors(own), [date(2026, 6, 21)]
    up = np.array([[0.0, 1.0, 0.0]] * 2)
    renderer, sky = at.Renderer(own), at.Sky(count=16)
    suns, many = at.DirectionalLights([[0, -1, 0]] * 2), at.PointLights([[0, 9, 0]] * 2)
    quick = {"spp": 1, "threads": 1}
    table = at.Table(sensors, {"seen": at.Column(np.arange(2.0), "", "a number")}, scene=own)
    matrix = at.visibility_matrix(own, points)
    factors = at.view_factors(own, "face", samples=64)
    frame = at.render(own, CAMERA, LIGHT, **quick)
    zone, noon = UTC, np.array(["2026-06-21T12:00"], "datetime64[s]")
    times = Times(noon, noon, np.ones(1))
    at.build_store(own, folder / "own.antumbra", threads=1)
    store = at.load(folder / "own.antumbra")
    (folder / "own.json").write_text(CITY)
    (folder / "trees.csv").write_text("x,y,height,radius\n0.5,0.5,2,1\n")
    (folder / "own.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 0 -1\nf 1 2 3\n")
    city = at.load(folder / "own.json")
    index = pandas.date_range("2026-06-21", periods=4, freq="6h", tz="UTC")
    module, route = at.PvModule((0.0, 5.0, 0.0), 2.0, 1.0, 20.0), [[0.0, 3.0, 0.0], [4.0, 3.0, 0.0]]
    shading = at.module_shading(own, module, index, samples=1, place=PLACE)
    shade = at.route_shade(own, route, 1.0, days, place=PLACE, step=60.0)
    calendar = at.sun_calendar(own, points, days, place=PLACE, step=60.0)
    seen = at.viewshed(own, at.raster_sensors(own, 1.0), [0.5, 3.0, -0.5], each=True)
    skyline = at.skyline(own, points, azimuth_step=30.0)
    change = at.scene_change(own, own)
    moment = {"at": "2026-06-21T12:00", "place": PLACE}
    houses = geopandas.GeoDataFrame(geometry=[shapely.box(0, 0, 1, 1)])
    shadow = at.shadow(own, **moment)
    garden = {"scene": own, "areas": [[[0.2, 0.2], [1.7, 0.2], [0.2, 1.7]]]}

    found = {
        "AmbientOcclusion": ex(at.AmbientOcclusion),
        "Camera": ex(at.Camera, position=(0, 1, 9), target=(0, 1, 0)),
        "Camera.resized": ex(CAMERA.resized, width=4, height=4),
        "Camera.panoramic": ex(CAMERA.panoramic),
        "DirectionalLight": ex(at.DirectionalLight, direction=(0, -1, 0)),
        "DirectionalLights": ex(at.DirectionalLights, directions=[[0, -1, 0]]),
        "DiskLight": ex(at.DiskLight, center=(0, 3, 0), normal=(0, 1, 0), radius=0.5),
        "Light": ex(at.Light),
        "Place": ex(at.Place, latitude=52.0, longitude=4.0),
        "Plan": ex(at.Plan),
        "PointLight": ex(at.PointLight, position=(0, 3, 0)),
        "PointLights": ex(at.PointLights, positions=[[0, 3, 0]]),
        "QuadLight": ex(at.QuadLight, corner=(0, 3, 0), u=(1, 0, 0), v=(0, 0, 1)),
        "Sky": ex(at.Sky),
        "Sky.radiance": ex(sky.radiance, directions=[0, 1, 0]),
        "Sky.resampled": ex(sky.resampled, count=32),
        "SphereLight": ex(at.SphereLight, center=(0, 3, 0), radius=0.5),
        "SrdhRays": ex(at.SrdhRays),
        "RenderOptions": ex(at.RenderOptions),
        "Renderer": ex(at.Renderer, scene=own),
        "Engine": ex(at.Engine, scene=own),
        "Engine.with_options": ex(own.engine.with_options, plan=None, threads=1, max_memory=None),
        **{f"Engine.{name}": scene_methods(own.engine, False)[name] for name in RAY_METHODS},
        "Engine.surfaces": ex(own.engine.surfaces, camera=CAMERA),
        "Engine.update": ex(at.Engine(own).update, objects=[0], transform=np.eye(4)),
        "Engine.visibility": ex(own.engine.visibility, receivers=RECEIVERS, lights=LIGHT, spp=1),
        "Receivers.in_space": ex(at.Receivers.in_space, points=[[1.0, 3.0, -1.0]], frame=own.origin),
        "Receivers.on_surface": ex(
            at.Receivers.on_surface, points=[[1.0, 3.0, -1.0]], normals=[0.0, 1.0, 0.0], frame=own.origin
        ),
        "Renderer.expect": ex(renderer.expect, frames=3),
        "Renderer.render": ex(renderer.render, camera=CAMERA, lights=LIGHT, spp=1),
        "Renderer.request": ex(renderer.request, camera=CAMERA, lights=LIGHT, options=at.RenderOptions(spp=1)),
        "Renderer.accelerate": ex(renderer.accelerate),
        "Scene": ex(at.Scene, source=own.source),
        "Scene.from_arrays": ex(at.Scene.from_arrays, vertices=CORNERS),
        "Scene.from_instances": ex(at.Scene.from_instances, meshes=[CORNERS], transforms=[np.eye(4)[None]]),
        "Scene.from_mesh": ex(at.Scene.from_mesh, mesh=Mesh()),
        "PagedScene": ex(at.PagedScene, store=store.store),
        "Sheet": ex(at.Sheet, project="a", scale=500.0, extent=[0.0, 0.0, 9.0, 9.0]),
        "Sensors": ex(at.Sensors, points=points, normals=up, areas=[1.0, 2.0], faces=[0, 1], kind="points"),
        "Sensors.part": ex(sensors.part, first=0, last=1),
        "Sensors.on_raster": ex(at.raster_sensors(own, 9.0).on_raster, values=[1.0]),
        "Table": ex(at.Table, sensors=sensors, columns=table.columns),
        "Table.of_faces": ex(table.of_faces, name="seen"),
        "Table.page": ex(table.page, path=folder / "table.html"),
        "Table.rows": ex(table.rows),
        "Table.save": ex(table.save, path=folder / "table.csv"),
        "Table.save_map": ex(table.save_map, path=folder / "map.pdf"),
        "Table.shown": ex(table.shown, column="seen"),
        "Table.to_xarray": ex(at.sky_view(own, "raster:2", directions=16).to_xarray),
        "VisibilityMatrix": ex(at.VisibilityMatrix, bits=matrix.bits, columns=2, counts=matrix.counts),
        "VisibilityMatrix.rows": ex(matrix.rows),
        "VisibilityMatrix.save": ex(matrix.save, path=folder / "matrix.npy"),
        "VisibilityMatrix.sparse": ex(matrix.sparse),
        "CityModel.object_attribute": ex(city.city.object_attribute, name="height", faces=[0, -1]),
        "CityModel.surface_attribute": ex(city.city.surface_attribute, name="slope", faces=[0, -1]),
        "ViewFactors": ex(
            at.ViewFactors, **{each: getattr(factors, each) for each in ("names", "types", "areas", "matrix", "errors")}
        ),
        "ViewFactors.reciprocal": ex(factors.reciprocal),
        "ViewFactors.save_change": ex(factors.save_change, path=folder / "change.csv", before=factors),
        "ViewFactors.save": ex(factors.save, path=folder / "factors.csv"),
        "CityModel.surface_types": ex(city.city.surface_types, faces=[0, -1]),
        "Frame.save": ex(frame.save, path=folder / "frame.png"),
        "SceneChange.compare": ex(
            lambda study, sensors: change.compare(study, sensors, directions=16), study=at.sky_view, sensors=points
        ),
        "SceneChange.shared": ex(change.shared),
        "SceneChange.sensors": ex(change.sensors, sensors=points),
        "scene_change": ex(at.scene_change, scene=own, add=own, remove=[]),
        "scene_variant": ex(at.scene_variant, scene=own, variant=own),
        "changed_scene": ex(at.changed_scene, scene=own, add=own, remove=[]),
        "before_and_after": ex(at.before_and_after, before=table, after=table),
        "bake": ex(at.bake, scene=own, output=folder / "baked.glb", **quick),
        "Baked.page": ex(at.bake(own, folder / "shown.glb", **quick).page, path=folder / "baked.html"),
        "build_store": ex(at.build_store, scenes=own, path=folder / "made.antumbra"),
        "dataset": ex(at.dataset, scene=own, folder=folder / "set", size=(4, 4), overwrite=True, **quick),
        "face_sensors": ex(at.face_sensors, scene=own),
        "grid_sensors": ex(at.grid_sensors, scene=own, spacing=1.0),
        "vertex_sensors": ex(at.vertex_sensors, scene=own),
        "area_sensors": ex(at.area_sensors, **garden),
        "raster_sensors": ex(at.raster_sensors, scene=own, spacing=1.0),
        "raster_sensors.in_bounds": ex(at.raster_sensors, scene=own, spacing=1.0, bounds=[[0, 0], [3, 3]]),
        "point_sensors": ex(at.point_sensors, at=points),
        "sensors_of": ex(at.sensors_of, text="face", scene=own),
        "sensors_of.in_areas": ex(at.sensors_of, text="raster:0.5", **garden),
        "line_of_sight": ex(at.line_of_sight, scene=own, observers=points[:1], targets=points[1:]),
        "from_trees": ex(at.from_trees, trees=folder / "trees.csv", scene=own, base=0.0),
        "load": ex(at.load, path=folder / "own.obj"),
        "place_of": ex(at.place_of, scene=own, latitude=52.0, longitude=4.0),
        "procedural": ex(at.procedural, name="atrium", triangles=1000),
        "render": ex(at.render, scene=own, camera=CAMERA, lights=LIGHT, **quick),
        "sun_hours": ex(at.sun_hours, scene=own, sensors=sensors, days=days, place=PLACE, step=360),
        "sun_hours.in_areas": ex(at.sun_hours, **garden, days=days, place=PLACE, step=360),
        "points_along": ex(at.points_along, lines=[[0.0, 0.0], [4.0, 0.0]], spacing=1.0),
        "polygon_points": ex(at.polygon_points, corners=[[0.0, 0, 0], [1, 0, 0], [1, 1, 0]], spacing=0.25),
        "surface_points": ex(at.surface_points, scene=own, spacing=0.5),
        "Turbine": ex(at.Turbine, position=(0.0, 0.0, 0.0), hub_height=3.0, rotor_diameter=1.0),
        "visible_share": ex(at.visible_share, scene=own, sensors=points, target=[[0.5, 0.5, -0.5]]),
        "from_footprints": ex(at.from_footprints, footprints=houses, height=3.0),
        "from_raster": ex(at.from_raster, raster=(np.zeros((3, 4)), (1.0, 0.0, 0.0, 0.0, -1.0, 0.0), "EPSG:28992")),
        "pvlib_shading": ex(at.pvlib_shading, scene=own, points=points, times=index, samples=1, place=PLACE),
        "PvModule": ex(at.PvModule, position=(0.0, 5.0, 0.0), width=2.0, height=1.0, tilt=20.0, azimuth=170.0),
        "module_shading": ex(at.module_shading, scene=own, modules=module, times=index, samples=1, place=PLACE),
        "ModuleShading.frame": ex(shading.frame),
        "ModuleShading.save": ex(shading.save, path=folder / "shading.csv"),
        "route_shade": ex(at.route_shade, scene=own, line=route, spacing=1.0, days=days, place=PLACE, step=60.0),
        "RouteShade.save_hours": ex(shade.save_hours, path=folder / "hours.csv"),
        "sun_calendar": ex(at.sun_calendar, scene=own, points=points, days=days, place=PLACE, step=60.0),
        "SunCalendar.save": ex(calendar.save, path=folder / "calendar.csv"),
        "SunCalendar.save_map": ex(calendar.save_map, path=folder / "calendar.pdf", point=0),
        "Viewshed.polygons": ex(seen.polygons),
        "Viewshed.save_polygons": ex(seen.save_polygons, path=folder / "seen.gpkg"),
        "shadow": ex(at.shadow, scene=own, **moment),
        "shadow.of_days": ex(at.shadow, scene=own, days=days, step=360, place=PLACE),
        "Shadow.frame": ex(shadow.frame),
        "Shadow.page": ex(shadow.page, path=folder / "shadow.html"),
        "Shadow.save_map": ex(shadow.save_map, path=folder / "shadow.pdf"),
        "Shadow.save": ex(shadow.save, path=folder / "shadow.gpkg"),
        "skyline": ex(at.skyline, scene=own, points=points, azimuth_step=30.0),
        "Skyline.save_map": ex(skyline.save_map, path=folder / "horizon.pdf", point=0, place=PLACE),
        "Skyline.save": ex(skyline.save, path=folder / "skyline.csv"),
        "Skyline.series": ex(skyline.series),
        "Skyline.sky_view_factor": ex(skyline.sky_view_factor),
        "Skyline.table": ex(skyline.table),
        "Skyline.userhorizon": ex(skyline.userhorizon),
        "sky_view": ex(at.sky_view, scene=own, sensors=sensors, directions=16),
        "trimesh_nearest": ex(at.trimesh_nearest, mesh=trimesh.creation.box()),
        "trimesh_ray": ex(at.trimesh_ray, mesh=trimesh.creation.box()),
        "use_in_trimesh": ex(lambda: at.use_in_trimesh().undo()),
        "suns_of": ex(at.suns_of, place=PLACE, times=times, up="y"),
        "times_of": ex(at.times_of, days=days, zone=zone),
        "view": ex(at.view, scene=own, lights=LIGHT, camera=CAMERA, browser=False),
        "viewshed": ex(at.viewshed, scene=own, sensors=points, observers=[0.5, 3.0, -0.5]),
        "virtual_point_lights": ex(at.virtual_point_lights, scene=own, light=LIGHT, n=64),
        "visibility": ex(at.visibility, scene=own, points=points, light=LIGHT, **quick),
        "visibility_matrix": ex(at.visibility_matrix, scene=own, sensors=points),
        "write_attributes": ex(
            at.write_attributes,
            source_path=folder / "own.json",
            target_path=folder / "more.json",
            values={"a": np.zeros(city.n_triangles)},
        ),
        "Viewer": ex(at.Viewer, works=False, page=None),
        "cluster": ex(at.cluster.run, works=False, function=at.sun_hours, scene="nowhere.glb"),
        "examples": ex(at.examples.file_of, name="mill"),
    }
    for case in study_cases():
        result, function = case.call(own), getattr(at, case.function)
        found[case.function] = ex(function, scene=own, **case.keywords)
        for name, keywords in case.methods.items():
            found[f"{type(result).__name__}.{name}"] = ex(getattr(result, name), **keywords)
    for kind, made in (("Scene", own), ("PagedScene", store)):
        found |= {f"{kind}.{name}": each for name, each in scene_methods(made, made is store).items()}
    for made in (LIGHT, sky, suns, many, at.AmbientOcclusion(), at.Light()):
        found[f"{type(made).__name__}.named"] = ex(made.named, name="lamp")
    lamps = (
        at.DiskLight((0, 3, 0), (0, 1, 0), 1),
        at.SphereLight((0, 3, 0), 1),
        at.QuadLight((0, 3, 0), (1, 0, 0), (0, 0, 1)),
    )
    for made in (*lamps, at.DirectionalLight((0, -1, 0))):
        found[f"{type(made).__name__}.named"] = ex(made.named, name="lamp")
    return found


class Begun(Exception):
    """The viewer begins its work, so it has taken the arguments."""


@pytest.fixture(scope="module")
def known(tmp_path_factory) -> Iterator[dict[str, Example]]:
    def begin(*_):
        raise Begun

    with pytest.MonkeyPatch.context() as patch, warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        folder = tmp_path_factory.mktemp("faces")
        patch.chdir(folder)
        patch.setattr("antumbra.viewer.viewer_page.prepare", begin)
        yield examples(folder)


def of_name(known: dict[str, Example], name: str) -> dict[str, Example]:
    return {key: each for key, each in known.items() if key.partition(".")[0] == name}


def is_record(thing) -> bool:
    """Whether a class only holds results: a NamedTuple that checks nothing."""
    return hasattr(thing, "_fields") and thing.__new__.__module__.startswith("namedtuple")


def test_there_is_an_example_of_every_public_name(known):
    assert not [key for key in known if not hasattr(at, key.partition(".")[0])]
    for name in at.__all__:
        thing = getattr(at, name)
        assert name in known or is_record(thing) or issubclass(thing, Exception), name
        if inspect.isclass(thing) and not issubclass(thing, Exception):
            ours = lambda method: callable(method) and str(getattr(method, "__module__", "")).startswith("antumbra.")
            methods = {n for n, method in inspect.getmembers(thing, ours) if not n.startswith("_")} - PLUMBING
            assert methods <= {key.partition(".")[2] for key in known if key.startswith(f"{name}.")}, name


@pytest.mark.parametrize("name", at.__all__)
def test_examples_work(known, name):
    for example in of_name(known, name).values():
        try:
            example.call(**example.arguments)
            assert example.works
        except Begun:
            pass
        except at.InputError:
            assert not example.works


def test_scenes_are_paths_and_meshes_too(known):
    """Whatever takes a scene takes the path of one, as text or not, and a mesh of another library."""
    Path("floor.obj").write_text(
        "".join(f"v {x} {y} {z}\n" for x, y, z in CORNERS.reshape(-1, 3)) + "f 1 2 3\nf 4 5 6\n"
    )
    asked = set()
    for key, example in known.items():
        name = next((n for n in inspect.signature(example.call).parameters if n in ("scene", "scenes", "path")), None)
        if name is None or (not isinstance(example.arguments.get(name), at.Scene) and key != "load"):
            continue
        for given in ("floor.obj", Path("floor.obj"), Mesh()):
            with suppress(Begun):
                example.call(**{**example.arguments, name: given})
            asked.add(key)
    assert asked >= {"Renderer", "bake", "dataset", "view", "sun_hours", "build_store", "load"} and len(asked) > 15
    assert (at.face_sensors("floor.obj").points == at.face_sensors(scene()).points).all()


def test_a_picture_of_a_file_needs_no_more(known):
    assert at.render("own.obj", spp=1, plan="bsah+single").image.shape == (1024, 1024, 3)


def test_swapped_arguments_are_told():
    with pytest.raises(at.InputError, match=r"wrong order; write render\(scene, camera, lights\)"):
        at.render(scene(), [LIGHT], CAMERA)


def refusal(example: Example, parameter: str, value) -> str | None:
    """The message by which a call refuses a value; None: it takes the value."""
    try:
        example.call(**{**example.arguments, parameter: value})
    except Begun:
        return None
    except at.InputError as error:
        return str(error)
    return None


@pytest.mark.parametrize("name", at.__all__)
def test_wrong_values_are_refused(known, name):
    refused = 0
    for key, example in of_name(known, name).items():
        for parameter, declared in inspect.signature(example.call).parameters.items():
            if declared.kind is declared.VAR_KEYWORD:
                continue  # Python itself refuses a name that is unknown
            taken = set[type]()  # kinds of values; of those that a parameter takes, one is enough
            for value in wrong_values():
                if type(value) in taken:
                    continue
                try:
                    said = refusal(example, parameter, value)
                except Exception as error:
                    raise AssertionError(f"{key}({parameter}={value!r:.60}) raises {type(error).__name__}") from error
                if said is None:
                    taken.add(type(value))
                else:
                    refused += 1
                    assert said and said.isprintable() and " at 0x" not in said, (key, parameter, said)
    asked = [example.call for example in of_name(known, name).values()]
    assert refused or not any(inspect.signature(call).parameters for call in asked)


KINDS = {
    bool: ("x", "", 1, 0.0, None, [True]),
    int: ("x", "1", None, 1.5, [1], np.nan),
    float: ("x", "1.0", None, [1.0], True, np.nan),
    str: (3, b"x", None, ["x"], Thing()),
}
"""Annotation of a parameter -> values of other kinds."""


@pytest.mark.parametrize("kind", KINDS)
def test_parameters_take_values_of_their_kind_alone(known, kind):
    """An annotation holds: a flag takes no text, a whole number no half."""
    asked = 0
    for key, example in known.items():
        for name, parameter in inspect.signature(example.call).parameters.items():
            if parameter.annotation in (kind, kind.__name__) and name != "about":
                for value in KINDS[kind]:
                    asked += 1
                    assert refusal(example, name, value) is not None, f"{key}({name}={value!r})"
    assert asked > 20


@pytest.mark.parametrize("name", [n for n in at.__all__ if is_record(getattr(at, n))])
def test_records_of_results_hold_anything(name):
    record = getattr(at, name)
    assert record(*[Thing()] * len(record._fields))._fields
