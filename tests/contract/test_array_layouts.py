"""Arrays of any layout, type and byte order: every public function that takes arrays gives the same answer for each.

`DOORS` has every array parameter of the package; a test compares it with the signatures.
"""

import datetime
import inspect
from collections.abc import Callable
from importlib.util import find_spec
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy.sparse import csr_array

import antumbra as at
from antumbra.city.sensors.sensors import Zone
from antumbra.integrations import ladybug, open3d, pvlib, pyvista, trimesh
from antumbra.scene.scene_data import SemanticSurface
from study_cases import study_cases

SCENE = at.procedural("atrium", triangles=2000)
SOUP = np.round(SCENE.triangles().vertices[:40].astype(np.float64) * 4.0) / 4.0
LIGHT = at.PointLight((0.0, 3.0, 0.0))
GRID = at.Raster(0.0, 4.0, 1.0, 2, 3)
SIX = at.Sensors(np.zeros((6, 3)), None, None, None, "raster", GRID)


def multiples(*shape, low=-3.0, high=3.0, seed=0):
    """Multiples of 1/4, which float16 represents."""
    return np.random.default_rng(seed).integers(4 * low, 4 * high, shape) / 4.0


POINTS = multiples(6, 3) + [0.0, 3.0, 0.0]
VECTORS = multiples(6, 3, seed=1) + [0.0, 0.125, 0.0]  # never zero
FACES = np.array([3, 1, 4, 1, 5, 9])


class Door(NamedTuple):
    """An array parameter: numbers that it accepts, and a call with them, whose answer is compared."""

    numbers: np.ndarray  # integers if the parameter takes only these
    ask: Callable[[Any], Any]


DOORS = dict[str, Door]()


def door(names: str, numbers, ask) -> None:
    """Add the parameters `names`, such as "Scene.contains points", that take the same numbers."""
    for name in names.split(", "):
        assert name not in DOORS
        DOORS[name] = Door(np.asarray(numbers), ask)


def of_rays(owner: str, face: Any) -> None:
    """The methods of a scene or an engine that take rays."""
    for name in ("occluded", "closest_hit", "all_hits", "count_hits"):
        call = getattr(face, name)
        where = f"{owner}.{name}"
        door(f"{where} origins", POINTS, lambda a, call=call: call(a, VECTORS))
        door(f"{where} directions", VECTORS, lambda a, call=call: call(POINTS, a))
        door(f"{where} tmin", np.abs(VECTORS[:, 0]), lambda a, call=call: call(POINTS, VECTORS, tmin=a))
        door(f"{where} tmax", np.abs(VECTORS[:, 0]) + 1, lambda a, call=call: call(POINTS, VECTORS, tmax=a))
        door(f"{where} skip_face", FACES, lambda a, call=call: call(POINTS, VECTORS, skip_face=a))
        if name != "closest_hit":
            door(f"{where} targets", VECTORS, lambda a, call=call: call(POINTS, targets=a))
    for name in ("contains", "closest_points", "signed_distance"):
        door(f"{owner}.{name} points", POINTS, getattr(face, name))


of_rays("Scene", SCENE)
of_rays("Engine", SCENE.engine)


def moved(**arguments):
    scene = at.Scene.from_arrays(SOUP)
    scene.update(**arguments)
    return scene.triangles().vertices, scene.bounds


def engine_moved(**arguments):
    scene = at.Scene.from_arrays(SOUP)
    scene.engine.update(**arguments)
    return scene.triangles().vertices


MATRIX = np.array([[1.0, 0, 0, 2], [0, 2, 0, 0], [0, 0, 1, -1], [0, 0, 0, 1]])
door("Scene.update vertices", SOUP + 1, lambda a: moved(vertices=a))
door("Engine.update vertices", SOUP + 1, lambda a: engine_moved(vertices=a))
door("Scene.update transform", MATRIX, lambda a: moved(transform=a))
door("Engine.update transform", MATRIX, lambda a: engine_moved(transform=a))


VERTICES, TRIANGLES = SOUP.reshape(-1, 3), np.arange(len(SOUP) * 3).reshape(-1, 3)


def made(vertices=VERTICES, faces=TRIANGLES, **more):
    scene = at.Scene.from_arrays(vertices, faces, **more)
    return scene.triangles()[:2], scene.colours, scene.appearance and scene.appearance.textures


UV = multiples(len(SOUP) * 3, 2, low=0, high=1)
NORMALS = multiples(len(SOUP) * 3, 3, seed=4) + [0.0, 0.125, 0.0]
SHADES = multiples(len(SOUP), 3, low=0, high=1)
PIXELS = np.random.default_rng(5).integers(0, 255, (4, 6, 3)).astype(np.uint8)
door("Scene.from_arrays vertices", VERTICES, lambda a: made(vertices=a))
door("Scene.from_arrays faces", TRIANGLES, lambda a: made(faces=a))
door("Scene.from_arrays colours", SHADES, lambda a: made(colours=a))
door("Scene.from_arrays vertex_colours", SHADES.repeat(3, 0), lambda a: made(vertex_colours=a))
door("Scene.from_arrays uv", UV, lambda a: made(uv=a, texture=PIXELS))
door("Scene.from_arrays texture", PIXELS, lambda a: made(uv=UV, texture=a))
door("Scene.from_arrays normals", NORMALS, lambda a: made(normals=a))


def placed(transforms=MATRIX[None], colours=SHADES, soup=SOUP):
    return at.Scene.from_instances([soup], [transforms], [colours]).triangles()[:2]


door("Scene.from_instances transforms", np.stack([MATRIX, np.eye(4)]), lambda a: placed(a))
door("Scene.from_instances colours", SHADES, lambda a: placed(colours=a))
door("Scene.from_instances meshes", SOUP, lambda a: placed(soup=a))


# --- Lights, cameras and skies


V = VECTORS[0]
LIGHTS: dict[str, dict[str, Any]] = {
    "PointLight": {"position": V},
    "QuadLight": {"corner": V, "u": VECTORS[1], "v": VECTORS[2]},
    "DiskLight": {"center": V, "normal": VECTORS[1], "radius": 1.0},
    "SphereLight": {"center": V, "radius": 1.0},
    "DirectionalLight": {"direction": V},
    "AmbientOcclusion": {},
    "Light": {},
    "Sky": {},
    "PointLights": {"positions": POINTS, "intensities": FACES, "colours": SHADES[:6], "normals": VECTORS},
    "DirectionalLights": {"directions": VECTORS, "intensities": FACES, "colours": SHADES[:6]},
}
for _name, _fields in LIGHTS.items():
    for _field, _value in (_fields | {"colour": SHADES[1]}).items():
        if np.ndim(_value):

            def _light(a, name=_name, fields=_fields, field=_field):
                light = getattr(at, name)(**fields | {field: a})
                return [np.asarray(getattr(light, each), np.float64) for each in (*fields, "colour")]

            door(f"{_name} {_field}", np.asarray(_value, np.float64), _light)

EYE, AIM, UP = POINTS[0], POINTS[1] + 1, np.array([0.0, 1.0, 0.0])


def seen(position=EYE, target=AIM, up=UP):
    camera = at.Camera(position, target, up, 60.0, 4, 3)
    return camera.rays(SCENE.origin), camera.position, camera.target, camera.up


door("Camera position", EYE, lambda a: seen(position=a))
door("Camera target", AIM, lambda a: seen(target=a))
door("Camera up", UP, lambda a: seen(up=a))
door("Sky.radiance directions", VECTORS, at.Sky().radiance)
door("Sky image", multiples(4, 8, 3, low=0), lambda a: at.Sky(a).map)

# --- Jobs

door("visibility points", POINTS, lambda a: at.visibility(SCENE, a, LIGHT, VECTORS))
door("visibility normals", VECTORS, lambda a: at.visibility(SCENE, POINTS, LIGHT, a))
door("Receivers.in_space points", POINTS, lambda a: at.Receivers.in_space(a, SCENE.origin))
door("Receivers.in_space frame", V, lambda a: at.Receivers.in_space(POINTS, a))
for _call in ("on_surface", "of"):
    _door = getattr(at.Receivers, _call)
    door(f"Receivers.{_call} points", POINTS, lambda a, call=_door: call(a, VECTORS, SCENE.origin))
    door(f"Receivers.{_call} normals", VECTORS, lambda a, call=_door: call(POINTS, a, SCENE.origin))
    door(f"Receivers.{_call} frame", V, lambda a, call=_door: call(POINTS, VECTORS, a))
    door(f"Receivers.{_call} middle", V, lambda a, call=_door: call(POINTS, VECTORS, V, a))
door("line_of_sight observers", POINTS, lambda a: at.line_of_sight(SCENE, a, VECTORS))
door("line_of_sight targets", POINTS, lambda a: at.line_of_sight(SCENE, VECTORS, a))
door("line_of_sight normals", VECTORS, lambda a: at.line_of_sight(SCENE, POINTS, POINTS[::-1] + 0.5, normals=a))
door(
    "line_of_sight target_normals",
    VECTORS,
    lambda a: at.line_of_sight(SCENE, POINTS, POINTS[::-1] + 0.5, target_normals=a),
)
door("line_of_sight faces", FACES, lambda a: at.line_of_sight(SCENE, POINTS, POINTS[::-1], faces=a))
door("line_of_sight target_faces", FACES, lambda a: at.line_of_sight(SCENE, POINTS, POINTS[::-1], target_faces=a))
door("visibility_matrix sensors", POINTS, lambda a: at.visibility_matrix(SCENE, a))
door("visibility_matrix targets", POINTS, lambda a: at.visibility_matrix(SCENE, VECTORS, a))
door("visibility_matrix normals", VECTORS, lambda a: at.visibility_matrix(SCENE, POINTS, normals=a))
door(
    "visibility_matrix target_normals",
    VECTORS,
    lambda a: at.visibility_matrix(SCENE, POINTS, POINTS + 0.5, target_normals=a),
)
door("viewshed sensors", POINTS, lambda a: at.viewshed(SCENE, a, POINTS[:2]))
door("viewshed observers", POINTS, lambda a: at.viewshed(SCENE, POINTS, a))
door("visible_share sensors", POINTS, lambda a: at.visible_share(SCENE, a, at.Turbine((0, 0, 0), 4.0, 1.0)))
door("visible_share target", POINTS, lambda a: at.visible_share(SCENE, POINTS, a))
door("Turbine position", POINTS[0], lambda a: at.visible_share(SCENE, POINTS, at.Turbine(a, 2.0, 1.0)))
door(
    "sun_calendar points",
    POINTS,
    lambda a: at.sun_calendar(SCENE, a, "2026-06-21", place=at.Place(52.0, 4.4), step=60.0),
)
door("skyline points", POINTS, lambda a: at.skyline(SCENE, a))
door("skyline normals", VECTORS, lambda a: at.skyline(SCENE, POINTS, normals=a))
door("sky_view sensors", POINTS, lambda a: at.sky_view(SCENE, a))
door(
    "sun_hours sensors",
    POINTS,
    lambda a: at.sun_hours(SCENE, a, "2026-06-21", place=at.Place(52.0, 4.0), step=240).columns,
)
door("SceneChange.sensors sensors", POINTS, lambda a: at.scene_change(SCENE, SCENE).sensors(a).points)
door("view_factors per", np.arange(SCENE.n_triangles) % 3, lambda a: at.view_factors(SCENE, a, samples=64))
door("points_along lines", POINTS, lambda a: at.points_along(a, 0.5))
door("polygon_points corners", POINTS[:3], lambda a: at.polygon_points(a, 0.5))
door("point_sensors at", POINTS, at.point_sensors)
door("point_sensors normals", VECTORS, lambda a: at.point_sensors(POINTS, a))
door("point_sensors areas", np.abs(POINTS[:, 0]), lambda a: at.point_sensors(POINTS, None, a))
door("raster_sensors bounds", np.array([[-2.0, -2.0], [2.0, 1.0]]), lambda a: at.raster_sensors(SCENE, 1.0, bounds=a))
for study in study_cases():
    if study.points:
        door(f"{study.function} {study.points}", POINTS, lambda a, of=study: of.exact(of.call_with(a)(SCENE)))
SENSORS = at.point_sensors(POINTS)
CORNERS = np.array([[0, 1, 2], [3, 4, 5]])


def sensors(kind="points", **fields):
    values = {"points": POINTS, "normals": None, "areas": None, "faces": None, "kind": kind} | fields
    made = at.Sensors(**values)
    return [getattr(made, name) for name in ("points", "normals", "areas", "faces", "corners", "cells", "zone")]


door("Sensors points", POINTS, lambda a: sensors(points=a))
door("Sensors normals", VECTORS, lambda a: sensors(normals=a))
door("Sensors areas", np.abs(POINTS[:, 0]), lambda a: sensors(areas=a))
door("Sensors faces", FACES, lambda a: sensors("face", faces=a))
door("Sensors corners", CORNERS, lambda a: sensors("vertex", corners=a))
door("Sensors cells", np.arange(6)[::-1], lambda a: sensors("raster", raster=GRID, cells=a))
door("Sensors zone", FACES % 2, lambda a: sensors(zone=a, zones=(Zone("a", 3, 0), Zone("b", 3, 0))))
door("Sensors.on_raster values", POINTS[:, 0], SIX.on_raster)
DAY = at.times_of([datetime.date(2026, 6, 21)], datetime.UTC)
door("suns_of dni", np.arange(24.0), lambda a: at.suns_of(at.Place(52.0, 4.0), DAY, "z", a))
door("SrdhRays origins", POINTS, lambda a: at.SrdhRays(origins=a, ends=VECTORS).origins)
door("SrdhRays ends", POINTS, lambda a: at.SrdhRays(origins=VECTORS, ends=a).ends)
CITY = at.CityModel(None, ["a"], np.zeros(9, np.int32), np.zeros(9, np.int32), [], ["b"], [""], [], [{"x": 1.0}])
CITY = CITY._replace(surfaces=[SemanticSurface(0, "RoofSurface", 0, 0, (0,), None, {"y": 2.0})])
door("CityModel.surface_types faces", FACES % 3, CITY.surface_types)
door("CityModel.object_attribute faces", FACES % 3, lambda a: CITY.object_attribute("x", a))
door("CityModel.surface_attribute faces", FACES % 3, lambda a: CITY.surface_attribute("y", a))
NONE = csr_array((2, 5))
door("ViewFactors areas", np.array([1.0, 2.0]), lambda a: at.ViewFactors(["a", "b"], ["", ""], a, NONE, NONE).areas)

# --- Rasters

PLACE = np.array([2.0, 0.0, 10.0, 0.0, -2.0, 20.0])
HEIGHTS = multiples(5, 7, low=0)
door("from_raster heights", HEIGHTS, lambda a: at.from_raster((a, PLACE)).triangles()[:2])
door("from_raster transform", PLACE, lambda a: at.from_raster((HEIGHTS, a)).triangles()[:2])

# --- Drop-in replacements

if find_spec("trimesh"):
    from trimesh import Trimesh

    RAYS = trimesh.RayMeshIntersector(Trimesh(VERTICES, TRIANGLES, process=False))
    for _call in ("intersects_any", "intersects_first", "intersects_id", "intersects_location"):
        _ask = getattr(RAYS, _call)
        door(f"trimesh.RayMeshIntersector.{_call} ray_origins", POINTS, lambda a, ask=_ask: ask(a, VECTORS))
        door(f"trimesh.RayMeshIntersector.{_call} ray_directions", VECTORS, lambda a, ask=_ask: ask(POINTS, a))
    door("trimesh.RayMeshIntersector.contains_points points", POINTS, RAYS.contains_points)
    NEAREST = trimesh.ProximityQuery(Trimesh(VERTICES, TRIANGLES, process=False))
    for _call in ("on_surface", "signed_distance", "vertex"):
        door(f"trimesh.ProximityQuery.{_call} points", POINTS, getattr(NEAREST, _call))
TRACER = open3d.RaycastingScene()
TRACER.add_triangles(VERTICES, TRIANGLES)
for _call in ("cast_rays", "test_occlusions", "count_intersections", "list_intersections"):
    door(f"open3d.RaycastingScene.{_call} rays", np.concatenate([POINTS, VECTORS], 1), getattr(TRACER, _call))
for _call in ("compute_occupancy", "compute_distance", "compute_signed_distance", "compute_closest_points"):
    door(f"open3d.RaycastingScene.{_call} query_points", POINTS, getattr(TRACER, _call))
WALL = SimpleNamespace(vertices=VERTICES.tolist(), faces=TRIANGLES.tolist())
door("ladybug.intersection_matrix vectors", VECTORS, lambda a: ladybug.intersection_matrix(a, POINTS, VECTORS, [WALL]))
door("ladybug.intersection_matrix points", POINTS, lambda a: ladybug.intersection_matrix(VECTORS, a, VECTORS, [WALL]))
door("ladybug.intersection_matrix normals", VECTORS, lambda a: ladybug.intersection_matrix(VECTORS, POINTS, a, [WALL]))

PLAIN = (
    *(
        "AllHits",
        "CityModel",
        "ClosestPoints",
        "Column",
        "Frame",
        "GBuffer",
        "Hit",
        "LinePoints",
        "Receivers",
        "Shadow",
        "Sightlines",
    ),
    *("Skyline", "Suns", "Table", "Triangles", "Viewshed", "Visibility", "VisibilityMatrix"),
    *("Camera.rays", "Camera.view", "Engine.queries", "Engine.segment_hits", "Engine.shadows", "Frame.save"),
    *("Hit.of_scene", "Raster.places", "Receivers.moved_off", "Receivers.take", "Sensors.take"),
)
"""Records that the package makes, and methods for its own layers, whose arrays are those of the package."""

KEPT = {"Sensors attributes"}
"""Columns of the user's tables, which come through as they are."""

FLAGS, MASKED = {"Sensors.on_raster values"}, {"from_raster heights"}
"""Doors that accept bool, and masked numbers, which are holes."""

ELSEWHERE = {
    "PagedScene": "the methods of Scene",
    "ladybug.sky_intersection_matrix": "arguments of ladybug.intersection_matrix",
    "pvlib.pvlib_shading": "arguments of sun_hours",
    "pvlib_shading": "arguments of sun_hours",
    "PvModule": "numbers, and angles by time: tests/city/pv/test_module_shading.py",
    "RouteShade": "results",
    "SunCalendar": "results",
    "ModuleShading": "results",
    "route_shade": "arguments of points_along",
    "scene_variant": "what Scene.from_arrays takes",
    "pyvista.DatasetAccessor": "directions of lights, points of lights",
    "write_attributes": "tests/city/cityjson/test_attribute_writer.py",
}
"""Functions that hand their arrays to others of the list."""


# --- The list is complete

WORDS = "ArrayLike", "ndarray", "NDArray", "Vector", "_SupportsArray"


def public():
    """(name, function or class) of the whole public interface."""
    for name in at.__all__:
        found = getattr(at, name)
        if callable(found):
            yield name, found
        if inspect.isclass(found):
            static = {each: inspect.getattr_static(found, each) for each in dir(found) if each[0] != "_"}
            functions = {each: getattr(f, "__func__", f) for each, f in static.items()}
            yield from ((f"{name}.{each}", f) for each, f in functions.items() if inspect.isfunction(f))
    for module in (trimesh, open3d, pyvista, ladybug, pvlib):
        last = module.__name__.rpartition(".")[2]
        for name, found in vars(module).items():
            if name[0] == "_" or getattr(found, "__module__", "") != module.__name__:
                continue
            yield f"{last}.{name}", found
            if inspect.isclass(found):
                methods = vars(found).items()
                yield from (
                    (f"{last}.{name}.{each}", f) for each, f in methods if each[0] != "_" and inspect.isfunction(f)
                )


def parameters(function) -> list[str]:
    """The parameters that take arrays."""
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):
        return []
    return [each.name for each in signature.parameters.values() if any(w in str(each.annotation) for w in WORDS)]


def test_every_array_parameter_has_a_door():
    needed = {f"{name} {each}" for name, function in public() for each in parameters(function)}
    plain = {each for each in needed if each.partition(" ")[0] in PLAIN or each.endswith(".patch origin")}
    elsewhere = {each for each in needed if any(each.startswith((f"{name} ", f"{name}.")) for name in ELSEWHERE)}
    absent = {each for each in needed if each.startswith("trimesh.") and not find_spec("trimesh")}
    assert needed - plain - elsewhere - absent - KEPT - set(DOORS) == set()
    assert len(needed) > 100 and all(any(each.startswith(f"{name} ") for each in needed) for name in PLAIN)


# --- Layouts, types and refusals


def reversed_twice(array):
    """The same numbers with negative strides along all axes."""
    back = (slice(None, None, -1),) * array.ndim
    return array[back].copy()[back]


LAYOUTS: dict[str, Callable[[np.ndarray], Any]] = {
    "Fortran order": np.asfortranarray,
    "transposed": lambda a: np.array([*a.T]).T,
    "every other number": lambda a: (
        np.repeat(np.repeat(a, 2, 0), 2, -1)[::2, ..., ::2] if a.ndim > 1 else a.repeat(2)[::2]
    ),
    "negative strides": reversed_twice,
    "broadcast": lambda a: np.broadcast_to(a[:1], a.shape),
    "read-only": lambda a: np.frombuffer(a.tobytes(), a.dtype).reshape(a.shape),
    "unaligned": lambda a: np.frombuffer(b"x" + a.tobytes(), np.uint8)[1:].view(a.dtype).reshape(a.shape),
    "masked, without masked numbers": lambda a: np.ma.MaskedArray(a, np.zeros(a.shape, bool)),
    "list": lambda a: a.tolist(),
    "big-endian": lambda a: a.astype(a.dtype.newbyteorder(">")),
    "of objects": lambda a: a.astype(object),
}
TYPES = {
    "float64": ("f4", "f2", "g", ">f4", "i4", "i2", ">i8", "i1"),
    "int64": ("i4", "i2", "u1", ">i4", "u8"),
    "uint8": (),
}
CANONICAL = {"e": np.float32, "g": np.float64, "O": np.float64}


def canonical(array):
    """The same numbers in the type that stands for theirs, C-contiguous."""
    array = np.array(array)
    return np.array(array, CANONICAL.get(array.dtype.char, array.dtype.newbyteorder("=")), order="C")


def leaves(answer) -> list[Any]:
    """The arrays and numbers of an answer."""
    if isinstance(answer, np.ndarray) or answer is None or isinstance(answer, (str, float, int, np.generic)):
        return [answer]
    if hasattr(answer, "__dataclass_fields__"):
        return leaves([getattr(answer, name) for name in answer.__dataclass_fields__])
    if isinstance(answer, dict):
        return leaves(list(answer.values()))
    return [each for part in answer for each in leaves(part)] if isinstance(answer, (list, tuple)) else [repr(answer)]


def same(a, b) -> bool:
    """Whether answers have the same bits."""
    a, b = leaves(a), leaves(b)
    return len(a) == len(b) and all(
        x.dtype == y.dtype and x.shape == y.shape and x.tobytes() == y.tobytes()
        if isinstance(x, np.ndarray)
        else x == y or x != x
        for x, y in zip(a, b)
    )


def outcome(name, given):
    """The answer, or None if the numbers, such as directions that are zero, are refused."""
    try:
        return DOORS[name].ask(given)
    except at.InputError:
        return None


def check(name, given):
    """Whether numbers are accepted; check that the form makes no difference, and that they stay as they are."""
    before = np.array(given, copy=True)
    expected, found = outcome(name, canonical(given)), outcome(name, given)
    assert (expected is None) == (found is None) and same(expected, found)
    assert (np.array(given) == before).all()
    return found is not None


@pytest.mark.parametrize("name", DOORS)
def test_any_layout_gives_the_same_answer(name):
    numbers = DOORS[name].numbers
    accepted = {layout for layout, of in LAYOUTS.items() if check(name, of(numbers.copy()))}
    refused = {"broadcast"}  # rows that must differ
    if numbers.dtype.kind != "f":
        refused |= {"of objects", "list"} if numbers.dtype == np.uint8 else {"of objects"}
    assert accepted | refused >= set(LAYOUTS)


@pytest.mark.parametrize("name", DOORS)
def test_any_type_of_numbers_gives_the_same_answer(name):
    numbers = DOORS[name].numbers
    for dtype in TYPES[str(numbers.dtype)]:
        whole = np.dtype(dtype).kind in "iu"
        assert check(name, np.rint(numbers).astype(dtype) if whole else numbers.astype(dtype)) or whole


@pytest.mark.parametrize("name", DOORS)
def test_what_is_no_number_is_refused(name):
    numbers = DOORS[name].numbers
    nothing = numbers.astype(object)
    nothing.reshape(-1)[0] = None
    masked = np.ma.MaskedArray(numbers, np.zeros(numbers.shape, bool))
    masked[(0,) * numbers.ndim] = np.ma.masked
    holes = [] if name in MASKED else [masked]
    flags = [] if name in FLAGS else [numbers.astype(bool)]
    for wrong in (*flags, numbers.astype(complex), numbers.astype(str), nothing, *holes):
        with pytest.raises(at.InputError) as caught:
            DOORS[name].ask(wrong)
        assert str(caught.value).isprintable()


@pytest.mark.parametrize("name", DOORS)
def test_no_numbers_are_no_fault_or_an_input_error(name):
    numbers = DOORS[name].numbers
    for none in (numbers[:0], numbers[..., :0], [], [[]]):
        try:
            DOORS[name].ask(none)
        except at.InputError as error:
            assert str(error).isprintable()
