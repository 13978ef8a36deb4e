"""`skyline`: the elevation of the horizon that points see, by azimuth, and its writers."""

import json
import os
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import cache
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, ParamSpec

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...base.checks import as_array, checked_instance, flag, number, whole_number
from ...base.errors import InputError
from ...base.extras import import_extra
from ...base.files import atomic_output, checked_output
from ...base.option_fields import Given, with_keywords
from ...base.progress import Progress, report_progress, with_progress
from ...base.wording import counted, place_text
from ...bvh.nodes import Bvh
from ...engine.measured_scenes import measured_scene, middle_of
from ...engine.paged_scene import PagedScene
from ...engine.precompilation import precompile
from ...engine.scene import AnyScene, Scene
from ...engine.scene_loading import SceneLike
from ...engine.small_scenes import UP, small_scene
from ...kernels.elementary import atan, atan2, cos, sin
from ...kernels.parallel import thread_count
from ...scene.map_point import map_point, on_earth
from ...sun.location import Place, place_of_crs
from ...trace.rays.ray_hits import intersections
from ...work.executors import Keep, checked_keep, executor_of
from ...work.result_summary import Summary, SummaryTable, heading
from ...work.scene_records import scene_digest
from ...work.work_parts import Parts, about_parts
from ..sensors.curved_earth import curvature_record, earth_of, lowered_scene
from ..sensors.point_attributes import Attributes, with_attributes
from ..sensors.point_checks import notes_on_sensors, raised, tell
from ..sensors.sensor_files import check_sensors, sensors_of
from ..sensors.sensors import Sensors, point_sensors, sensors_from, sightline_ends
from ..sheets.page import MAP_SUFFIXES, check_map
from ..sheets.sheet import save_report
from ..sheets.sheet_options import Sheet, checked_sheet
from ..tables.result_table import Column, Table, csv_texts, plain_values
from .edge_projection import Compass, Slopes, compass_of, raise_slopes
from .horizon_diagram import horizon_report
from .skyline_options import SkylineOptions

if TYPE_CHECKING:
    import pandas

_P = ParamSpec("_P")

SUFFIXES = ".csv", ".json", ".npz", ".txt"
"""Suffixes of the files that `Skyline.save` writes."""

_PLAN = "bsah+wide"  # its tree is shared with the ray queries of most scenes
_DECIMALS = 6  # of degrees in text files
POINTS_PER_PART = 1 << 10
_MOST_POINTS = 20  # most points in a summary

# --- Results ----------------------------------------------------------------------------------------------------------


class Skyline(NamedTuple):
    """The skylines of n points at m azimuths.

    Azimuths are equally spaced. Elevations are suprema: -90 where there is nothing, 90 everywhere below a roof.
    `highest` is never lower than `elevation`, so nothing between two azimuths is missed.
    """

    points: np.ndarray  # (n, 3) float64, world: the eyes
    azimuth: np.ndarray  # (m,) float64, degrees clockwise from true north, from 0
    elevation: np.ndarray  # (n, m) float64, degrees above the horizontal: of what lies along each azimuth
    highest: np.ndarray  # (n, m) float64, degrees: of what lies within half a step, both ends included
    about: dict[str, Any]  # metadata of the study, in JSON types
    attributes: Attributes = {}  # noqa: RUF012 - name -> (n,): other columns of the file of points

    def __repr__(self) -> str:
        return f"Skyline({counted(len(self.points), 'point')} x {counted(len(self.azimuth), 'azimuth')})"

    def sky_view_factor(self, tilt: float = 0.0, azimuth: float = 180.0) -> NDArray[np.float64]:
        """(n,) float64: the share of a uniform sky's light that arrives above the skyline on a plane at each point.

        The integral over elevations is exact; that over azimuths is the mean of those of `elevation`. Without
        obstacles it is (1 + cos(tilt)) / 2. `antumbra.sky_view` also counts sky below bridges and overhangs.

        Parameters
        ----------
        tilt : float
            Degrees between the plane and the horizontal, 0 to 180.
        azimuth : float
            Degrees clockwise from true north: where the plane faces.

        Raises
        ------
        InputError
            If an angle is out of range.
        """
        tilt = np.radians(number(tilt, "tilt (degrees)", 0.0, 180.0, "[]"))
        facing = cos(np.radians(self.azimuth - number(azimuth, "azimuth (degrees)", -360.0, 360.0, "[]")))
        upward, forward = cos(tilt), sin(tilt) * facing
        # The plane sees the elevations e with upward sin(e) + forward cos(e) > 0, from `low` to `high`.
        low, high = np.maximum(np.radians(self.elevation), 0.0), np.full(len(self.azimuth), np.pi / 2.0)
        if upward >= 0.0:
            low = np.maximum(low, atan2(-forward, upward))
        else:
            high = np.maximum(atan2(forward, -upward), 0.0)
        low = np.minimum(low, high)

        def integral(e: Any) -> Any:
            return (upward * sin(e) ** 2 + forward * (e + sin(e) * cos(e))) / 2.0

        return np.asarray((integral(high) - integral(low)).mean(1) * 2.0)

    def userhorizon(self, point: int = 0, *, highest: bool = False) -> str:
        """The skyline of a point as PVGIS takes it: elevations in degrees from north clockwise, separated by commas.

        For the parameter ``userhorizon`` of PVGIS. Elevations below 0 become 0.

        Parameters
        ----------
        point : int
            Index of the point.
        highest : bool
            Use `highest` instead of `elevation`: the sun is never assumed to pass a pole between two azimuths.

        Raises
        ------
        InputError
            If there is no such point.
        """
        values = self._row(point, highest)
        return ",".join(f"{value:.{_DECIMALS}g}" for value in np.maximum(values, 0.0).tolist())

    def series(self, point: int = 0, *, highest: bool = False) -> "pandas.Series[float]":
        """The skyline of a point as a pandas Series of elevations by azimuth, as pvlib's PVGIS reader makes it.

        Parameters
        ----------
        point, highest
            As for `userhorizon`.

        Raises
        ------
        InputError
            If there is no such point, or pandas is missing.
        """
        pandas = import_extra("pandas", "series", "sun")
        index = pandas.Index(self.azimuth, name="horizon_azimuth")
        series: Any = pandas.Series(self._row(point, highest), index=index, name="horizon_elevation")
        return series

    def table(self) -> Table:
        """A `Table` with a row per point and azimuth: "point", "azimuth", "elevation" and "highest", in degrees."""
        n, m = self.elevation.shape
        columns = {
            "elevation": Column(self.elevation.ravel(), "degrees", "elevation of the horizon"),
            "highest": Column(self.highest.ravel(), "degrees", "highest elevation within half a step"),
            "point": Column(np.repeat(np.arange(n), m), "", "index of the point"),
            "azimuth": Column(np.tile(self.azimuth, n), "degrees", "clockwise from true north"),
        }
        sensors = point_sensors(np.repeat(self.points, m, axis=0))
        given = {name: np.repeat(values, m) for name, values in self.attributes.items()}
        return Table(replace(sensors, attributes=given), columns, dict(self.about))

    def save(self, path: str | os.PathLike[str], *, point: int | None = None, highest: bool = False) -> None:
        """Write the skylines in the format of the suffix.

        .csv has a row per point and azimuth; .json and .npz have the arrays and `about`; all have the `attributes`.
        .txt is the horizon file of PVGIS, for a single point: an elevation per line, from north clockwise.

        Parameters
        ----------
        path : str or path-like
        point : int, optional
            For .txt: index of the point. None: the only one.
        highest : bool
            For .txt: as for `userhorizon`.

        Raises
        ------
        InputError
            If the suffix is unknown, the path cannot be written, or a .txt file needs a point.
        """
        target, highest = checked_output(path, SUFFIXES), flag(highest, "highest")
        if point is not None:
            whole_number(point, "point", 0, len(self.points) - 1)
        suffix = target.suffix.lower()
        if suffix == ".txt":
            text = self.userhorizon(self._only(target, point), highest=highest).replace(",", "\n") + "\n"
            with atomic_output(target) as temporary:
                temporary.write_text(text)
            return
        with atomic_output(target) as temporary, open(temporary, "wb") as file:
            if suffix == ".npz":
                arrays = {name: getattr(self, name) for name in ("points", "azimuth", "elevation", "highest")}
                given = {name: values.astype("U") if values.dtype == object else values
                         for name, values in self.attributes.items()}  # fmt: skip
                arrays = with_attributes({}, given, {**arrays, "about": np.empty(0)})
                del arrays["about"]
                np.savez_compressed(file, allow_pickle=False, about=np.array(json.dumps(self.about)), **arrays)
            else:
                file.writelines(self._csv() if suffix == ".csv" else [self._json()])

    def save_map(
        self, path: str | os.PathLike[str], *, point: int | None = None, place: Place | None = None,
        title: str | None = None, sheet: Sheet | None = None,
    ) -> None:  # fmt: skip
        """Write a sheet for a report: a polar diagram of the horizon of a point, as PDF, SVG or PNG.

        North is up and the zenith in the middle. If the place is known, the diagram has the paths of the sun at the
        solstices and the equinox of March, with the hours of the place's time zone. A .pdf file has further pages: the
        elevations, the method, and the sources of the data. Needs ``antumbra[plot]``.

        Parameters
        ----------
        path : str or path-like
            A .pdf, .svg or .png file; .svg and .png hold the diagram.
        point : int, optional
            Index of the point. None: the only one.
        place : Place, optional
            None: that of the scene's CRS, from which `skyline` took the north. Its `north` is not used.
        title : str, optional
            None: that of the sheet, or "Skyline".
        sheet : Sheet, optional
            Paper and title block. None: A4.

        Raises
        ------
        InputError
            If the suffix is unknown, the path cannot be written, the sheet needs a point or there is no such point,
            `place` is no Place, the sheet has a scale or an extent, or matplotlib is missing.
        """
        target, chosen, k = check_map(path), checked_sheet(sheet, title), self._only(path, point)
        if place is not None:
            checked_instance(place, Place, "place")
        elif "latitude" in self.about:
            place = Place(self.about["latitude"], self.about["longitude"])
        save_report(target, horizon_report(self, k, place), chosen)

    def summary(self, scene: str, seconds: float) -> Summary:
        """The skylines of a scene, and the extremes of each, if they are few; `seconds`: of the study."""
        factors, n = self.sky_view_factor(), len(self.points)
        values = {"scene": scene, "points": n, "azimuths": len(self.azimuth), "seconds": seconds}
        values |= {"north": self.about["north"], "sky_view_factor": float(np.mean(factors))}
        lines = [("skylines", f"{counted(n, 'point')} x {counted(len(self.azimuth), 'azimuth')}")]
        if n > _MOST_POINTS:
            return Summary(values, lines)
        records = [
            {
                "point": place_text(point),
                "lowest": round(float(elevation.min()), 3),
                "highest": round(float(highest.max()), 3),
                "towards": float(self.azimuth[highest.argmax()]),
                "sky_view_factor": round(float(factor), 4),
            }
            for point, elevation, highest, factor in zip(self.points, self.elevation, self.highest, factors)
        ]
        rows = [[str(value) for value in record.values()] for record in records]
        table = SummaryTable([heading(name) for name in records[0]], rows, leads=True)
        return Summary(values, lines, {"skylines": records}, table)

    def _only(self, path: str | os.PathLike[str], point: int | None) -> int:
        """The index of a point; None: of the only one, else an InputError that names the file."""
        if point is None and len(self.points) != 1:
            raise InputError(f"{Path(path).name}: {_one_point(path)}, and there are {len(self.points)}; name a point")
        return whole_number(0 if point is None else point, "point", 0, len(self.points) - 1)

    def _row(self, point: int, highest: bool) -> NDArray[np.float64]:
        index = whole_number(point, "point", 0, len(self.points) - 1)
        row: NDArray[np.float64] = (self.highest if flag(highest, "highest") else self.elevation)[index]
        return row

    def _csv(self) -> Iterator[bytes]:
        own, results = dict.fromkeys(("point", "x", "y", "z")), dict.fromkeys(("azimuth", "elevation", "highest"))
        names: Any = with_attributes(own, self.attributes, results)  # type: ignore[arg-type]  # names alone matter
        yield (",".join(csv_texts(np.array([*names], object))) + "\n").encode()
        given = list(zip(*map(csv_texts, self.attributes.values()))) or [()] * len(self.points)
        for k, (at, *rows) in enumerate(zip(self.points, self.elevation, self.highest)):
            where = ",".join([str(k), *(str(c) for c in at.tolist()), *given[k]])
            columns = zip(self.azimuth.tolist(), *(np.round(row, _DECIMALS).tolist() for row in rows))
            yield "".join(f"{where},{azimuth},{e},{h}\n" for azimuth, e, h in columns).encode()

    def _json(self) -> bytes:
        rows = {name: np.round(getattr(self, name), _DECIMALS).tolist() for name in ("elevation", "highest")}
        document = {"about": self.about, "points": self.points.tolist(), "azimuth": self.azimuth.tolist(), **rows}
        if self.attributes:
            document["attributes"] = {name: plain_values(values) for name, values in self.attributes.items()}
        document["sky_view_factor"] = np.round(self.sky_view_factor(), _DECIMALS).tolist()
        return json.dumps(document, allow_nan=False).encode()


def check_skyline_output(path: Path, points: int) -> None:
    """Raise an InputError, before long work, unless `save` or `save_map` can write the skylines of some points."""
    suffix = path.suffix.lower()
    if suffix in MAP_SUFFIXES:
        check_map(path)
    else:
        checked_output(path, SUFFIXES)
    if suffix in (".txt", *MAP_SUFFIXES) and points != 1:
        raise InputError(f"{path.name}: {_one_point(path)}, and there are {points}; use .csv, .json or .npz")


def _one_point(path: str | os.PathLike[str]) -> str:
    """What the file is, which holds a single point."""
    return "a PVGIS file holds one point" if Path(path).suffix.lower() == ".txt" else "a diagram shows one point"


# --- The study --------------------------------------------------------------------------------------------------------


@with_keywords(SkylineOptions, 2)
@with_progress
def skyline(
    given: Given[_P], scene: SceneLike, points: Sensors | str | ArrayLike, normals: ArrayLike | None = None,
    surface: "SceneLike | None" = None, keep: Keep = None, progress: Progress = None, *args: _P.args,
    **keywords: _P.kwargs,
) -> Skyline:  # fmt: skip
    """Find the skylines of points: the elevation of the horizon by azimuth, exact up to the rounding of float64.

    The horizon is the upper edge of everything along an azimuth: what is open below a bridge or a canopy counts as
    closed, and points below a roof see no sky. Faces with alpha masks or transmittance count as solid. With
    `curvature`, what lies at a horizontal distance d is (1 - k) d^2 / (2 R) lower, as for `antumbra.viewshed`.

    Parameters
    ----------
    scene : Scene, or anything that `antumbra.load` takes
    points : Sensors, str, or (3,) or (n, 3) float
        World coordinates. A text is as in `antumbra.sensors_of`.
    normals : (3,) or (n, 3) float, optional
        For points on surfaces, towards the outer side: each is moved off its surface by a few units in the last place.
        Without normals, points lie in free space and are used unchanged.
    surface : Scene, or anything that `antumbra.load` takes, optional
        The scene on which points are placed, by a text or `on_surface`: the one without trees, if `scene` has
        the trees of `antumbra.from_trees`. None: `scene`.
    keep : str, path-like or executor, optional
        Folder for the finished parts of an interrupted study, or an executor for the parts; see
        `antumbra.work.executors`.
    progress : function of (text, done, total), or bool, optional
        Called during the work. False: show nothing. None: terminals and notebooks show a bar after a second.

    Returns
    -------
    Skyline
        None if the executor leaves parts to other shards.

    Raises
    ------
    InputError
        If an argument is invalid, points are in degrees or have no surface to be placed on, pyproj is missing for the
        CRS of the scene, or `curvature` is given for a scene in a store.

    Warns
    -----
    UserWarning
        If points lie beside the scene, below the ground, on a surface without a normal, or closely behind another one.

    Examples
    --------
    >>> wall = at.Scene.from_arrays([[-99, 5, 0], [99, 5, 0], [99, 5, 7], [-99, 5, 7]], [[0, 1, 2], [0, 2, 3]], up="z")
    >>> horizon = at.skyline(wall, [[0, 0, 2]])  # the top of the wall is 5 m away and 5 m above the eye
    >>> horizon.elevation[0, [0, 45, 180]].round(1)
    array([ 45. ,  35.3, -90. ])
    >>> horizon.sky_view_factor().round(3)
    array([0.854])
    """
    options, scene = SkylineOptions(**given(*args, **keywords)), measured_scene(scene)
    earth, keep = earth_of(options, scene), checked_keep(keep)
    threads, time = thread_count(options.threads), scene.clamped(options.time)
    below = scene if surface is None else measured_scene(surface)
    if isinstance(points, str):
        check_sensors(points, "points")
        points = sensors_of(points, below, threads)
    sensors = sensors_at(below, points, normals)
    sensors = raised(below, sensors, options.eye_height, options.on_surface, "points", time, threads)
    warned = tell(notes_on_sensors(below, sensors, "points", time, threads))
    north, place = options.north, None
    if north is None:
        place = place_of_crs(scene.crs, scene.bounds, scene.up) if scene.crs and on_earth(scene.crs) else None
        north = 0.0 if scene.crs is None else -map_point(scene.crs, *middle_of(scene)).convergence
    precompile("skyline")
    compass = compass_of(options.count, scene.up, north)
    copy = cache(lambda: scene if earth is None else lowered_scene(scene, earth, time))

    def work(first: int, last: int) -> dict[str, np.ndarray]:
        some = sensors.block(first, last)
        if earth is None:
            return _slopes_of(scene, some, compass, time, threads)._asdict()
        slopes = _slopes_of(copy(), earth.lowered_sensors(some), compass, 0.0, threads)
        _turn(slopes, earth.turns(some.points), compass)
        return slopes._asdict()

    executor, parts_about = executor_of(keep), None
    if executor.folder is not None:
        settings = options.count, north, options.curvature, list(curvature_record(options, scene).values())
        settings_of = *settings, sensors.kind == "raster", *sensors.description
        parts_about = about_parts("skylines", scene_digest(scene, time, threads), *settings_of)
    n = len(sensors)
    parts = Parts(f"skylines of {counted(n, 'point')}", n, POINTS_PER_PART, work, executor.folder, parts_about)
    if not executor.finish([parts]):
        return None  # type: ignore[return-value]  # a shard, of a command
    slopes = Slopes(**parts.taken(Slopes._fields))
    executor.end([parts])
    azimuth = np.arange(options.count) * (360.0 / options.count)
    about: dict[str, Any] = {
        "job": "skyline",
        "scene": scene.name,
        "azimuth_step": options.azimuth_step,
        "north": north,
        **warned,
    }
    about |= {"up": scene.up, "length_unit": scene.unit.name, **curvature_record(options, scene)}
    if scene.crs:
        about["crs"] = scene.crs
    if place is not None:
        about |= {"latitude": place.latitude, "longitude": place.longitude}
    elevation, highest = (np.degrees(atan(rows)) for rows in slopes)
    return Skyline(sensors.points, azimuth, elevation, highest, about, sensors.attributes)


def horizon_elevations(
    scene: AnyScene, sensors: Sensors, step: float, north: float, threads: int
) -> NDArray[np.float64]:
    """(n, m) float64: `Skyline.elevation` of sensors, without notes; north: as `SkylineOptions.north`."""
    precompile("skyline")
    compass = compass_of(round(360.0 / step), scene.up, north)
    return np.asarray(np.degrees(atan(_slopes_of(scene, sensors, compass, 0.0, threads).at)))


def sensors_at(scene: AnyScene, points: Sensors | ArrayLike, normals: ArrayLike | None) -> Sensors:
    """`points` if they are `Sensors`, else sensors at points, (3,) or (n, 3). Raises InputError if there are none."""
    at = points if isinstance(points, Sensors) else np.atleast_2d(as_array(points, "points"))
    sensors = sensors_from(scene, at, normals, "points")
    if not len(sensors):
        raise InputError("there is no point; give at least one")
    return sensors


def _slopes_of(scene: AnyScene, sensors: Sensors, compass: Compass, time: float, threads: int) -> Slopes:
    eyes = np.ascontiguousarray(sightline_ends(scene, sensors).origins[0])
    (count, trees), shape = _trees(scene, time, threads), (len(eyes), len(compass.east) // 2)
    slopes = Slopes(np.full(shape, -np.inf), np.full(shape, -np.inf))
    with report_progress("finding skylines") as report:
        for k, tree in enumerate(trees):

            def progress(done: int, total: int, k: int = k) -> None:
                report(k * total + done, count * total)

            closed = _below_roof(tree, eyes, scene, threads)
            slopes.at[closed], slopes.highest[closed] = np.inf, np.inf
            raise_slopes(tree, eyes, compass, slopes, threads, progress)
    return slopes


def _turn(slopes: Slopes, turns: NDArray[np.float64], compass: Compass) -> None:
    """Change the slopes in a scene that is lowered around its middle to those that points see, in place.

    turns : (n, 2), from `Earth.turns`

    The supremum of a bin is that of the copy plus the greatest change in the bin, so it stays an upper bound.
    """
    level = turns * [1.0, compass.sign]
    changes = level @ np.stack([compass.east, compass.north])  # (n, 2 m), at all half steps
    slopes.at[:] += changes[:, ::2]
    size = np.sqrt((level * level).sum(1))[:, None]
    around = np.abs(atan2(level[:, :1], level[:, 1:]) - atan2(compass.east[::2], compass.north[::2]))
    around = np.minimum(around, 2.0 * np.pi - around)  # between the bin's azimuth and that of the greatest change
    slopes.highest[:] += size * cos(np.maximum(around - 1.0 / compass.turn, 0.0))  # the bin ends a half step away


def _trees(scene: AnyScene, time: float, threads: int) -> tuple[int, Iterable[Bvh]]:
    """Trees over all triangles, and their number: of solid faces, and of faces with holes; or of each chunk of a store.

    Each is valid until the next one is requested.
    """
    if isinstance(scene, PagedScene):
        fixed = scene.engine.source.fixed
        assert fixed is not None
        more = [] if (cutouts := fixed.accelerated.cutouts) is None else [cutouts.bvh]
        return len(scene.store) + len(more), chain(scene.store.trees(), more)
    ready = scene.engine.with_options(_PLAN, threads, None).accelerated(time)
    assert ready.bvh is not None
    trees = [ready.bvh] if ready.cutouts is None else [ready.bvh, ready.cutouts.bvh]
    return len(trees), trees


def _below_roof(tree: Bvh, eyes: NDArray[np.float32], scene: AnyScene, threads: int) -> NDArray[np.bool_]:
    """(n,) bool: whether a surface lies straight above each eye, exactly."""
    up, reach = "xyz".index(scene.up), 2.0 * float(np.linalg.norm(np.ptp(scene.bounds, axis=0))) + 1.0
    ends = eyes.copy()
    ends[:, up] = np.maximum(ends[:, up], 0.0) + np.float32(reach)
    hits = intersections(tree, eyes, ends, np.full(len(eyes), -1, np.int32), threads)
    closed: NDArray[np.bool_] = np.diff(hits.first) > 0
    return closed


EXAMPLES = {"skyline": lambda: skyline(Scene.of_data(small_scene()), UP, azimuth_step=90.0, threads=1)}
"""The example calls of this study."""
