"""How much of a target is visible: a facade, a polygon, any points, or the rotor of a wind turbine."""

from collections.abc import Mapping, Sequence
from functools import cache, partial
from typing import Any, NamedTuple, ParamSpec, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...base.checks import number, points, text
from ...base.errors import InputError
from ...base.option_fields import Given, with_keywords
from ...base.progress import Progress, with_progress
from ...base.wording import counted
from ...engine.measured_scenes import measured_scene
from ...engine.scene import AnyScene
from ...engine.scene_loading import SceneLike
from ...kernels.parallel import thread_count
from ...query.receivers import Receivers
from ...query.shadow_query import count_occluded
from ...work.executors import Keep, checked_keep, executor_of
from ...work.result_summary import Summary
from ...work.scene_records import scene_digest
from ...work.work_parts import about_parts, inexact_plan
from ..sensors.block_parts import BlockParts, warned_by_block
from ..sensors.curved_earth import Earth, curvature_record, earth_of, lowered_scene
from ..sensors.point_checks import notes_on_sensors, tell
from ..sensors.sensor_blocks import DescribedSensors, SensorBlocks
from ..sensors.sensor_files import sensor_blocks
from ..sensors.sensors import Sensors, point_sensors, sensors_from, sightline_ends
from ..sensors.surface_grid import grid_sensors
from ..tables.partitions import Partitions
from ..tables.result_table import Column, Table
from ..tables.table_blocks import TableBlocks
from .sight_options import VisibleOptions
from .turbines import Turbine, Turbines, hubs_of, notes_on_turbines, on_ground, seen_of_rotors, turbines_of
from .visibility_matrix import TileTracer

SENSORS_PER_PART = 1 << 16
_PAIRS = 1 << 24  # sightlines at a time
_FLAT = 1e-6  # largest distance of a polygon's corner from its plane, in sizes of the polygon
_MOST = 1_000_000  # points of a target
_MOST_SHARES = 1 << 29  # shares of rotors

_P = ParamSpec("_P")

# --- Targets ----------------------------------------------------------------------------------------------------------


def surface_points(
    scene: SceneLike, spacing: float, *, objects: str | list[str] | None = None,
    types: str | list[str] | None = None, lift: float = 0.0,
) -> Sensors:  # fmt: skip
    """Place points on part of a scene, such as a facade, as a target: `grid_sensors` on some objects or surfaces.

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

    Examples
    --------
    >>> temple = at.examples.temple()
    >>> at.surface_points(temple, 2.0, objects="steps")
    Sensors(584 of kind 'points')
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
    """Place points in a flat polygon, as a target visible from the side on which its corners run counterclockwise.

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

    Examples
    --------
    >>> at.polygon_points([[0, 0, 0], [4, 0, 0], [4, 0, 3], [0, 0, 3]], spacing=1.0)
    Sensors(12 of kind 'points')
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
    given: Given[_P], scene: SceneLike, sensors: Sensors | str | ArrayLike,
    target: "Turbine | Sequence[Turbine] | Mapping[str, Turbine] | Sensors | ArrayLike",
    surface: "SceneLike | None" = None, keep: Keep = None, progress: Progress = None, *args: _P.args,
    **keywords: _P.kwargs,
) -> Table:  # fmt: skip
    """Find how much of a target each sensor sees. Every line of sight is exact.

    Parameters
    ----------
    scene : Scene, PagedScene, or anything that `antumbra.load` takes
    sensors : Sensors, str, or (n, 3) float
        The places to look from, such as ``"raster+1.6"``: 1.6 above all cells.
    target : Turbine, sequence of Turbine, dict of str to Turbine, Sensors, or (m, 3) float
        The target's sample points: those of `surface_points` and `polygon_points` are visible from their front only,
        other points from everywhere. Of a `Turbine`, the disk of the rotor that faces each sensor is sampled.
    surface : Scene, PagedScene, or anything that `antumbra.load` takes, optional
        As for `antumbra.viewshed`.
    keep : str, path-like or executor, optional
        As for `antumbra.viewshed`.
    progress : function of (text, done, total), or bool, optional
        As for `antumbra.viewshed`.

    Returns
    -------
    Table
        The columns are ``share``, from 0 to 1, and ``visible``, the number of visible sample points. For a sequence or
        dict of turbines, ``turbines`` comes first, the number of those in sight, even in part; ``share`` is that
        of the area of all rotors, and ``share_NAME`` that of each rotor, named by the dict or by numbers from 1.
        `Table.about` has the total of sample points, ``samples``. None if the executor leaves parts to other shards.

    Raises
    ------
    InputError
        If an argument is invalid, the target has no points or is in degrees, a rotor reaches below the ground, a foot
        is to be placed on a surface where there is none, or, with `curvature`, the scene is in a store or lets light
        through.

    Warns
    -----
    UserWarning
        If points lie beside the scene, below the ground, on a surface without a normal, or closely behind another one.

    Notes
    -----
    With `curvature`, points at a horizontal distance d sink by (1 - k) d^2 / (2 R); see `antumbra.viewshed`.

    Examples
    --------
    >>> wall = at.Scene.from_arrays([[-9, 5, 0], [9, 5, 0], [9, 5, 3], [-9, 5, 3]], [[0, 1, 2], [0, 2, 3]], up="z")
    >>> mast = [[0, 9, z] for z in (1, 3, 5, 7)]
    >>> at.visible_share(wall, [[0, 0, 2], [0, 7, 2]], mast)["share"]
    array([0.5, 1. ], dtype=float32)
    """
    options = VisibleOptions(**given(*args, **keywords))
    found = visible_blocks(scene, options, sensors, target, surface, keep)
    if found is None:
        return None  # type: ignore[return-value]  # a shard, of a command
    table = found.whole()
    found.close()
    return table


def visible_blocks(
    scene: SceneLike, options: VisibleOptions, sensors: SensorBlocks | str | ArrayLike,
    target: "Turbine | Sequence[Turbine] | Mapping[str, Turbine] | Sensors | ArrayLike", surface: "SceneLike | None",
    keep: Keep, partitioned: bool = False,
) -> Table | TableBlocks | None:  # fmt: skip
    """The table of `visible_share`, made by block if the sensors are described. Its `close` removes finished parts.

    partitioned : as for `sun_blocks`
    """
    keep, scene = checked_keep(keep), measured_scene(scene)
    threads, moment = thread_count(options.threads), scene.clamped(options.time)
    below = scene if surface is None else measured_scene(surface)
    named = sensor_blocks(sensors, below, threads) if isinstance(sensors, str) else sensors
    described = named if isinstance(named, DescribedSensors) else None
    places: SensorBlocks = described or sensors_from(scene, cast(Any, named), None, "sensors")
    earth, executor = earth_of(options, scene), executor_of(keep)
    notes = [] if described else notes_on_sensors(below, cast(Sensors, places), "sensors", moment, threads)
    turbines, on_target = turbines_of(target), None
    if turbines is not None:
        if options.on_surface:
            turbines = on_ground(below, turbines, moment, threads)
        notes += notes_on_turbines(below, turbines, moment, threads)
        total, marks = options.samples * len(turbines.each), hubs_of(turbines, scene.up)
        aims: list[Any] = [[list(map(str, each)) for each in turbines.each], turbines.names]
    else:
        if options.on_surface:
            raise InputError("on_surface places the feet of turbines, and the target is none; leave it out")
        on_target = sensors_from(scene, target, None, "the target")  # type: ignore[arg-type]
        if not len(on_target):
            raise InputError("the target has no points; give at least one")
        notes += notes_on_sensors(below, on_target, "points of the target", moment, threads)
        total, marks, aims = len(on_target), on_target.points.mean(0, keepdims=True), on_target.description
    warned = tell(notes)
    lines = cache(lambda: _lines_in(scene, earth, moment))
    if turbines is not None and not described and len(places) * len(turbines.each) > _MOST_SHARES:
        raise InputError(
            f"{counted(len(turbines.each), 'turbine')} from {counted(len(places), 'sensor')} make "
            f"{len(places) * len(turbines.each):,} shares; "
            "use fewer sensors, or fewer turbines at once"
        )

    def counts(some: Sensors) -> dict[str, np.ndarray]:
        if turbines is not None:
            return {"counts": _counts_of_rotors(lines(), some, turbines, options)}
        assert on_target is not None
        return {"counts": _counts_of_points(lines(), some, on_target, options, len(places))}

    about = None
    if executor.folder is not None:
        settings = options.samples, options.curvature, list(curvature_record(options, scene).values())
        of = scene_digest(scene, moment, threads)
        about = about_parts("visible", of, inexact_plan(options.plan), settings, *places.description, *aims)
    noted = partial(notes_on_sensors, below, what="sensors", time=moment, threads=threads) if described else None
    title = f"{counted(len(places), 'sensor')}, {counted(total, 'point')} of the target"
    blocks = BlockParts(title, places, SENSORS_PER_PART, counts, executor.folder, about, noted)
    of_study: dict[str, Any] = {"job": "visible share", "samples": total}
    of_study |= {} if turbines is None else {"targets": turbines.names}
    of_study |= curvature_record(options, scene)

    def table_of(some: Sensors, found: np.ndarray) -> Table:
        if turbines is None:
            columns = _point_columns(found, total)
        else:
            columns = _rotor_columns(found, turbines, options.samples, not isinstance(target, Turbine))
        return Table(some, columns, dict(of_study), scene, marks=marks)

    def block_of(some: Sensors, k: int) -> Table:
        return table_of(some, sums[k]["counts"])

    sums, partitions = blocks.parts, None
    if described is not None and partitioned and executor.folder is not None and len(described):
        partitions = Partitions(blocks, [], block_of, described, scene, [of_study, isinstance(target, Turbine)])
    if not executor.finish([blocks.parts]):
        return None
    of_study |= warned_by_block(notes, blocks) if described else warned
    close = partial(executor.end, [blocks.parts])
    if partitions is not None:
        made = lambda some, columns: Table(some, columns, dict(of_study), scene, marks=marks)
        return TableBlocks.of_partitions(partitions, made, close)
    if described is None:
        table = table_of(cast(Sensors, places), blocks.whole()["counts"])
        close()
        return table
    whole = lambda some: table_of(some, blocks.whole()["counts"])
    return TableBlocks(described, blocks.parts.ranges, block_of, whole, close)


class _Sightlines(NamedTuple):
    """Where lines of sight are traced."""

    scene: AnyScene  # on a curved earth, the lowered one
    time: float
    earth: Earth | None = None

    def ends(self, sensors: Sensors) -> Receivers:
        """Points as ends of lines of sight."""
        return sightline_ends(self.scene, sensors if self.earth is None else self.earth.lowered_sensors(sensors))


def _lines_in(scene: AnyScene, earth: Earth | None, time: float) -> _Sightlines:
    """Lines of sight in a scene, on a curved earth if there is one."""
    return _Sightlines(scene, time) if earth is None else _Sightlines(lowered_scene(scene, earth, time), 0.0, earth)


def _counts_of_points(
    lines: _Sightlines, places: Sensors, target: Sensors, options: VisibleOptions, later: int
) -> NDArray[np.int32]:
    """(n,) int32: the points of the target that each sensor sees; `later`: number of all sensors."""
    n, total, threads = len(places), len(target), thread_count(options.threads)
    counts, step, ends, targets = (
        np.zeros(n, np.int32),
        max(1024, _PAIRS // total),
        lines.ends(places),
        lines.ends(target),
    )
    tracing = TileTracer(lines.scene, options.plan, lines.time, threads, later * total)
    for first in range(0, n, step):
        seen = tracing.visible(ends.take(slice(first, first + step)), targets)
        counts[first : first + step] = count_occluded(seen, threads)
    return counts


def _point_columns(counts: NDArray[np.int32], total: int) -> dict[str, Column]:
    """The columns for a target of points."""
    return {
        "share": Column((counts / total).astype(np.float32), "", "visible share of the target"),
        "visible": Column(counts, "", f"visible sample points, of {total}"),
    }


def _counts_of_rotors(
    lines: _Sightlines, places: Sensors, turbines: Turbines, options: VisibleOptions
) -> NDArray[np.int32]:
    """(n, k) int32: the sample points of each rotor that each sensor sees."""
    n, k, samples = len(places), len(turbines.each), options.samples
    counts, step, ends = np.zeros((n, k), np.int32), max(1024, _PAIRS // (samples * k)), lines.ends(places)
    settings = options.plan, lines.time, thread_count(options.threads)
    for first in range(0, n, step):
        part = ends.take(slice(first, first + step))
        counts[first : first + step] = seen_of_rotors(lines.scene, part, turbines, lines.earth, samples, settings)
    return counts


def _rotor_columns(counts: NDArray[np.int32], turbines: Turbines, samples: int, named: bool) -> dict[str, Column]:
    """The columns for turbines; `named`: also for each of them."""
    k = len(turbines.each)
    weights = turbines.areas / turbines.areas.sum() / samples
    share = np.minimum(counts @ weights, 1.0).astype(np.float32)
    visible = Column(counts.sum(1, dtype=np.int32), "", f"visible sample points, of {samples * k}")
    if not named:
        return {"share": Column(share, "", "visible share of the target"), "visible": visible}
    columns = {
        "turbines": Column((counts > 0).sum(1).astype(np.int32), "", f"turbines in sight, of {k}"),
        "share": Column(share, "", "visible share of the area of all rotors"),
        "visible": visible,
    }
    for name, seen in zip(turbines.names, counts.T):
        about = f"visible share of the rotor of {name}"
        columns[f"share_{name}"] = Column((seen / samples).astype(np.float32), "", about)
    return columns


def share_summary(table: Table | TableBlocks, scene: str, seconds: float) -> Summary:
    """How many sensors see the target; `seconds`: of the study."""
    totals, points = table.totals, table.about["samples"]
    visible, n = totals["visible"], totals["visible"].rows
    some, whole = visible.positive, 0 if visible.counts is None else visible.counts[float(points)]
    values = {"scene": scene, "sensors": n, "samples": points, "seconds": seconds, "seen": some, "seen_entirely": whole}
    lines = [("sensors", f"{n:,}"), ("points of the target", f"{points:,}")]
    if (turbines := totals.get("turbines")) is not None:
        number, most = len(table.about["targets"]), int(turbines.most) if n else 0
        values |= {"turbines": number, "most_turbines": most}
        lines.append(("turbines", f"{number:,}; at most {most:,} seen from one sensor"))
    values["mean_share"] = totals["share"].mean
    return Summary(values, [*lines, ("see it", f"{some:,}, {whole:,} entirely")])
