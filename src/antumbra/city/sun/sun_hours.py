"""`sun_hours` and `sky_view`: tables of the direct sun, and of the share of the sky, that reaches each sensor."""

import os
from collections.abc import Iterable
from datetime import date
from typing import Any, NamedTuple, ParamSpec, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...base.checks import whole_number
from ...base.errors import InputError
from ...base.files import atomic_output, check_disk_space, checked_output
from ...base.option_fields import Given, with_keywords
from ...base.progress import Progress, with_progress
from ...engine.measured_scenes import measured_scene
from ...engine.plan import DEFAULT_PLAN, Plan, parse_plan
from ...engine.scene import AnyScene
from ...engine.scene_loading import SceneLike
from ...kernels.elementary import cos, sin
from ...kernels.parallel import thread_count
from ...scene.materials import MONTHS
from ...sun.location import Place, place_in
from ...sun.sun_positions import Suns, checked_step, months_of, suns_of, times_of, zone_notes, zone_of
from ...work.executors import Keep, checked_keep, executor_of
from ..sensors.curved_earth import curvature_record, earth_of, lowered_scene
from ..sensors.ground_areas import AreaLike, default_cells
from ..sensors.point_checks import notes_on_sensors, tell
from ..sensors.sensor_files import sensors_of
from ..sensors.sensors import Sensors, sensors_from
from ..tables.bit_matrices import row_file_size
from ..tables.result_table import Column, Table
from ..tables.surface_columns import Facing, check_per, chosen_sensors, per_group, surface_columns
from .daylight_rules import Rule, meets_rule, rule_named, weights_of
from .epw_file import TYPICAL_YEAR, read_epw
from .solar_radiation import Weather, clear_sky, on_days
from .sun_options import MOST_DIRECTIONS, SunKeywords, SunOptions
from .sun_tally import Tally
from .sun_visibility import NO_DATE, SunQuery, SunSums, seasons_of, sum_suns, sun_query

_P = ParamSpec("_P")

# --- Sky view ---------------------------------------------------------------------------------------------------------


SKY_VIEW_ABOUT = "sky-view factor: share of a uniform sky's light that arrives"


def sky_directions(count: int, up: str) -> NDArray[np.float64]:
    """(count, 3) float64: unit vectors on Vogel's spiral lifted to the hemisphere, each for an equal share of sky."""
    i = np.arange(count)
    height, angle = (i + 0.5) / count, i * np.pi * (3.0 - np.sqrt(5.0))
    width = np.sqrt(1.0 - height * height)
    east, north = width * cos(angle), width * sin(angle)
    return np.stack([east, north, height] if up == "z" else [east, height, -north], axis=1)


@with_progress
def sky_view(
    scene: SceneLike, sensors: Sensors | ArrayLike | str = "face", *, directions: int = 4096,
    plan: str | Plan | None = None, threads: int | None = None, progress: Progress = None,
) -> Table:  # fmt: skip
    """Find how much of the sky each sensor sees. No place or dates are needed.

    Two definitions are common, and each has a column:

    - ``sky_view``: the sky-view factor, which weights each direction by its cosine to the sensor's normal. It is the
      light received from a uniform sky, relative to that on an open horizontal plane.
    - ``sky_share``: the visible share of the sky's hemisphere, with equal weight for all directions. On a floor,
      obstructions near the horizon reduce it more than ``sky_view``.

    Both are 1 on an open floor and 0.5 on an unobstructed wall, where half of the hemisphere in front is ground.

    Directions below the horizon belong to the ground. Sensors without normals are points in the air, for which both
    columns weight all directions equally.

    Parameters
    ----------
    scene : Scene, PagedScene, or anything that `antumbra.load` takes
    sensors : Sensors, str, or (n, 3) float
        As in `sun_hours`.
    directions : int
        Number of directions, 1 to 16384. In a street, the error is up to 0.007 with 1024, and up to 0.002 with 4096.
    plan, threads
        As in `antumbra.render`.
    progress : function of (text, done, total), or bool, optional
        Called during the work. False: show nothing. None: terminals and notebooks show a bar after a second.

    Returns
    -------
    Table
        Columns "sky_view" and "sky_share", both from 0 to 1.

    Raises
    ------
    InputError
        If a text is malformed, a number is out of range, or points are in degrees.

    Warns
    -----
    UserWarning
        If points lie beside the scene, below the ground, on a surface without a normal, or closely behind another one.
    """
    count = whole_number(directions, "directions", 1, MOST_DIRECTIONS)
    scene, threads = measured_scene(scene), thread_count(threads)
    parse_plan(DEFAULT_PLAN if plan is None else plan)
    checked = sensors_of(sensors, scene, threads) if isinstance(sensors, str) else sensors
    sensors = sensors_from(scene, checked, None, "sensors")
    warned = tell(notes_on_sensors(scene, sensors, "sensors", 0.0, threads))
    tally = sum_suns(sky_query(scene, sensors, count, plan, threads), what="sky")
    columns = {
        "sky_view": Column(share_of_sky(tally), "", SKY_VIEW_ABOUT),
        "sky_share": Column(tally.hours / count, "", "share of the sky's hemisphere that is visible"),
    }
    return Table(sensors, columns, {"job": "sky view", "directions": count, **warned}, scene)


def sky_query(
    scene: AnyScene, sensors: Sensors, count: int, plan: str | Plan | None, threads: int | None, month: int = NO_DATE
) -> SunQuery:
    """A query with sky directions as suns, whose energy is that of a uniform sky; `month`: of transmittances."""
    towards = sky_directions(count, scene.up)
    zeros, times = np.zeros(count), np.zeros(count, "datetime64[s]")
    suns = Suns(times, times, np.ones(count), towards, zeros, zeros)
    energy = np.full(count, 1.0 if sensors.normals is None else 2.0) / count
    return sun_query(
        scene, sensors, suns, np.empty((count, 0), np.int64), 1, months=month, energy=energy, plan=plan, threads=threads
    )


def share_of_sky(tally: Tally) -> NDArray[np.float64]:
    """(n,) float64 in [0, 1]: the sky-view factor, from the sums over the directions of `sky_query`."""
    return np.asarray(np.minimum(tally.energy, 1.0))


# --- Sun hours --------------------------------------------------------------------------------------------------------


class Study(NamedTuple):
    """A sun study resolved from its options, apart from the sensors: suns, rule, and groupings of hours."""

    place: Place
    suns: Suns
    rule: Rule | None
    diffuse: np.ndarray | None  # (12,) float64, Wh/m2 of diffuse light on a horizontal plane in each month
    by: tuple[str, ...]
    step: float  # minutes
    notes: tuple[str, ...]  # what may be wrong with the time and the weather


@with_keywords(SunKeywords, 3)
@with_progress
def sun_hours(
    given: Given[_P], scene: SceneLike, sensors: Sensors | ArrayLike | str | None = None,
    days: str | Iterable[date] | None = None, areas: AreaLike | None = None,
    matrix: str | os.PathLike[str] | None = None, keep: Keep = None, progress: Progress = None,
    *args: _P.args, **keywords: _P.kwargs,
) -> Table:  # fmt: skip
    """Find the hours of direct sun of each sensor, exactly.

    Each sun represents an interval and is placed at its middle. A sensor sees a sun if no triangle is in between and
    the sun is above the sensor's own surface. With `curvature`, what lies at a horizontal distance d from the middle of
    the scene is (1 - k) d^2 / (2 R) lower, and the plumb lines of sensors turn accordingly.

    Parameters
    ----------
    scene : Scene, PagedScene, or anything that `antumbra.load` takes
    sensors : Sensors, str, or (n, 3) float, optional
        A text is ``face``, ``vertex``, ``grid:SPACING``, ``raster:SPACING`` or a file; see `antumbra.sensors_of`. None:
        ``face``, or ``raster:0.5`` in areas.
    days : str or iterable of date, optional
        ``2026-06-21``, ``2026-03-21:2026-09-21``, ``year:2026``, or several separated by commas. None: the days of the
        rule or of the EPW file.
    areas : optional
        Gardens or other ground areas, in any form that `antumbra.area_sensors` accepts, such as a GeoJSON file or
        polygons. The table has the raster cells in them, except those inside buildings. ``about["areas"]`` lists the
        name of each area, its cells, the number left out, the mean of the hours, and for the rule br209-amenity the
        share of its cells that get two hours and whether the area passes.
    matrix : str or path-like, optional
        A .npy file for the bits of each sensor and sun, (n, ceil(k / 64)) uint64: bit s is set if sun s is hidden.
    keep : str, path-like or executor, optional
        Folder for the finished parts of an interrupted study, or an executor for the parts; see
        `antumbra.work.executors`.
    progress : function of (text, done, total), or bool, optional
        Called during the work. False: show nothing. None: terminals and notebooks show a bar after a second.

    Returns
    -------
    Table
        Columns "sun_hours" (h); "sun_share" of the hours with the sun above the horizon; "longest" (h), the longest
        unbroken stretch; "first" and "last", the middle of the first and last interval with sun (local time); the
        optional ones; and "building", "surface" (index in `CityModel.surfaces`), "type", "azimuth" and "tilt" (degrees)
        of the surface, where they are known. None if the executor leaves parts to other shards.

    Raises
    ------
    InputError
        If the place or the days are unknown, a text is malformed, points are in degrees, a package is missing
        (``antumbra[sun]``), or no sun is above the horizon.

    Warns
    -----
    UserWarning
        If points lie beside the scene, below the ground, on a surface without a normal, or closely behind another one;
        if the radiation of the EPW file does not fit the sun in its time zone, or the file is from elsewhere or lacks
        some of the days; or if the time zone of the place is not one of its longitude. The notes are in
        ``about["warnings"]``.
    """
    options, keep, scene = SunOptions(days=days, **given(*args, **keywords)), checked_keep(keep), measured_scene(scene)
    plan, threads, samples = options.plan, thread_count(options.threads), options.samples
    in_areas = areas is not None or (isinstance(sensors, Sensors) and sensors.zone is not None)
    study = study_of(options, scene, in_areas)
    if sensors is None:
        sensors = "face" if areas is None else default_cells(scene)
    if isinstance(sensors, str):
        sensors = sensors_of(sensors, scene, threads, areas)
    elif areas is not None:
        raise InputError("areas need sensors as text, such as raster:0.5; or leave areas out, and give area_sensors")
    sensors = sensors_from(scene, sensors, None, "sensors")
    if options.per != "sensor" and sensors.zone is not None:
        raise InputError(f"areas have results of their own, in about; leave per={options.per!r} out")
    check_per(options.per, sensors)
    north = study.place.north
    sensors = chosen_sensors(scene, sensors, options.surfaces, cast(Facing | None, options.facing), north)
    target = None if matrix is None else checked_output(matrix, (".npy",))
    warned = tell([*study.notes, *notes_on_sensors(scene, sensors, "sensors", 0.0, threads)])
    suns, bins = study.suns, _Bins(study)
    direct = None if suns.dni is None else suns.dni * suns.hours
    earth, bent, lowered = earth_of(options, scene), scene, sensors
    if earth is not None:
        bent, lowered = lowered_scene(scene, earth), earth.lowered_sensors(sensors)
    query = sun_query(
        bent, lowered, suns, bins.of_suns, bins.count, months=months_of(suns.local), samples=samples, energy=direct,
        plan=plan, threads=threads,
    )  # fmt: skip
    if keep is None and target is not None:
        keep = target.with_name(target.name + ".parts")  # the bits of all sensors may exceed memory
    executor = executor_of(keep)
    sums = [SunSums(query, "suns", executor.folder, matrix=target is not None)]
    if target is not None:
        check_disk_space(target, row_file_size(sums[0].matrix_shape))
    skies = _diffuse_of_seasons(scene, study) if options.sky else {}
    for month in skies:
        sky = sky_query(bent, lowered, options.sky, plan, threads, month)
        sums.append(SunSums(sky, "sky" if month == NO_DATE else f"sky in {MONTHS[month]}", executor.folder))
    job = [each.parts for each in sums]
    if not executor.finish(job):
        return None  # type: ignore[return-value]  # a shard, of a command
    tally, *sky_tallies = [each.tally() for each in sums]
    table = Table(
        sensors, _columns(study, bins, tally), _about(study, options) | curvature_record(options, scene) | warned, scene
    )
    if sensors.zone is not None:
        table.about["areas"] = area_records(sensors, tally.hours, study.rule, table)
    if skies:
        views = dict(zip(skies, map(share_of_sky, sky_tallies)))
        table.columns["sky_view"] = Column(views[NO_DATE], "", SKY_VIEW_ABOUT)
        if study.diffuse is not None:
            energy = np.sum([views[month] * (diffuse / 1000.0) for month, diffuse in skies.items()], axis=0)
            table.columns["diffuse_kwh_m2"] = Column(energy, "kWh/m2", "energy of diffuse light, uniform sky")
    table.columns |= surface_columns(scene, sensors, north)
    if options.per != "sensor":
        table = per_group(table, options.per, north)
    if target is not None:
        with atomic_output(target) as temporary:
            sums[0].write_matrix(temporary)
    executor.end(job)
    return table


def study_of(options: SunOptions, scene: AnyScene, areas: bool) -> Study:
    """The place, the suns and the groupings of hours: everything that does not depend on the scene's triangles.

    areas : whether the sensors lie in areas
    """
    rule = None if options.rule is None else rule_named(options.rule)
    days = options.dates
    options.check_rule(areas)
    step = options.step or (60.0 if rule is None else checked_step(rule.step))
    place = place_in(scene, options.place)
    weather, diffuse, notes = None, None, tuple[str, ...]()
    if options.epw is not None:
        weather, place = read_epw(options.epw, place)
    if place is None:
        raise InputError("the place is unknown; give a latitude and a longitude, a CRS, or an EPW file")
    if days is None and rule is not None:
        days = rule.days(TYPICAL_YEAR)
    if weather is not None:
        weather = weather if days is None else on_days(weather, days)
        notes = weather.notes
        suns = suns_of(place, weather.times, scene.up, weather.dni)
        diffuse = _sum_months(weather)
    else:
        if days is None:
            raise InputError("the days are unknown; give days such as 2026-06-21 or year:2026, a rule, or an EPW file")
        times = times_of(days, zone_of(place), step)
        clear = clear_sky(place, times) if options.energy else None
        suns = suns_of(place, times, scene.up, None if clear is None else clear.dni)
        if clear is not None:
            diffuse = _sum_months(clear)
    if not len(suns.hours):
        raise InputError("no sun is above the horizon on these days; check the days and the place")
    return Study(place, suns, rule, diffuse, tuple(options.by), step, (*notes, *zone_notes(place, suns.times[0])))


def _sum_months(weather: Weather) -> NDArray[np.float64]:
    """`Study.diffuse`."""
    energy: NDArray[np.float64] = np.bincount(
        months_of(weather.times.local), weather.dhi * weather.times.hours, len(MONTHS)
    ).astype(np.float64)
    return energy


class _Bins:
    """Bins of hours: months, hours of the day, and criteria of a rule. Suns that belong to none use the last bin."""

    def __init__(self, study: Study):
        suns, self.names, columns = study.suns, list[str](), list[np.ndarray]()
        if "month" in study.by:
            columns.append(self._add([f"hours_{name}" for name in MONTHS]) + months_of(suns.local))
        if "hour" in study.by:
            columns.append(self._add([f"hours_{hour:02d}" for hour in range(24)]) + _hour(suns))
        self.criteria: list[tuple[str, float]] = []  # name of the bin, and score per hour in it
        weights = np.empty((0, len(suns.hours))) if study.rule is None else weights_of(study.rule, suns)
        for k, weight in enumerate(weights):
            counts = weight > 0.0
            first = self._add([f"criterion {k}"])
            columns.append(np.where(counts, first, -1))
            self.criteria.append((self.names[first], float((weight[counts] / suns.hours[counts]).max(initial=0.0))))
        self.count = len(self.names) + 1
        bins = np.stack(columns, 1) if columns else np.empty((len(suns.hours), 0), np.int64)
        self.of_suns = np.where(bins < 0, self.count - 1, bins)
        self.used = set(self.of_suns.ravel().tolist())

    def _add(self, names: list[str]) -> int:
        self.names += names
        return len(self.names) - len(names)

    def hours(self, tally: Tally) -> dict[str, np.ndarray]:
        """Name -> hours of each sensor, for the months and hours of day with a sun and for all criteria."""
        criteria = [name for name, _ in self.criteria]
        return {name: tally.binned[:, k] for k, name in enumerate(self.names) if k in self.used or name in criteria}


def _hour(suns: Suns) -> NDArray[np.int64]:
    return np.asarray((suns.local.astype("datetime64[h]") - suns.local.astype("datetime64[D]")).astype(np.int64))


def _columns(study: Study, bins: _Bins, tally: Tally) -> dict[str, Column]:
    suns, total = study.suns, study.suns.hours.sum()
    columns = {
        "sun_hours": Column(tally.hours, "h", "hours of direct sun"),
        "sun_share": Column(tally.hours / total, "", "share of the hours with the sun above the horizon"),
        "longest": Column(tally.longest, "h", "longest stretch of sun without a break"),
        "first": Column(_time_of(suns, tally.first), "", "first sun, local time"),
        "last": Column(_time_of(suns, tally.last), "", "last sun, local time"),
    }
    if suns.dni is not None:
        columns["direct_kwh_m2"] = Column(tally.energy / 1000.0, "kWh/m2", "energy of direct light")
    hours = bins.hours(tally)
    criteria = dict(bins.criteria)
    for name, values in hours.items():
        if name not in criteria:
            columns[name] = Column(values, "h", f"hours of direct sun, {name.partition('_')[2]}")
    if study.rule is not None:
        scores = np.stack([hours[name] * factor for name, factor in bins.criteria], 1)
        for k, criterion in enumerate(study.rule.criteria):
            unit = "" if criterion.share else "h"
            columns[criterion.name] = Column(scores[:, k], unit, f"{study.rule.name}: at least {criterion.least:g}")
        what = "meets" if study.rule.area is None else "gets the hours of"
        columns["passes"] = Column(meets_rule(study.rule, scores), "", f"whether the sensor {what} {study.rule.name}")
    return columns


def _time_of(suns: Suns, which: NDArray[np.int32]) -> NDArray[np.datetime64]:
    """(n,) datetime64[s]: local time of suns; NaT for -1."""
    return np.where(which >= 0, suns.local[np.maximum(which, 0)], np.datetime64("NaT"))


def _diffuse_of_seasons(scene: AnyScene, study: Study) -> dict[int, float]:
    """Month -> diffuse light, Wh/m2, that arrives while surfaces transmit as in this month, besides `NO_DATE`.

    The sky view needs no date, so `NO_DATE` is always there; it has all the light if the scene does not change.
    """
    diffuse = np.zeros(len(MONTHS)) if study.diffuse is None else study.diffuse
    seasons = seasons_of(scene, np.arange(len(MONTHS)))
    if not seasons.any():
        return {NO_DATE: float(diffuse.sum())}
    lit = {int(season): float(diffuse[seasons == season].sum()) for season in np.unique(seasons)}
    return {NO_DATE: 0.0} | {season: energy for season, energy in lit.items() if energy > 0.0}


def area_records(sensors: Sensors, hours: np.ndarray, rule: Rule | None, table: Table) -> list[dict[str, Any]]:
    """The results of each area, in JSON types. All cells have the same size, so shares of cells are shares of area."""
    assert sensors.zone is not None
    records = []
    for k, zone in enumerate(sensors.zones):
        inside = sensors.zone == k
        record: dict[str, Any] = {"name": zone.name, "cells": int(inside.sum()), "left_out": zone.left_out}
        record["sun_hours"] = float(hours[inside].mean()) if inside.any() else None
        if rule is not None and rule.area is not None:
            share = float(table["passes"][inside].mean()) if inside.any() else None
            record |= {"share": share, "passes": None if share is None else share >= rule.area}
        records.append(record)
    return records


def _about(study: Study, options: SunOptions) -> dict[str, Any]:
    """Metadata of the study, in JSON types."""
    suns, place, rule = study.suns, study.place, study.rule
    about: dict[str, Any] = {"job": "sun", **place._asdict()}
    about |= {"first": str(suns.local[0]), "last": str(suns.local[-1]), "suns": len(suns.hours)}
    about |= {"hours": float(suns.hours.sum()), "step": study.step, "samples": options.samples}
    about |= {"surfaces": list(options.surfaces)} if options.surfaces is not None else {}
    about |= {"facing": list(options.facing)} if options.facing is not None else {}
    if rule is not None:
        about |= {"rule": rule.name, "citation": rule.citation, "text": rule.text, "notes": rule.notes}
    return about
