"""How much of a target is visible: a facade, a polygon, any points, or the rotor of a wind turbine."""

from typing import Any, NamedTuple, ParamSpec

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...base.checks import listed, number, points, text
from ...base.errors import InputError
from ...base.option_fields import Given, with_keywords
from ...base.progress import Progress, report_progress, with_progress
from ...engine.measured_scenes import measured_scene
from ...engine.plan import Plan
from ...engine.scene import AnyScene
from ...engine.scene_loading import SceneLike
from ...kernels.parallel import thread_count
from ...query.light_samples import light_samples
from ...query.receivers import Receivers
from ...query.shadow_query import count_occluded
from ...scene.lights import SphereLight
from ...work.result_summary import Summary
from ..sensors.point_checks import depths_below_ground, notes_on_points, notes_on_sensors, tell
from ..sensors.sensor_files import sensors_of
from ..sensors.sensors import Sensors, point_sensors, sensors_from, sightline_ends
from ..sensors.surface_grid import grid_sensors
from ..tables.result_table import Column, Table
from .sight_options import VisibleOptions
from .visibility_matrix import TileTracer

_PAIRS = 1 << 24  # sightlines at a time
_FLAT = 1e-6  # largest distance of a polygon's corner from its plane, in sizes of the polygon
_MOST = 1_000_000  # points of a target

_P = ParamSpec("_P")

# --- Targets ----------------------------------------------------------------------------------------------------------


class _TurbineFields(NamedTuple):
    position: tuple[float, float, float]  # of its foot, world
    hub_height: float  # world units above the foot
    rotor_diameter: float  # world units


class Turbine(_TurbineFields):
    """A wind turbine, whose rotor turns towards each sensor.

    position : (3,) float
        World coordinates of its foot.
    hub_height : float
        World units, above the foot.
    rotor_diameter : float
        World units.
    """

    __slots__ = ()

    def __new__(cls, position: ArrayLike, hub_height: float, rotor_diameter: float) -> "Turbine":
        x, y, z = (
            number(each, "a coordinate of a turbine", -np.inf, np.inf) for each in listed(position, "position", 3)
        )
        height = number(hub_height, "the hub height of a turbine", 0.0, np.inf)
        diameter = number(rotor_diameter, "the rotor diameter of a turbine", 0.0, np.inf)
        return super().__new__(cls, (x, y, z), height, diameter)


def _rotor(turbine: Turbine, up: str) -> SphereLight:
    """The rotor of a turbine as a sphere, which is sampled as the disk that faces each sensor."""
    centre = np.array(turbine.position, np.float64)
    centre["xyz".index(up)] += turbine.hub_height
    return SphereLight(tuple(centre.tolist()), turbine.rotor_diameter / 2.0)


def surface_points(
    scene: SceneLike, spacing: float, *, objects: str | list[str] | None = None,
    types: str | list[str] | None = None, lift: float = 0.0,
) -> Sensors:  # fmt: skip
    """Points on a part of a scene, such as a facade, as a target: those of `grid_sensors` on some objects or surfaces.

    Parameters
    ----------
    scene : Scene, or anything that `antumbra.load` takes
    spacing : float
        World units between neighbours.
    objects : str or list of str, optional
        Names of objects. In a city model, an object includes its parts. None: all.
    types : str or list of str, optional
        Types of semantic surfaces, such as "WallSurface". None: all.
    lift : float
        As for `face_sensors`.

    Raises
    ------
    InputError
        If the scene has no such object or surface, or no semantic surfaces.
    """
    scene = measured_scene(scene)
    sensors = grid_sensors(scene, spacing, lift=lift)
    faces, chosen = np.asarray(sensors.faces), np.ones(len(sensors), bool)
    if objects is not None:
        names = _texts(objects, "objects")
        there = np.array([thing.name in names or thing.parent in names for thing in scene.objects], bool)
        chosen &= there[scene.object_of_face[faces]]
    if types is not None:
        if scene.city is None:
            raise InputError(f"{scene.name} has no semantic surfaces; leave types out")
        chosen &= np.isin(scene.city.surface_types(faces), _texts(types, "types"))
    if not chosen.any():
        raise InputError(f"{scene.name} has no surface of the objects {objects!r} and the types {types!r}")
    normals, areas = sensors.normals, sensors.areas
    return point_sensors(
        sensors.points[chosen], None if normals is None else normals[chosen], None if areas is None else areas[chosen]
    )


def _texts(value: Any, what: str) -> list[str]:
    """One text or several, as a list."""
    if isinstance(value, (list, tuple)):
        return [text(each, what) for each in value]
    return [text(value, what)]


def polygon_points(corners: ArrayLike, spacing: float) -> Sensors:
    """Points in a flat polygon, as a target that is visible from the side on which its corners run counterclockwise.

    Parameters
    ----------
    corners : (n, 3) float
        World coordinates; the polygon may be concave.
    spacing : float
        World units between neighbours. Each point stands for an equal share of the area.

    Raises
    ------
    InputError
        If the corners are not flat, enclose no area, or the spacing gives no point or more than a million.
    """
    spacing, ring = number(spacing, "the spacing of points", 0.0, np.inf), points(corners, "corners of a polygon")
    middle = ring.mean(0) if len(ring) else np.zeros(3)
    local = ring - middle
    area = np.cross(local, np.roll(local, -1, 0)).sum(0) / 2.0  # Newell's normal
    size, length = float(np.abs(local).max(initial=0.0)), float(np.linalg.norm(area))
    if len(ring) < 3 or length <= 1e-12 * size * size:
        raise InputError("a polygon needs three or more corners that enclose an area")
    normal = area / length
    if np.abs(local @ normal).max() > _FLAT * size:
        raise InputError("the corners of the polygon do not lie in a plane; divide it into flat ones")
    if length / spacing / spacing > _MOST:
        raise InputError(
            f"a polygon of {length:g} at a spacing of {spacing:g} has more than {_MOST:,} points; widen it"
        )
    across = np.cross([0.0, 0.0, 1.0] if abs(normal[2]) < 0.9 else [1.0, 0.0, 0.0], normal)
    axes = np.stack([across / np.linalg.norm(across), np.cross(normal, across / np.linalg.norm(across))])
    inside = _lattice_inside(local @ axes.T, spacing)
    if not len(inside):
        raise InputError(f"no point of the polygon lies on a lattice of {spacing:g}; use a smaller spacing")
    return point_sensors(
        middle + inside @ axes, np.tile(normal, (len(inside), 1)), np.full(len(inside), length / len(inside))
    )


def _lattice_inside(ring: NDArray[np.float64], spacing: float) -> NDArray[np.float64]:
    """(m, 2) float64: the points of a square lattice inside a polygon in the plane, (n, 2), by the even-odd rule."""
    first, last = np.ceil(ring.min(0) / spacing - 0.5), np.floor(ring.max(0) / spacing - 0.5)
    x, y = (np.arange(a, b + 1) for a, b in zip(first, last))
    at = (np.stack(np.meshgrid(x, y), -1).reshape(-1, 2) + 0.5) * spacing
    inside = np.zeros(len(at), bool)
    for a, b in zip(ring, np.roll(ring, -1, 0)):
        if a[1] != b[1]:
            crosses = (at[:, 1] < a[1]) != (at[:, 1] < b[1])
            inside ^= crosses & (at[:, 0] < a[0] + (at[:, 1] - a[1]) / (b[1] - a[1]) * (b[0] - a[0]))
    return at[inside]


# --- The visible share ------------------------------------------------------------------------------------------------


@with_keywords(VisibleOptions, 3)
@with_progress
def visible_share(
    given: Given[_P], scene: SceneLike, sensors: Sensors | str | ArrayLike, target: Turbine | Sensors | ArrayLike,
    progress: Progress = None, *args: _P.args, **keywords: _P.kwargs,
) -> Table:  # fmt: skip
    """The share of a target that each sensor sees. Every line of sight is exact.

    Parameters
    ----------
    scene : Scene, PagedScene, or anything that `antumbra.load` takes
    sensors : Sensors, str, or (n, 3) float
        The places to look from, such as ``"raster+1.6"``: 1.6 above all cells.
    target : Turbine, Sensors, or (m, 3) float
        The target's sample points: those of `surface_points` and `polygon_points` are visible from their front only,
        other points from everywhere. Of a `Turbine`, the disk of the rotor that faces each sensor is sampled.
    progress : function of (text, done, total), or bool, optional
        As for `antumbra.viewshed`.

    Returns
    -------
    Table
        The columns are ``share``, from 0 to 1, and ``visible``, the number of visible sample points. `Table.about` has
        their total, ``samples``.

    Raises
    ------
    InputError
        If an argument is invalid, the target has no points or is in degrees, or the rotor of a turbine reaches below
        the ground.

    Warns
    -----
    UserWarning
        If points lie beside the scene, below the ground, on a surface without a normal, or closely behind another one.
    """
    options, scene = VisibleOptions(**given(*args, **keywords)), measured_scene(scene)
    plan, threads, moment = options.plan, thread_count(options.threads), scene.clamped(options.time)
    checked = sensors_of(sensors, scene, threads) if isinstance(sensors, str) else sensors
    places = sensors_from(scene, checked, None, "sensors")
    ends = sightline_ends(scene, places)
    notes = notes_on_sensors(scene, places, "sensors", moment, threads)
    if isinstance(target, Turbine):
        notes += _notes_on_turbine(scene, target, moment, threads)
        total = options.samples
        marks = np.array([_rotor(target, scene.up).center])
    else:
        on_target = sensors_from(scene, target, None, "the target")
        if not len(on_target):
            raise InputError("the target has no points; give at least one")
        notes += notes_on_sensors(scene, on_target, "points of the target", moment, threads)
        total, marks = len(on_target), on_target.points.mean(0, keepdims=True)
    warned = tell(notes)
    counts, step = np.zeros(len(places), np.int32), max(1024, _PAIRS // total)
    tracing = TileTracer(scene, plan, moment, threads, len(places) * total)
    with report_progress(f"{len(places)} sensors, {total} points of the target") as report:
        for first in range(0, len(places), step):
            part = ends.take(slice(first, first + step))
            if isinstance(target, Turbine):
                counts[first : first + step] = _seen_of_rotor(scene, part, target, total, (plan, moment, threads))
            else:
                seen = tracing.visible(part, sightline_ends(scene, on_target))
                counts[first : first + step] = count_occluded(seen, threads)
            report(min(first + step, len(places)), len(places))
    columns = {
        "share": Column((counts / total).astype(np.float32), "", "visible share of the target"),
        "visible": Column(counts, "", f"visible sample points, of {total}"),
    }
    return Table(places, columns, {"job": "visible share", "samples": total, **warned}, scene, marks=marks)


def share_summary(table: Table, scene: str, seconds: float) -> Summary:
    """How many sensors see the target; `seconds`: of the study."""
    counted = table.sensors.covered
    share, n, points = table["share"][counted], int(counted.sum()), table.about["samples"]
    some, whole = int((share > 0).sum()), int((share == 1).sum())
    values = {"scene": scene, "sensors": n, "samples": points, "seconds": seconds, "seen": some, "seen_entirely": whole}
    lines = [("sensors", f"{n:,}"), ("points of the target", f"{points:,}")]
    return Summary(values, [*lines, ("see it", f"{some:,}, {whole:,} entirely")])


def _notes_on_turbine(scene: AnyScene, turbine: Turbine, time: float, threads: int) -> list[str]:
    """Notes on the foot of a turbine. Raises InputError if its rotor reaches below the ground."""
    foot, up = np.array(turbine.position), np.eye(3)["xyz".index(scene.up)]
    lowest = turbine.hub_height - turbine.rotor_diameter / 2.0
    notes = notes_on_points(scene, foot[None], "turbines", time, threads)
    (depth, reach) = depths_below_ground(scene, np.stack([foot, foot + lowest * up]), time, threads)
    if reach > 0.0:
        ground = foot @ up + depth
        cure = (
            f"the ground there is at {ground:.6g}" if depth > 0.0 else f"its lowest point is {lowest:g} above its foot"
        )
        raise InputError(f"the turbine's rotor reaches {reach:.6g} below the ground; {cure}")
    return notes


def _seen_of_rotor(
    scene: AnyScene, ends: Receivers, turbine: Turbine, samples: int, settings: tuple[str | Plan | None, float, int]
) -> NDArray[np.int32]:
    """(n,) int32: the visible samples of the disk of a rotor that faces each end."""
    plan, time, threads = settings
    rotor, engine = _rotor(turbine, scene.up), scene.engine.with_options(plan, threads, None)
    (traced,) = engine.shadows(ends, [rotor], [light_samples(rotor, samples)], time=time, whole=True)
    counts: NDArray[np.int32] = samples - count_occluded(traced.bits[0], threads)
    return counts
