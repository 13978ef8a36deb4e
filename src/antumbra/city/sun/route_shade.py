"""`route_shade`: how much of each hour the stations along a route are in shade, and how much of the route is."""

import os
from collections.abc import Iterable, Sequence
from datetime import date
from typing import Any, NamedTuple, ParamSpec

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...base.checks import number
from ...base.files import atomic_output, checked_output
from ...base.option_fields import Given, with_keywords
from ...base.progress import Progress, with_progress
from ...base.wording import counted
from ...engine.measured_scenes import measured_scene
from ...engine.scene_loading import SceneLike
from ...kernels.parallel import thread_count
from ...sun.location import checked_place_of
from ...sun.sun_positions import days_of, suns_of, times_of, zone_of
from ...work.executors import Keep
from ...work.result_summary import Summary, SummaryTable
from ..sensors.point_checks import raised
from ..sensors.sensors import Sensors, point_sensors
from ..sight.line_points import points_along
from ..tables.result_table import Column, Table
from .route_options import RouteOptions
from .sun_hours import sun_hours

_P = ParamSpec("_P")

_SUFFIXES = (".csv",)


class RouteShade(NamedTuple):
    """The shade along a route."""

    table: Table  # a row per station: distance, length, shade, and shade_HH of each hour with sun
    hours: NDArray[np.int64]  # (h,) hours of the day with sun, local time
    sun_hours: NDArray[np.float64]  # (h,) h: with the sun above the horizon, of all days
    shade: NDArray[np.float64]  # (h,) share of the route in shade, a mean over the hour, weighted by length

    def save_hours(self, path: str | os.PathLike[str]) -> None:
        """Write a .csv file with a row per hour of the day: hour, sun_hours and shade.

        Raises
        ------
        InputError
            If the suffix is unknown, or the path cannot be written.
        """
        rows = zip(self.hours.tolist(), self.sun_hours.tolist(), self.shade.tolist())
        text = "".join(f"{hour},{sun:.6g},{shade:.6g}\n" for hour, sun, shade in rows)
        with atomic_output(checked_output(path, _SUFFIXES)) as temporary:
            temporary.write_text("hour,sun_hours,shade\n" + text)

    def summary(self, scene: str, seconds: float) -> Summary:
        """The length of the route, and its share in shade by hour; `seconds`: of the study."""
        length = float(self.table["length"].sum())
        values: dict[str, Any] = {"scene": scene, "stations": len(self.table), "length": length, "seconds": seconds}
        values["shade"] = float(np.average(self.shade, weights=self.sun_hours))
        unit = self.table.about.get("length_unit", "m")
        lines = [("route", f"{length:,.6g} {unit}, {counted(len(self.table), 'station')}")]
        lines.append(("shade", f"{100.0 * values['shade']:.1f} % of the time with sun"))
        records = [{"hour": int(hour), "shade": round(float(shade), 4)} for hour, shade in zip(self.hours, self.shade)]
        rows = [
            [f"{hour:02d}-{hour + 1:02d} h", f"{100.0 * shade:.1f} %"] for hour, shade in zip(self.hours, self.shade)
        ]
        return Summary(values, lines, {"hours": records}, SummaryTable(["hour", "route in shade"], rows))


@with_keywords(RouteOptions, 4)
@with_progress
def route_shade(
    given: Given[_P], scene: SceneLike, line: "ArrayLike | Sequence[ArrayLike] | str | os.PathLike[str]",
    spacing: float, days: str | Iterable[date], surface: "SceneLike | None" = None, keep: Keep = None,
    progress: Progress = None, *args: _P.args, **keywords: _P.kwargs,
) -> RouteShade:  # fmt: skip
    """Find how much of each hour the stations along a route are in shade.

    Parameters
    ----------
    scene : Scene, PagedScene, or anything that `antumbra.load` takes
    line : (n, 2) or (n, 3) float, a sequence of such arrays, str or path-like
        The route, as for `antumbra.points_along`, along the axes of the scene. Files in another CRS are moved to its.
    spacing : float
        World units between stations, in plan. Each stands in the middle of an equally long piece.
    days : str or iterable of date
        As for `antumbra.sun_hours`. Hours of the day are those of all days together.
    surface : Scene, PagedScene, or anything that `antumbra.load` takes, optional
        The scene on which stations are placed: the one without trees, if `scene` has those of `antumbra.from_trees`.
        None: `scene`.
    keep : str, path-like or executor, optional
        As for `antumbra.sun_hours`.
    progress : function of (text, done, total), or bool, optional
        As for `antumbra.sun_hours`.

    Returns
    -------
    RouteShade
        Its table has a row per station: "distance" along the route and "length" of its piece, world units; "shade", the
        share of the time with the sun above the horizon; and "shade_08", that from 8 to 9 o'clock, for each hour of the
        day with sun. None if the executor leaves parts to other shards.

    Raises
    ------
    InputError
        As for `antumbra.sun_hours` and `antumbra.points_along`, or if there is no surface to place a station on.

    Warns
    -----
    UserWarning
        As for `antumbra.sun_hours`.
    """
    options, scene = RouteOptions(**given(*args, **keywords)), measured_scene(scene)
    place = checked_place_of(scene, options.place)
    chosen = days_of(days)
    stations, lengths = _stations(scene, surface, line, spacing, options)
    suns = suns_of(place, times_of(chosen, zone_of(place), options.step), scene.up)
    names = "curvature", "refraction", "earth_radius", "samples", "plan", "threads", "step"
    found = sun_hours(
        scene, stations, chosen, by=("hour",), place=place, keep=keep,
        **{name: getattr(options, name) for name in names},
    )  # fmt: skip
    if found is None:
        return None  # a shard, of a command
    hour = (suns.local.astype("datetime64[h]") - suns.local.astype("datetime64[D]")).astype(np.int64)
    possible = np.bincount(hour, suns.hours, 24)
    hours, unit = np.flatnonzero(possible), scene.unit.name
    columns = {
        "distance": Column(np.cumsum(lengths) - lengths / 2.0, unit, "distance of the station along the route"),
        "length": Column(lengths, unit, "length of its piece of the route"),
        "shade": Column(_share(found["sun_hours"], possible.sum()), "", "share of the time with sun in shade"),
    }
    shares = np.stack([_share(found[f"hours_{each:02d}"], possible[each]) for each in hours.tolist()])
    for each, share in zip(hours.tolist(), shares):
        columns[f"shade_{each:02d}"] = Column(share, "", f"share of the hour from {each} in shade")
    about = {**found.about, "job": "route shade", "spacing": spacing}
    table = Table(found.sensors, columns, about, scene)
    return RouteShade(
        table, hours, np.asarray(possible[hours], np.float64), np.asarray(shares @ lengths / lengths.sum(), np.float64)
    )


def _share(hours: NDArray[np.float64], possible: float) -> NDArray[np.float64]:
    """(n,) float64: the share of possible hours without sun."""
    return np.clip(1.0 - np.asarray(hours, np.float64) / possible, 0.0, 1.0)


def _stations(
    scene: Any, surface: "SceneLike | None", line: Any, spacing: float, options: RouteOptions
) -> tuple[Sensors, NDArray[np.float64]]:
    """The stations, at their heights, and the lengths of their pieces."""
    found = points_along(line, number(spacing, "the spacing of stations", 0.0, np.inf), crs=scene.crs, up=scene.up)
    below = scene if surface is None else measured_scene(surface)
    settings = options.eye_height, options.on_surface, "stations", 0.0, thread_count(options.threads)
    return raised(below, point_sensors(found.points), *settings), found.lengths
