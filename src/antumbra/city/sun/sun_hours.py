"""`sun_hours` and `sky_view`: tables of the direct sun, and of the share of the sky, that reaches each sensor."""

import os
from collections.abc import Iterable, Mapping, Sequence
from datetime import date
from functools import partial
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
from ...kernels.parallel import thread_count
from ...scene.materials import MONTHS
from ...scene.sky import sky_directions
from ...sun.location import UNKNOWN_PLACE, Place, place_in
from ...sun.sun_positions import Suns, checked_step, months_of, suns_of, times_of, zone_notes, zone_of
from ...work.executors import Keep, checked_keep, executor_of
from ..sensors.block_parts import warned_by_block
from ..sensors.curved_earth import curvature_record, earth_of, lowered_scene
from ..sensors.ground_areas import AreaLike, default_cells
from ..sensors.point_checks import notes_on_sensors, tell
from ..sensors.sensor_blocks import DescribedSensors, SensorBlocks
from ..sensors.sensor_files import sensor_blocks, sensors_of
from ..sensors.sensors import Sensors, sensors_from
from ..tables.bit_matrices import row_file_size
from ..tables.partitions import Partitions
from ..tables.result_table import Column, MadeFrom, Table
from ..tables.surface_columns import (
    Between,
    Facing,
    SurfaceChoice,
    check_per,
    notes_on_rows,
    per_group,
    surface_columns,
    surface_settings,
)
from ..tables.table_blocks import TableBlocks
from .daylight_rules import Criterion, Kind, Rule
from .epw_file import TYPICAL_YEAR, read_epw
from .overcast_sky import OVERCAST_DIRECTIONS, overcast, upright_sensors
from .rule_verdicts import grouped_verdicts, rates_of, with_verdicts
from .solar_radiation import Weather, clear_sky, on_days
from .sun_options import MOST_DIRECTIONS, SunKeywords, SunOptions
from .sun_tally import Tally
from .sun_visibility import NO_DATE, SunQuery, SunSums, seasons_of, sum_suns, sun_query

_P = ParamSpec("_P")

# --- Sky view ---------------------------------------------------------------------------------------------------------


SKY_VIEW_ABOUT = "sky-view factor: share of a uniform sky's light that arrives"


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
    assert tally is not None  # no executor leaves parts to others
    columns = {
        "sky_view": Column(share_of_sky(tally), "", SKY_VIEW_ABOUT),
        "sky_share": Column(tally.hours / count, "", "share of the sky's hemisphere that is visible"),
    }
    return Table(sensors, columns, {"job": "sky view", "directions": count, **warned}, scene)


def sky_query(
    scene: AnyScene,
    sensors: SensorBlocks,
    count: int,
    plan: str | Plan | None,
    threads: int | None,
    month: int = NO_DATE,
) -> SunQuery:
    """A query with sky directions as suns, whose energy is that of a uniform sky; `month`: of transmittances."""
    towards = sky_directions(count, scene.up)
    zeros, times = np.zeros(count), np.zeros(count, "datetime64[s]")
    suns = Suns(times, times, np.ones(count), towards, zeros, zeros)
    energy = np.full(count, 2.0 if sensors.sided else 1.0) / count
    return sun_query(
        scene, sensors, suns, np.empty((count, 0), np.int64), 1, months=month, energy=energy, plan=plan, threads=threads
    )


def share_of_sky(tally: Tally) -> NDArray[np.float64]:
    """(n,) float64 in [0, 1]: the sky-view factor, from the sums over the directions of `sky_query`."""
    return np.asarray(np.minimum(tally.energy, 1.0))


# --- Sun hours --------------------------------------------------------------------------------------------------------


class SunRun(NamedTuple):
    """Suns whose hours are added up together, and the criteria of rules that count them."""

    suns: Suns
    step: float  # minutes
    criteria: tuple[Criterion, ...]
    sunshine: np.ndarray | None  # (12,) float64, mean hours of sunshine in each month
    diffuse: np.ndarray | None  # (12,) float64, Wh/m2 of diffuse light on a horizontal plane in each month
    by: tuple[str, ...]  # groupings of hours


class Study(NamedTuple):
    """A sun study resolved from its options, apart from the sensors."""

    place: Place | None
    runs: tuple[SunRun, ...]  # those of other suns than the first one are for rules alone
    main: SunRun | None  # the first run; None: rules have different suns, so that hours in general mean nothing
    rules: tuple[Rule, ...]
    notes: tuple[str, ...]  # what may be wrong with the time and the weather

    @property
    def north(self) -> float:
        """`Place.north`; 0 if there is no place."""
        return 0.0 if self.place is None else self.place.north


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
        of the surface, where they are known. Those of rules come first: "RULE_passes", such as "br209_vsc_passes", and
        the quantities that they judge. Rules with different days have no "sun_hours" in common, unless there are
        `days`. None if the executor leaves parts to other shards.

    Raises
    ------
    InputError
        If the place or the days are unknown, a text is malformed, points are in degrees, a package is missing
        (``antumbra[sun]``), no sun is above the horizon, or a rule lacks what it needs: areas, sunshine, or walls.

    Warns
    -----
    UserWarning
        If points lie beside the scene, below the ground, on a surface without a normal, or closely behind another one;
        if the radiation of the EPW file does not fit the sun in its time zone, or the file is from elsewhere or lacks
        some of the days; or if the time zone of the place is not one of its longitude. The notes are in
        ``about["warnings"]``.

    Examples
    --------
    >>> ground = at.Scene.from_arrays([[0, 0, 0], [9, 0, 0], [0, 9, 0]], up="z", unit="m")
    >>> table = at.sun_hours(ground, [[2, 2, 1]], days="2026-06-21", place=at.Place(52, 4.4))
    >>> table.columns["sun_hours"].values.round(1)
    array([17.])
    """
    options = SunOptions(days=days, **given(*args, **keywords))
    found = sun_blocks(scene, options, sensors, areas, matrix, keep)
    if found is None:
        return None  # type: ignore[return-value]  # a shard, of a command
    table = found.whole()
    found.close()
    return table


def sun_blocks(
    scene: SceneLike, options: SunOptions, sensors: SensorBlocks | ArrayLike | str | None, areas: AreaLike | None,
    matrix: str | os.PathLike[str] | None, keep: Keep, partitioned: bool = False,
) -> Table | TableBlocks | None:  # fmt: skip
    """The table of `sun_hours`, made by block if the sensors are described and each row is that of a sensor.

    Its `close` removes the finished parts. `partitioned`: these are partitions of the table, if it is made by block and
    without a matrix, and the executor has a folder.
    """
    keep, scene = checked_keep(keep), measured_scene(scene)
    plan, threads, samples = options.plan, thread_count(options.threads), options.samples
    in_areas = areas is not None or (isinstance(sensors, Sensors) and sensors.zone is not None)
    study = study_of(options, scene, in_areas)
    if sensors is None:
        sensors = "face" if areas is None else default_cells(scene)
    if isinstance(sensors, str):
        named = sensor_blocks(sensors, scene, threads) if areas is None else sensors_of(sensors, scene, threads, areas)
        sensors = named
    elif areas is not None:
        raise InputError("areas need sensors as text, such as raster:0.5; or leave areas out, and give area_sensors")
    sky_rule = next((rule for rule in study.rules if rule.kind is Kind.SKY), None)
    facing, tilt = cast(Facing | None, options.facing), cast(Between | None, options.tilt)
    chosen = SurfaceChoice(options.surfaces, facing, tilt, study.north)
    described, notes = None, list(study.notes)
    if isinstance(sensors, DescribedSensors):
        if options.per == "sensor" and sky_rule is None:
            described = chosen.of_blocks(scene, sensors)
        else:
            sensors = sensors.whole()
    if described is None:
        sensors = sensors_from(scene, cast(Any, sensors), None, "sensors")
        if options.per != "sensor" and sensors.zone is not None:
            raise InputError(f"areas have results of their own, in about; leave per={options.per!r} out")
        check_per(options.per, sensors, scene)
        sensors = chosen.of(scene, sensors)
        notes += notes_on_rows(sensors, options.per, scene)
        if sky_rule is not None and len(sensors):
            sensors, left_out = upright_sensors(scene, sensors, sky_rule)
            notes += left_out
        notes += notes_on_sensors(scene, sensors, "sensors", 0.0, threads)
    target = None if matrix is None else checked_output(matrix, (".npy",))
    warned = tell(notes)
    if study.main is None and (target is not None or options.by or options.energy):
        raise InputError("matrix, by and energy are about the same suns for all rules; give days, or rules of one day")
    if keep is None and target is not None:
        keep = target.with_name(target.name + ".parts")  # the bits of all sensors may exceed memory
    earth, bent = earth_of(options, scene), scene
    source: SensorBlocks = described or cast(Sensors, sensors)
    if earth is not None:
        bent = lowered_scene(scene, earth)
    executor, sums, all_bins = executor_of(keep), list[SunSums](), [_Bins(run) for run in study.runs]

    def noted(some: Sensors) -> list[str]:
        return notes_on_sensors(scene, some, "sensors", 0.0, threads)

    for run, bins in zip(study.runs, all_bins):
        suns, direct = run.suns, None if run.suns.dni is None else run.suns.dni * run.suns.hours
        query = sun_query(
            bent, source, suns, bins.of_suns, bins.count, months=months_of(suns.local), samples=samples,
            energy=direct, plan=plan, threads=threads,
        )  # fmt: skip
        what = "suns" if run is study.main else f"suns for {', '.join(each.column for each in run.criteria)}"
        with_bits = target is not None and run is study.main
        query = query._replace(earth=earth)
        sums.append(SunSums(query, what, executor.folder, with_bits, None if sums or described is None else noted))
    if target is not None:
        check_disk_space(target, row_file_size(sums[0].matrix_shape))
    if sky_rule is not None:
        sky = sky_query(bent, source, OVERCAST_DIRECTIONS, plan, threads)._replace(earth=earth)
        sums.append(SunSums(overcast(sky), "overcast sky", executor.folder))
    skies = _diffuse_of_seasons(scene, study.main) if options.sky_view else {}
    for month in skies:
        sky = sky_query(bent, source, options.sky_view, plan, threads, month)._replace(earth=earth)
        sums.append(SunSums(sky, "sky" if month == NO_DATE else f"sky in {MONTHS[month]}", executor.folder))
    about = _about(study, options) | curvature_record(options, scene)

    def table_of(sensors: Sensors, tallies: Sequence[Tally]) -> Table:
        columns = _all_columns(study, all_bins, skies, sky_rule, tallies)
        columns |= surface_columns(scene, sensors, study.north)
        return judged_rows(Table(sensors, columns, about, scene), study.rules, options.per, study.north)

    def block_of(sensors: Sensors, k: int) -> Table:
        return table_of(sensors, [each.tally_of_part(k) for each in sums])

    job, partitions = [each.parts for each in sums], None
    if described is not None and partitioned and target is None and executor.folder is not None and len(described):
        settings = [about, *(each for bins in all_bins for each in bins.settings), list(skies), list(skies.values())]
        settings += surface_settings(scene)
        job = [partitions := Partitions(sums[0].blocks, job[1:], block_of, described, scene, settings)]
    if not executor.finish(job):
        return None
    if described is not None:
        left = sum(sums[0].blocks.counts())
        if not left:
            executor.end(job)  # there is nothing to resume
        chosen.check(scene, left, len(described))
        warned = warned_by_block(notes, sums[0].blocks)
    about |= warned
    if target is not None:
        with atomic_output(target) as temporary:
            sums[0].write_matrix(temporary)
    if described is None:
        table = table_of(cast(Sensors, sensors), [each.tally() for each in sums])
        executor.end(job)
        return table
    close = partial(executor.end, job)
    if partitions is not None:
        made = lambda sensors, columns: Table(sensors, columns, about, scene)
        return TableBlocks.of_partitions(partitions, made, close)
    whole = lambda sensors: table_of(sensors, [each.tally() for each in sums])
    return TableBlocks(described, sums[0].parts.ranges, block_of, whole, close)


def _all_columns(
    study: Study, all_bins: Sequence["_Bins"], skies: Mapping[int, float], sky_rule: Rule | None,
    tallies: Sequence[Tally],
) -> dict[str, Column]:  # fmt: skip
    """The columns of results, from the sums of each query."""
    columns = dict[str, Column]()
    for bins, tally in zip(all_bins, tallies):
        columns |= bins.scores(tally)
    if sky_rule is not None:
        quantity, percent = sky_rule.criteria[0], tallies[len(study.runs)].energy
        columns[quantity.column] = Column(percent, quantity.unit, quantity.about)
    if study.main is not None:
        columns |= _columns(study.main, all_bins[0], tallies[0])
    if skies:
        views = dict(zip(skies, map(share_of_sky, tallies[-len(skies) :])))
        columns["sky_view"] = Column(views[NO_DATE], "", SKY_VIEW_ABOUT)
        if study.main is not None and study.main.diffuse is not None:
            energy = np.sum([views[month] * (diffuse / 1000.0) for month, diffuse in skies.items()], axis=0)
            columns["diffuse_kwh_m2"] = Column(energy, "kWh/m2", "energy of diffuse light, uniform sky")
    return columns


def judged_rows(table: Table, rules: Sequence[Rule], per: str, north: float) -> Table:
    """A table of sensors with the verdicts of rules, and a row for each sensor, surface, building or other group.

    Columns that end in ``_before`` are a former state. The result records how it was made, so that the tables of two
    states can be joined first, and judged and grouped afterwards.

    per, north : as in `SunKeywords` and `Place`
    """
    rows = table
    if rules or table.sensors.zone is not None:
        rows = with_verdicts(table, rules)
    if per != "sensor":
        rows = per_group(rows, per, north, grouped_verdicts(rules))
    if rows is not table:
        rows.made_from = MadeFrom(table, partial(judged_rows, rules=rules, per=per, north=north))
    return rows


class _When(NamedTuple):
    """What decides which suns count."""

    days: tuple[date, ...] | None  # None: those of the weather
    step: float
    lowest: float
    by_weather: bool  # whether the hours of the EPW file are the intervals


def study_of(options: SunOptions, scene: AnyScene, areas: bool) -> Study:
    """The place, the suns and the groupings of hours: everything that does not depend on the scene's triangles.

    areas : whether the sensors lie in areas
    """
    rules, days = options.rules, options.dates
    options.check_rules(areas)
    place, weather = place_in(scene, options.place), None
    if options.epw is not None:
        weather, place = read_epw(options.epw, place)
    when = _criteria_by_suns(options)
    if days is not None or not rules:
        if days is None and weather is None:
            raise InputError("the days are unknown; give days such as 2026-06-21 or year:2026, a rule, or an EPW file")
        step = options.step or min((each.step for each in when), default=60.0)
        first = _When(None if days is None else tuple(days), step, options.lowest or 0.0, weather is not None)
        when = {first: when.get(first, ())} | when
    if place is None and when:
        raise InputError(f"{UNKNOWN_PLACE}, a CRS, or an EPW file")
    runs, notes = list[SunRun](), dict[str, None]()
    for each, criteria in when.items():
        assert place is not None
        run, its_notes = _run(options, place, weather if each.by_weather else None, each, criteria, scene.up)
        runs.append(run)
        notes |= dict.fromkeys((*its_notes, *zone_notes(place, run.suns.times[0])))
    if options.lowest is None and (open_rules := [rule.name for rule in rules if rule.lowest is None]):
        notes[
            f"{', '.join(open_rules)}: suns at any altitude count, but the standard sets a minimum by country; give it "
            "as the lowest altitude"
        ] = None
    has_main = len(runs) == 1 or days is not None or not rules
    return Study(place, tuple(runs), runs[0] if runs and has_main else None, rules, tuple(notes))


def _criteria_by_suns(options: SunOptions) -> dict[_When, tuple[Criterion, ...]]:
    """The criteria of rules about the sun, by the suns that they count; each column once."""
    found = dict[_When, tuple[Criterion, ...]]()
    for rule in options.rules:
        if rule.days is not None:
            days = rule.days(TYPICAL_YEAR) if options.dates is None else options.dates
            lowest = (rule.lowest or 0.0) if options.lowest is None else options.lowest
            by_weather = rule.kind is Kind.PROBABLE and options.sunshine is None
            when = _When(tuple(days), options.step or float(rule.step), lowest, by_weather)
            there = found.get(when, ())
            known = {each.column for each in there}
            found[when] = (*there, *(each for each in rule.criteria if each.column not in known))
    return found


def _run(
    options: SunOptions, place: Place, weather: Weather | None, when: _When, criteria: tuple[Criterion, ...], up: str
) -> tuple[SunRun, tuple[str, ...]]:
    """The suns of a run, and notes on its weather."""
    notes, sky = tuple[str, ...](), weather
    if weather is not None:
        sky = weather = weather if when.days is None else on_days(weather, when.days)
        times, notes = weather.times, weather.notes
    else:
        assert when.days is not None
        times = times_of(when.days, zone_of(place), checked_step(when.step))
        sky = clear_sky(place, times) if options.energy else None
    suns = suns_of(place, times, up, None if sky is None else sky.dni, lowest=when.lowest)
    if not len(suns.hours):
        above = "the horizon" if when.lowest == 0.0 else f"{when.lowest:g} degrees"
        raise InputError(f"no sun is above {above} on these days; check the days and the place")
    sunshine = None if options.sunshine is None else np.array(options.sunshine, np.float64)
    diffuse = None if sky is None else _sum_months(sky)
    return SunRun(suns, when.step, criteria, sunshine, diffuse, tuple(options.by)), notes


def _sum_months(weather: Weather) -> NDArray[np.float64]:
    """`Study.diffuse`."""
    energy: NDArray[np.float64] = np.bincount(
        months_of(weather.times.local), weather.dhi * weather.times.hours, len(MONTHS)
    ).astype(np.float64)
    return energy


class _Bins:
    """Bins of hours: months, hours of the day, and suns with the same score. Others use the last bin."""

    def __init__(self, run: SunRun):
        suns, self.names, columns = run.suns, list[str](), list[np.ndarray]()
        if "month" in run.by:
            columns.append(self._add([f"hours_{name}" for name in MONTHS]) + months_of(suns.local))
        if "hour" in run.by:
            columns.append(self._add([f"hours_{hour:02d}" for hour in range(24)]) + _hour(suns))
        self.used = {int(k) for k in np.unique(columns)} if columns else set[int]()
        self._criteria, self.count = run.criteria, len(self.names) + 1
        self._local = suns.local.astype("datetime64[s]").astype(np.int64)
        if run.criteria:
            rates = rates_of(run.criteria, suns, run.sunshine)
            self._rates, same = np.unique(rates, axis=1, return_inverse=True)  # (criteria, bins), and the bin of a sun
            columns.append(len(self.names) + same.reshape(-1))
            self.count = len(self.names) + self._rates.shape[1]
        self.of_suns = np.stack(columns, 1) if columns else np.empty((len(suns.hours), 0), np.int64)

    def _add(self, names: list[str]) -> int:
        self.names += names
        return len(self.names) - len(names)

    @property
    def settings(self) -> list[Any]:
        """What the columns depend on besides the sums, for digests: arrays and JSON values."""
        return [self.names, self._local, *([self._rates] if self._criteria else [])]

    def hours(self, tally: Tally) -> dict[str, np.ndarray]:
        """Name -> hours of each sensor, for the months and hours of day with a sun."""
        return {name: tally.binned[:, k] for k, name in enumerate(self.names) if k in self.used}

    def scores(self, tally: Tally) -> dict[str, Column]:
        """The quantities that rules judge."""
        hours = tally.binned[:, len(self.names) :]
        return {
            each.column: Column(np.einsum("ij,j->i", hours, self._rates[k]), each.unit, each.about)
            for k, each in enumerate(self._criteria)
        }


def _hour(suns: Suns) -> NDArray[np.int64]:
    return np.asarray((suns.local.astype("datetime64[h]") - suns.local.astype("datetime64[D]")).astype(np.int64))


def _columns(run: SunRun, bins: _Bins, tally: Tally) -> dict[str, Column]:
    suns, total = run.suns, run.suns.hours.sum()
    columns = {
        "sun_hours": Column(tally.hours, "h", "hours of direct sun"),
        "sun_share": Column(tally.hours / total, "", "share of the hours with the sun above the horizon"),
        "longest": Column(tally.longest, "h", "longest stretch of sun without a break"),
        "first": Column(_time_of(suns, tally.first), "", "first sun, local time"),
        "last": Column(_time_of(suns, tally.last), "", "last sun, local time"),
    }
    if suns.dni is not None:
        columns["direct_kwh_m2"] = Column(tally.energy / 1000.0, "kWh/m2", "energy of direct light")
    for name, values in bins.hours(tally).items():
        columns[name] = Column(values, "h", f"hours of direct sun, {name.partition('_')[2]}")
    return columns


def _time_of(suns: Suns, which: NDArray[np.int32]) -> NDArray[np.datetime64]:
    """(n,) datetime64[s]: local time of suns; NaT for -1."""
    return np.where(which >= 0, suns.local[np.maximum(which, 0)], np.datetime64("NaT"))


def _diffuse_of_seasons(scene: AnyScene, run: SunRun | None) -> dict[int, float]:
    """Month -> diffuse light, Wh/m2, that arrives while surfaces transmit as in this month, besides `NO_DATE`.

    The sky view needs no date, so `NO_DATE` is always there; it has all the light if the scene does not change.
    """
    diffuse = np.zeros(len(MONTHS)) if run is None or run.diffuse is None else run.diffuse
    seasons = seasons_of(scene, np.arange(len(MONTHS)))
    if not seasons.any():
        return {NO_DATE: float(diffuse.sum())}
    lit = {int(season): float(diffuse[seasons == season].sum()) for season in np.unique(seasons)}
    return {NO_DATE: 0.0} | {season: energy for season, energy in lit.items() if energy > 0.0}


def _about(study: Study, options: SunOptions) -> dict[str, Any]:
    """Metadata of the study, in JSON types."""
    about: dict[str, Any] = {"job": "sun", **({} if study.place is None else study.place._asdict())}
    about |= {"suns": sum(len(run.suns.hours) for run in study.runs), "samples": options.samples}
    if study.main is not None:
        suns, step = study.main.suns, study.main.step
        about |= {"first": str(suns.local[0]), "last": str(suns.local[-1])}
        about |= {"hours": float(suns.hours.sum()), "step": step}
    names = "surfaces", "facing", "tilt", "lowest", "sunshine"
    given = {name: getattr(options, name) for name in names}
    about |= {k: list(v) if isinstance(v, tuple) else v for k, v in given.items() if v is not None}
    if any(rule.kind is Kind.SKY for rule in study.rules):
        about["directions"] = OVERCAST_DIRECTIONS
    if study.rules:
        fields = "name", "citation", "text", "notes"
        about["rules"] = [{field: getattr(rule, field) for field in fields} for rule in study.rules]
    return about
