"""`sun_calendar`: the first and the last sun of each day at points, behind their real horizon."""

import os
from collections.abc import Iterable, Iterator
from datetime import date
from pathlib import Path
from typing import Any, NamedTuple, ParamSpec

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...base.checks import as_array, whole_number
from ...base.errors import InputError
from ...base.files import atomic_output, checked_output
from ...base.option_fields import Given, with_keywords
from ...base.progress import Progress, with_progress
from ...base.wording import counted
from ...engine.measured_scenes import measured_scene
from ...engine.scene import AnyScene
from ...engine.scene_loading import SceneLike
from ...kernels.elementary import tan
from ...kernels.parallel import thread_count
from ...query.light_samples import light_samples
from ...query.receivers import Receivers
from ...scene.light_lists import DirectionalLights
from ...scene.lights import MAX_SPP
from ...sun.location import Place, checked_place_of
from ...sun.sun_positions import Times, days_of, directions_of, months_of, solar_angles, times_of, zone_notes, zone_of
from ...work.executors import Keep, executor_of
from ...work.result_summary import Summary
from ...work.scene_records import scene_digest
from ...work.work_parts import Parts, about_parts, inexact_plan
from ..sensors.curved_earth import Earth, curvature_record, earth_of, lowered_scene
from ..sensors.point_attributes import names_of_rows
from ..sensors.point_checks import notes_on_sensors, raised, tell
from ..sensors.sensor_files import sensors_of
from ..sensors.sensors import Sensors, sensors_from
from ..sheets.page import MAP_SUFFIXES, check_map
from ..sheets.sheet import save_report
from ..sheets.sheet_options import Sheet, checked_sheet
from .calendar_diagram import calendar_report, clock_texts
from .route_options import CalendarOptions
from .sun_visibility import DISK, arriving_shares, seasons_of

_P = ParamSpec("_P")

SUFFIXES = (".csv",)
"""Suffixes of the files that `SunCalendar.save` writes."""

_POINTS = 64  # in a part
_NONE = np.datetime64("NaT", "s")

# --- Results ----------------------------------------------------------------------------------------------------------


class SunCalendar(NamedTuple):
    """The sun of n days at p points; local times to the second, NaT where there is none."""

    names: list[str]  # of the points: ids of their table, or numbers from 1
    points: NDArray[np.float64]  # (p, 3) world: the eyes
    days: NDArray[np.datetime64]  # (n,) datetime64[D]
    first: NDArray[np.datetime64]  # (p, n) datetime64[s]: the first sun
    last: NDArray[np.datetime64]  # (p, n): the last sun
    sunrise: NDArray[np.datetime64]  # (p, n): over an open horizon
    sunset: NDArray[np.datetime64]  # (p, n)
    hours: NDArray[np.float64]  # (p, n) h of sun, from suns a step apart
    about: dict[str, Any]  # metadata of the study, in JSON types

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write a .csv file with a row per point and day: point, date, sunrise, first_sun, last_sun, sunset, hours.

        Times are local, without a date: 08:14:05. They are empty where there is no sun.

        Raises
        ------
        InputError
            If the suffix is unknown, or the path cannot be written.
        """
        with atomic_output(checked_output(path, SUFFIXES)) as temporary, open(temporary, "w", newline="") as file:
            file.write("point,date,sunrise,first_sun,last_sun,sunset,hours\n")
            file.writelines(self._rows())

    def save_map(
        self, path: str | os.PathLike[str], *, point: int | None = None, title: str | None = None,
        sheet: Sheet | None = None,
    ) -> None:  # fmt: skip
        """Write a sheet for a report: a diagram of the days of a point, as PDF, SVG or PNG. Needs ``antumbra[plot]``.

        Days run to the right and hours up; the time between the first and the last sun is filled. A .pdf file has
        further pages: the times of each day, the method, and the sources of the data.

        Parameters
        ----------
        path : str or path-like
            A .pdf, .svg or .png file; .svg and .png hold the diagram.
        point : int, optional
            Index of the point. None: the only one.
        title : str, optional
            None: that of the sheet, or "First and last sun" with the name of the point.
        sheet : Sheet, optional
            Paper and title block. None: A4.

        Raises
        ------
        InputError
            If the suffix is unknown, the path cannot be written, there are several points and none is named, the sheet
            has a scale or an extent, or matplotlib is missing.
        """
        target, chosen = check_map(path), checked_sheet(sheet, title)
        if point is None and len(self.names) != 1:
            raise InputError(f"{target.name}: a diagram shows one point, and there are {len(self.names)}; name a point")
        k = whole_number(0 if point is None else point, "point", 0, len(self.names) - 1)
        save_report(target, calendar_report(self, k), chosen)

    def summary(self, scene: str, seconds: float) -> Summary:
        """The days with and without sun, and their hours; `seconds`: of the study."""
        dark = int(np.isnat(self.first).sum(1).max())
        values = {"scene": scene, "points": len(self.names), "days": len(self.days), "days_without_sun": dark}
        values |= {"hours": float(self.hours.sum(1).mean()), "seconds": seconds}
        several = len(self.names) > 1
        days = (
            f"{len(self.days):,}, {'at most ' if several and dark else ''}{f'{dark:,}' if dark else 'none'} without sun"
        )
        sun = f"{values['hours']:,.1f} h in all{', the mean of the points' if several else ''}"
        return Summary(values, [("points", f"{len(self.names):,}"), ("days", days), ("sun", sun)])

    def _rows(self) -> Iterator[str]:
        days = np.datetime_as_string(self.days).tolist()
        for k, name in enumerate(self.names):
            quoted = '"' + name.replace('"', '""') + '"' if set(name) & set(',"\r\n') else name
            times = [clock_texts(each[k]) for each in (self.sunrise, self.first, self.last, self.sunset)]
            for day, *row, hours in zip(days, *times, self.hours[k].tolist()):
                yield f"{quoted},{day},{','.join(row)},{hours:.4g}\n"


def check_calendar_output(path: Path, points: int) -> None:
    """Raise an InputError, before long work, unless `save` or `save_map` can write the calendar of some points."""
    if path.suffix.lower() not in MAP_SUFFIXES:
        checked_output(path, SUFFIXES)
    elif points != 1:
        check_map(path)
        raise InputError(f"{path.name}: a diagram shows one point, and there are {points}; use .csv")


# --- The study --------------------------------------------------------------------------------------------------------


@with_keywords(CalendarOptions, 3)
@with_progress
def sun_calendar(
    given: Given[_P], scene: SceneLike, points: Sensors | str | ArrayLike, days: str | Iterable[date],
    surface: "SceneLike | None" = None, keep: Keep = None, progress: Progress = None, *args: _P.args,
    **keywords: _P.kwargs,
) -> SunCalendar:  # fmt: skip
    """Find the first and the last sun of each day at points, behind what the scene puts in its way.

    Parameters
    ----------
    scene : Scene, PagedScene, or anything that `antumbra.load` takes
    points : Sensors, str, or (3,) or (n, 3) float
        World coordinates. A text is as in `antumbra.sensors_of`; the column id or name of a file names its points.
    days : str or iterable of date
        As for `antumbra.sun_hours`, such as ``year:2026``.
    surface : Scene, PagedScene, or anything that `antumbra.load` takes, optional
        The scene on which points are placed, by a text or `on_surface`. None: `scene`.
    keep : str, path-like or executor, optional
        As for `antumbra.sun_hours`.
    progress : function of (text, done, total), or bool, optional
        As for `antumbra.sun_hours`.

    Returns
    -------
    SunCalendar
        None if the executor leaves parts to other shards.

    Raises
    ------
    InputError
        As for `antumbra.sun_hours`, or if there is no point.

    Warns
    -----
    UserWarning
        As for `antumbra.sun_hours`.

    Notes
    -----
    Beyond the scene, the horizon is open: the sun is up above an elevation of 0. With `curvature`, the horizon dips by
    sqrt(2 h (1 - k) / R), for a height h above the lowest point of the scene, at which the earth goes on; not for
    points on a surface, which hides what is below its horizon. Suns are
    tried a step apart, and the times between a hidden and a visible one are halved down to a second.

    Examples
    --------
    >>> wall = at.Scene.from_arrays([[-9, -5, 0], [9, -5, 0], [9, -5, 3], [-9, -5, 3]], [[0, 1, 2], [0, 2, 3]], up="z")
    >>> delft = at.Place(52.0, 4.36, timezone="Europe/Amsterdam")
    >>> calendar = at.sun_calendar(wall, [[0, 0, 1]], "2026-06-21,2026-12-21", place=delft)
    >>> calendar.hours.round(1)  # in December, the sun stays behind the wall
    array([[16.7,  0. ]])
    """
    options, scene = CalendarOptions(**given(*args, **keywords)), measured_scene(scene)
    threads = thread_count(options.threads)
    below = scene if surface is None else measured_scene(surface)
    checked = sensors_of(points, below, threads) if isinstance(points, str) else points
    if not isinstance(checked, Sensors):
        checked = np.atleast_2d(as_array(checked, "points"))
    sensors = sensors_from(scene, checked, None, "points")
    sensors = raised(below, sensors, options.eye_height, options.on_surface, "points", 0.0, threads)
    if not len(sensors):
        raise InputError("there is no point; give at least one")
    place, chosen = checked_place_of(scene, options.place), days_of(days)
    times = times_of(chosen, zone_of(place), options.step)
    warned = tell([*zone_notes(place, times.middle[0]), *notes_on_sensors(below, sensors, "points", 0.0, threads)])
    names = names_of_rows("points", sensors.attributes, len(sensors))
    work = _CalendarWork(scene, sensors, earth_of(options, scene), place, times, options)
    executor = executor_of(keep)
    parts = work.parts(executor.folder)
    if not executor.finish([parts]):
        return None  # type: ignore[return-value]  # a shard, of a command
    arrays = parts.taken(["first", "last", "sunrise", "sunset", "hours"])
    executor.end([parts])
    about: dict[str, Any] = {"job": "sun calendar", "scene": scene.name, **place._asdict(), "sun": options.sun}
    about |= {"step": options.step, "eye_height": options.eye_height, "on_surface": options.on_surface}
    about |= {"length_unit": scene.unit.name, "up": scene.up, **curvature_record(options, scene), **warned}
    about |= {} if scene.crs is None else {"crs": scene.crs}
    local = {name: work.local(arrays[name]) for name in ("first", "last", "sunrise", "sunset")}
    return SunCalendar(names, sensors.points, work.days, **local, hours=arrays["hours"], about=about)


def apparent(elevation: NDArray[np.float64]) -> NDArray[np.float64]:
    """(...) degrees: the elevation of the refracted upper limb of the sun, from that of its geometric centre.

    By the formula of Saemundsson for the standard atmosphere, 34 minutes of arc at the horizon. Elevations below -2
    degrees have the refraction there.
    """
    limb = elevation + DISK / 2.0
    low = np.maximum(limb, -2.0)
    return np.asarray(limb + 1.02 / 60.0 / tan(np.radians(low + 10.3 / (low + 5.11))))


class _CalendarWork:
    """The calendars of points, in parts. Times are seconds since 1970 UTC."""

    def __init__(
        self, scene: AnyScene, sensors: Sensors, earth: Earth | None, place: Place, times: Times,
        options: CalendarOptions,
    ):  # fmt: skip
        self.scene, self.sensors, self.place, self.options = scene, sensors, place, options
        self.up, low = "xyz".index(scene.up), float(scene.bounds[0, "xyz".index(scene.up)])
        heights = np.maximum(sensors.points[:, self.up] - low, 0.0)
        self.traced, self.turns, self.dips = scene, np.zeros((len(sensors), 2)), np.zeros(len(sensors))
        if earth is not None:
            self.traced, self.sensors = lowered_scene(scene, earth), earth.lowered_sensors(sensors)
            self.turns, self.dips = earth.turns(sensors.points), 2.0 * np.sqrt(heights * earth.drop)
        self.seconds = times.middle.astype(np.int64)
        self.offsets = times.local.astype(np.int64) - self.seconds
        of_day = times.local.astype("datetime64[D]")
        self.days, self.day = np.unique(of_day, return_inverse=True)
        self.length = times.hours

    def parts(self, folder: Path | None) -> Parts:
        """The points in parts."""
        about = None
        if folder is not None:
            sensors = [a for a in (self.sensors.points, self.sensors.normals) if a is not None]
            of = scene_digest(self.traced, 0.0, thread_count(self.options.threads))
            settings = inexact_plan(self.options.plan), list(self.place), self.options.sun
            about = about_parts("calendar", of, *settings, *sensors, self.dips, self.turns, self.seconds, self.length)
        n, k = len(self.sensors), len(self.seconds)
        return Parts(f"calendar: {counted(n, 'point')} x {counted(k, 'sun')}", n, _POINTS, self._part, folder, about)

    def local(self, seconds: NDArray[np.float64]) -> NDArray[np.datetime64]:
        """Local times of seconds, NaN: NaT. The offset is that of the nearest interval."""
        known = np.isfinite(seconds)
        whole = np.where(known, seconds, 0.0).round().astype(np.int64)
        nearest = np.clip(np.searchsorted(self.seconds, whole), 0, len(self.seconds) - 1)
        return np.where(known, (whole + self.offsets[nearest]).astype("datetime64[s]"), _NONE)

    def _elevations(self, geometric: NDArray[np.float64]) -> NDArray[np.float64]:
        """Those of the point of the sun that counts, in degrees."""
        return apparent(geometric) if self.options.sun == "limb" else geometric

    def _part(self, first: int, last: int) -> dict[str, np.ndarray]:
        """The seconds of first and last suns, and the hours, (points, days), of some points."""
        rows = np.arange(first, last)
        geometric, azimuth = solar_angles(self.place, self.seconds.astype("datetime64[s]"))
        elevation = self._elevations(geometric)
        some = np.flatnonzero(elevation > -np.degrees(self.dips.max()) - 1.0)
        up, seen = (np.zeros((len(rows), len(self.seconds)), bool) for _ in range(2))
        months = months_of((self.seconds[some] + self.offsets[some]).astype("datetime64[s]"))
        cuts = sorted({*range(MAX_SPP, len(some), MAX_SPP), *(np.flatnonzero(np.diff(months)) + 1).tolist()})
        for batch in np.split(some, cuts):
            if len(batch):
                towards = directions_of(elevation[batch], azimuth[batch] + self.place.north, self.scene.up)
                up[:, batch] = self._slopes(rows, towards[None]) > -self.dips[rows, None]
                seen[:, batch] = up[:, batch] & self._lit(rows, towards, batch)
        angles = np.stack([geometric, np.degrees(np.unwrap(np.radians(azimuth)))])
        ends = {
            "first": self._edges(rows, seen, angles, True, False),
            "last": self._edges(rows, seen, angles, True, True),
            "sunrise": self._edges(rows, up, angles, False, False),
            "sunset": self._edges(rows, up, angles, False, True),
        }
        hours = np.stack([np.bincount(self.day, row * self.length, len(self.days)) for row in seen])
        return {**ends, "hours": hours}

    def _slopes(self, rows: NDArray[np.int64], towards: NDArray[np.float64]) -> NDArray[np.float64]:
        """(p, k): the slopes of directions, (1 or p, k, 3), over the horizontal of points."""
        level = np.delete(towards, self.up, -1)
        length = np.sqrt((level * level).sum(-1))
        return np.asarray((towards[..., self.up] + (level * self.turns[rows, None]).sum(-1)) / length)

    def _lit(
        self, rows: NDArray[np.int64], towards: NDArray[np.float64], times: NDArray[np.int64]
    ) -> NDArray[np.bool_]:
        """(p, k) bool: whether nothing hides the suns in directions (k, 3), at times, (k,) indices, of one month."""
        scene, lights = self.traced, DirectionalLights(-towards)
        engine = scene.engine.with_options(self.options.plan, self.options.threads, None)
        local = (self.seconds[times[:1]] + self.offsets[times[:1]]).astype("datetime64[s]")
        season = int(seasons_of(scene, months_of(local))[0])
        receivers = self._receivers(rows)
        (traced,) = engine.shadows(receivers, [lights], [light_samples(lights, 1)], month=season)
        return np.asarray(arriving_shares(traced) > 0.5)  # as lines of sight

    def _receivers(self, rows: NDArray[np.int64]) -> Receivers:
        points, normals = self.sensors.points[rows], self.sensors.normals
        return Receivers.of(points, None if normals is None else normals[rows], self.traced.origin, self.traced.middle)

    def _edges(
        self, rows: NDArray[np.int64], which: NDArray[np.bool_], angles: NDArray[np.float64], blocked: bool, ends: bool
    ) -> NDArray[np.float64]:
        """(p, n) float64: the second at which the sun of each day begins, or ends; NaN: there is none.

        which : (p, k) bool, of all suns
        angles : (2, k) degrees: geometric elevations and azimuths, without jumps
        blocked : whether the scene hides the sun
        """
        found = np.full((len(rows), len(self.days)), np.nan)
        starts = np.searchsorted(self.day, np.arange(len(self.days) + 1))
        point, day, inner = list[int](), list[int](), list[int]()
        for d, (a, b) in enumerate(zip(starts[:-1].tolist(), starts[1:].tolist())):
            part = which[:, a:b][:, ::-1] if ends else which[:, a:b]
            there = np.flatnonzero(part.any(1))
            k = part[there].argmax(1)
            point += there.tolist()
            day += [d] * len(there)
            inner += (b - 1 - k if ends else a + k).tolist()
        at, on, k = np.array(point, np.int64), np.array(day, np.int64), np.array(inner, np.int64)
        if not len(at):
            return found
        other = k + 1 if ends else k - 1
        same = (other >= 0) & (other < len(self.day)) & (self.day[np.clip(other, 0, len(self.day) - 1)] == on)
        other = np.where(same, other, k)  # the sun of the whole day: no edge
        low, high = np.ones(len(k)), np.zeros(len(k))  # shares of the way to the other time: hidden, and visible
        span = np.abs(self.seconds[other] - self.seconds[k]).max(initial=1)
        for _ in range(int(span).bit_length() + 1):
            share = (low + high) / 2.0
            lit = self._lit_at(rows[at], angles[:, k] + share * (angles[:, other] - angles[:, k]), blocked)
            low, high = np.where(lit, low, share), np.where(lit, share, high)
        found[at, on] = self.seconds[k] + high * (self.seconds[other] - self.seconds[k])
        return found

    def _lit_at(self, rows: NDArray[np.int64], angles: NDArray[np.float64], blocked: bool) -> NDArray[np.bool_]:
        """(m,) bool: whether points see the sun at these angles, (2, m), above the open horizon or over the scene."""
        towards = directions_of(self._elevations(angles[0]), angles[1] + self.place.north, self.scene.up)
        lit = self._slopes(rows, towards[:, None])[:, 0] > -self.dips[rows]
        if blocked and lit.any():
            if self.sensors.normals is not None:  # their surfaces hide what is below them
                lit &= (towards * self.sensors.normals[rows]).sum(-1) > 0.0
            some = np.flatnonzero(lit)
            origins = self._receivers(rows[some]).origins[0] + self.traced.origin
            lit[some] = ~np.asarray(self.traced.occluded(origins, towards[some], threads=self.options.threads))
        return np.asarray(lit)
