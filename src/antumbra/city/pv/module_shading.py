"""`module_shading`: the shaded fraction of photovoltaic modules, and the share of the sky that they see, by time."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, ParamSpec

import numpy as np
from numpy.typing import NDArray

from ...base.errors import InputError
from ...base.extras import import_extra
from ...base.files import atomic_output, checked_output
from ...base.option_fields import Given, with_keywords
from ...base.progress import Progress, with_progress
from ...base.wording import counted, some_of
from ...engine.measured_scenes import measured_scene
from ...engine.scene import AnyScene, Scene
from ...engine.scene_loading import SceneLike
from ...kernels.parallel import thread_count
from ...query.light_samples import light_samples
from ...query.receivers import Receivers
from ...scene.light_lists import DirectionalLights
from ...scene.lights import MAX_SPP
from ...sun.location import Place, checked_place_of
from ...sun.sun_positions import directions_of, months_of, solar_angles
from ...work.executors import Keep, executor_of
from ...work.result_summary import Summary
from ...work.scene_records import scene_digest
from ...work.work_parts import Parts, about_parts, inexact_plan
from ..sensors.point_checks import notes_on_points, tell
from ..sensors.sensors import point_sensors
from ..skyline.skyline import Skyline, horizon_elevations
from ..sun.sun_visibility import DISK, arriving_shares, bundle_order, disk_directions, seasons_of
from .modules import Modules, Planes, PvModule, checked_modules
from .pv_options import PvOptions

if TYPE_CHECKING:
    import pandas

_P = ParamSpec("_P")

SUFFIXES = ".csv", ".parquet"
"""Suffixes of the files that `ModuleShading.save` writes."""

_MODULES = 32  # in a part
_STEP = 2.0  # degrees between azimuths of skylines
_ROUNDING = 4.0 * float(np.finfo(np.float32).eps)  # of a plane, per extent of all modules

# --- Results ----------------------------------------------------------------------------------------------------------


class ModuleShading(NamedTuple):
    """The shading of m modules or strings at n times."""

    names: list[str]  # of the modules or strings
    times: Any  # pandas.DatetimeIndex with a time zone
    shaded_fraction: NDArray[np.float64]  # (m, n): the share of the direct light that is blocked, 0 to 1
    sky_view_factor: NDArray[np.float64]  # (m, n): the share of a uniform sky's light that arrives on the plane
    most_shaded: NDArray[np.float64] | None  # (m, n): shaded fraction of the most shaded module; None: not per string
    solar_azimuth: NDArray[np.float64]  # (n,) degrees
    solar_elevation: NDArray[np.float64]  # (n,) degrees, geometric
    about: dict[str, Any]  # metadata of the study, in JSON types

    def frame(self) -> "pandas.DataFrame":
        """A row for each module or string and time, in the index, with the arrays as columns."""
        pandas = import_extra("pandas", "frame", "sun")
        m, per = len(self.names), self.about["per"]
        index = pandas.MultiIndex.from_product([self.names, self.times], names=[per, "time"])
        columns = {"shaded_fraction": self.shaded_fraction.ravel()}
        if self.most_shaded is not None:
            columns["most_shaded"] = self.most_shaded.ravel()
        columns |= {"sky_view_factor": self.sky_view_factor.ravel()}
        columns |= {
            "solar_azimuth": np.tile(self.solar_azimuth, m),
            "solar_elevation": np.tile(self.solar_elevation, m),
        }
        table: Any = pandas.DataFrame(columns, index=index)
        table.attrs["up"] = self.about["up"]
        return table

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the rows of `frame` as .csv or .parquet. Times have the offset of their zone.

        Raises
        ------
        InputError
            If the suffix is unknown, or the path cannot be written.
        """
        target = check_shading_output(path)
        table = self.frame().reset_index()
        with atomic_output(target) as temporary:
            if target.suffix.lower() == ".csv":
                table["time"] = np.tile([time.isoformat() for time in self.times], len(self.names))
                table.to_csv(temporary, index=False, float_format="%.6g", lineterminator="\n")
            else:
                table.to_parquet(temporary, compression="zstd")

    def summary(self, scene: str, seconds: float) -> Summary:
        """The mean shading while the sun is up, and the extremes; `seconds`: of the study."""
        up = self.solar_elevation > 0.0
        means = self.shaded_fraction[:, up].mean(1) if up.any() else np.ones(len(self.names))
        values = {"scene": scene, f"{self.about['per']}s": len(self.names), "times": len(self.times)}
        values |= {"mean_shaded": float(means.mean()), "seconds": seconds}
        lines = [
            (f"{self.about['per']}s", f"{len(self.names):,}"),
            ("times", f"{len(self.times):,}, {up.sum():,} with sun"),
        ]
        worst, best = int(means.argmax()), int(means.argmin())
        lines.append(("shaded", f"{100.0 * means.mean():.1f} % of the times with sun"))
        if len(means) > 1:
            lines += [("most", f"{self.names[worst]}: {100.0 * means[worst]:.1f} %")]
            lines += [("least", f"{self.names[best]}: {100.0 * means[best]:.1f} %")]
        return Summary(values, lines)


def check_shading_output(path: str | os.PathLike[str]) -> Any:
    """The path; an InputError, before long work, unless `ModuleShading.save` can write to it."""
    target = checked_output(path, SUFFIXES)
    if target.suffix.lower() == ".parquet":
        import_extra("pyarrow", ".parquet", "gis")
    return target


# --- The study --------------------------------------------------------------------------------------------------------


class _Sky(NamedTuple):
    """The times of a study with some of the sun's disk above the horizon."""

    towards: NDArray[np.float64]  # (k, samples, 3): directions to points of the disk
    over: NDArray[np.bool_]  # (k, samples): above the horizon
    months: NDArray[np.int64]  # (k,)
    times: NDArray[np.int64]  # (k,): of all times


@with_keywords(PvOptions, 3)
@with_progress
def module_shading(
    given: Given[_P], scene: SceneLike, modules: "PvModule | dict[str, PvModule]", times: Any, keep: Keep = None,
    progress: Progress = None, *args: _P.args, **keywords: _P.kwargs,
) -> ModuleShading:  # fmt: skip
    """Find how much of photovoltaic modules is shaded, and how much of the sky they see, at given times.

    Each sample of the sun's disk is traced exactly from each point of each module, at the geometric position of the
    sun (``elevation`` of pvlib, not ``apparent_elevation``).

    Parameters
    ----------
    scene : Scene, or anything that `antumbra.load` takes
    modules : PvModule, or dict of str to PvModule
        Fixed ones, and trackers with a plane per time.
    times : pandas.DatetimeIndex
        With a time zone.
    keep : str, path-like or executor, optional
        As for `antumbra.sun_hours`.
    progress : function of (text, done, total), or bool, optional
        Called during the work. False: show nothing. None: terminals and notebooks show a bar after a second.

    Returns
    -------
    ModuleShading
        The shaded fraction is 1 while the sun is below the horizon, or behind the plane. Strings have the mean of their
        modules, weighted by area, and the fraction of their most shaded one. None if the executor leaves parts to other
        shards.

    Raises
    ------
    InputError
        If times are no index with a time zone, the place is unknown, an argument is invalid,
        no module has a string but series of strings are requested, or a package is missing (``antumbra[sun]``).

    Warns
    -----
    UserWarning
        If modules lie beside the scene or below the ground, or have no string where series of strings are requested.

    Notes
    -----
    Sky-view factors are those of skylines, every 2 degrees. For trackers, they are found at each time; so are the
    planes that shade each other, whose other effect, the light reflected by rear sides, is not modelled.

    Examples
    --------
    >>> import pandas
    >>> wall = at.Scene.from_arrays([[-9, -5, 0], [9, -5, 0], [9, -5, 3], [-9, -5, 3]], [[0, 1, 2], [0, 2, 3]], up="z")
    >>> noons = pandas.DatetimeIndex(["2026-06-21T12:00Z", "2026-12-21T12:00Z"])
    >>> module = at.PvModule((0, 0, 1), width=1.0, height=2.0, tilt=30)
    >>> shading = at.module_shading(wall, module, noons, place=at.Place(52.0, 4.36))
    >>> shading.shaded_fraction.round(2)
    array([[0., 1.]])
    """
    options, scene = PvOptions(**given(*args, **keywords)), measured_scene(scene)
    index, place = checked_times(times), checked_place_of(scene, options.place)
    every = checked_modules(modules, len(index))
    if options.per == "string" and not any(module.string for module in every.each):
        raise InputError("no module has a string; name them, or leave per='string' out")
    middles = np.array([module.position for module in every.each])
    notes, strayed = (
        notes_on_points(scene, middles, "modules", 0.0, options.threads),
        [m.string for m in every.each].count(""),
    )
    if options.per == "string" and strayed:
        notes.append(f"{some_of(strayed, len(every.each), 'module', 'have')} no string: left out")
    warned = tell(notes)
    instants = index.tz_convert("UTC").tz_localize(None).to_numpy().astype("datetime64[s]")
    elevation, azimuth = solar_angles(place, instants)
    sky = sky_of(scene, place, elevation, azimuth, months_of(index.tz_localize(None).to_numpy()), options.samples)
    work = _ModuleWork(scene, every, sky, place.north, options)
    executor = executor_of(keep)
    parts = work.parts(executor.folder)
    if not executor.finish([parts]):
        return None  # type: ignore[return-value]  # a shard, of a command
    arrays = parts.taken(["shaded", "factor"])
    executor.end([parts])
    about: dict[str, Any] = {
        "job": "module shading",
        "scene": scene.name,
        "per": options.per,
        "samples": options.samples,
    }
    about |= {"between": options.between, "up": scene.up, **place._asdict(), **warned}
    shaded, factor = arrays["shaded"], arrays["factor"]
    if options.per == "module":
        return ModuleShading(every.names, index, shaded, factor, None, azimuth, elevation, about)
    names, means, factors, most = _of_strings(every, shaded, factor)
    return ModuleShading(names, index, means, factors, most, azimuth, elevation, about)


def checked_times(times: Any) -> Any:
    """A pandas.DatetimeIndex with a time zone; otherwise an InputError."""
    pandas = import_extra("pandas", "the times of modules", "sun")
    if not isinstance(times, pandas.DatetimeIndex) or times.tz is None:
        raise InputError("times must be a pandas.DatetimeIndex with a time zone; tz_localize it")
    if times.hasnans:
        raise InputError("times hold NaT; drop these rows")
    return times


def sky_of(
    scene: AnyScene, place: Place, elevation: NDArray[np.float64], azimuth: NDArray[np.float64],
    months: NDArray[np.int64], samples: int,
) -> _Sky:  # fmt: skip
    """The disks of the sun at the times at which some of them is above the horizon."""
    above = np.flatnonzero(elevation > -DISK / 2.0)
    towards = np.empty((0, samples, 3))
    if len(above):
        towards = disk_directions(directions_of(elevation[above], azimuth[above] + place.north, scene.up), samples)
    return _Sky(towards, towards[..., "xyz".index(scene.up)] > 0.0, months[above], above)


class Traced(NamedTuple):
    """A scene, and the sample points as its receivers."""

    scene: AnyScene
    receivers: Receivers

    @classmethod
    def of(cls, scene: AnyScene, planes: Planes) -> "Traced":
        return cls(scene, Receivers.of(planes.points, planes.normals, scene.origin, scene.middle))


def light_through(
    traced: list[Traced], towards: NDArray[np.float64], months: NDArray[np.int64], starts: NDArray[np.int64],
    settings: tuple[Any, int],
) -> NDArray[np.float64]:  # fmt: skip
    """(m, k) float64: the share of the light from each direction that passes all scenes, a mean over groups of points.

    months : (k,) int64, of the transmittances of leaves in the first scene
    starts : (m,) the first point of each group
    """
    plan, threads = settings
    seasons, n = seasons_of(traced[0].scene, months), traced[0].receivers.n
    light, counts = np.zeros((len(starts), len(towards))), np.diff(np.append(starts, n))
    for season in np.unique(seasons):
        rows = np.flatnonzero(seasons == season)
        rows = rows[bundle_order(towards[rows], seasons[rows])]
        for batch in np.split(rows, range(MAX_SPP, len(rows), MAX_SPP)):
            lights, shares = DirectionalLights(-towards[batch]), np.ones((n, len(batch)), np.float32)
            for scene, receivers in traced:
                engine = scene.engine.with_options(plan, threads, None)
                (found,) = engine.shadows(receivers, [lights], [light_samples(lights, 1)], month=int(season))
                shares *= arriving_shares(found)
            light[:, batch] = np.add.reduceat(shares, starts, axis=0, dtype=np.float64) / counts[:, None]
    return light


class _ModuleWork:
    """The shading of modules, in parts."""

    def __init__(self, scene: AnyScene, modules: Modules, sky: _Sky, north: float, options: PvOptions):
        self.scene, self.modules, self.sky, self.north, self.options = scene, modules, sky, north, options
        self.settings = options.plan, thread_count(options.threads)

    def parts(self, folder: Path | None) -> Parts:
        """The modules in parts."""
        about = None
        if folder is not None:
            rows = [
                [*m.position, m.width, m.height, m.tilt.tolist(), m.azimuth.tolist(), m.lattice]
                for m in self.modules.each
            ]
            settings = inexact_plan(self.options.plan), self.options.between, self.north, rows
            of = scene_digest(self.scene, 0.0, self.settings[1])
            about = about_parts("modules", of, *settings, self.sky.towards, self.sky.months, self.sky.times)
        n, k = len(self.modules.each), self.sky.over.size
        return Parts(f"modules: {n:,} x {counted(k, 'direction')}", n, _MODULES, self._part, folder, about)

    def _part(self, first: int, last: int) -> dict[str, np.ndarray]:
        """Shaded fractions and sky-view factors, (modules, times), of some modules."""
        some, times = self.modules.part(first, last), self.modules.times
        shaded, factor = np.ones((last - first, times)), np.empty((last - first, times))
        if not self.modules.turn:
            planes, blockers = self._planes(some, 0)
            if len(self.sky.times):
                shaded[:, self.sky.times] = self._shaded(some, planes, blockers, slice(None))
            factor[:] = self._factors(some, planes, blockers, 0, self._horizons(self.scene, planes))[:, None]
            return {"shaded": shaded, "factor": factor}
        middles = _middles(some, self._planes(some, 0)[0])
        horizons = self._horizons(self.scene, middles._replace(normals=None))
        for time in range(times):
            planes, blockers = self._planes(some, time)
            factor[:, time] = self._factors(some, _middles(some, planes), blockers, time, horizons)
            if len(k := np.flatnonzero(self.sky.times == time)):
                shaded[:, time] = self._shaded(some, planes, blockers, slice(k[0], k[0] + 1))[:, 0]
        return {"shaded": shaded, "factor": factor}

    def _planes(self, some: Modules, time: int) -> tuple[Planes, Scene | None]:
        """Some modules at a time, and all modules as a scene; None: they shade nothing."""
        corners = self.modules.planes(time, self.north, self.scene.up).corners
        planes = some.planes(time, self.north, self.scene.up)
        if not self.options.between or not len(corners):
            return planes, None
        off = _ROUNDING * float(np.ptp(corners.reshape(-1, 3), axis=0).max())  # of its own plane, which float32 tilts
        assert planes.normals is not None
        lifted = planes._replace(points=planes.points + off * planes.normals)
        return lifted, Scene.from_arrays(corners, name="modules", up=self.scene.up)

    def _shaded(self, some: Modules, planes: Planes, blockers: Scene | None, rows: slice) -> NDArray[np.float64]:
        """(m, k): the share of the direct light that is blocked at some times with sun."""
        towards, over = self.sky.towards[rows], self.sky.over[rows]
        months = np.repeat(self.sky.months[rows], over.shape[1])
        traced = [Traced.of(scene, planes) for scene in (self.scene, blockers) if scene is not None]
        lit = light_through(traced, towards.reshape(-1, 3), months, some.starts[:-1], self.settings)
        return np.asarray(1.0 - (lit.reshape(-1, *over.shape) * over).mean(2))

    def _horizons(self, scene: AnyScene, planes: Planes) -> NDArray[np.float64]:
        """(p, azimuths) degrees: the skylines of points."""
        return horizon_elevations(
            scene, point_sensors(planes.points, planes.normals), _STEP, self.north, self.settings[1]
        )

    def _factors(
        self, some: Modules, planes: Planes, blockers: Scene | None, time: int, horizons: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """(m,): the sky-view factors of planes, means over their points; horizons: those of the scene."""
        if blockers is not None:
            horizons = np.maximum(horizons, self._horizons(blockers, planes))
        starts = some.starts if len(planes.points) == some.starts[-1] else np.arange(len(some.each) + 1)
        azimuths = np.arange(horizons.shape[1]) * _STEP
        factors = list[float]()
        for k, (tilt, azimuth) in enumerate(some.tilts(time).tolist()):
            rows = slice(starts[k], starts[k + 1])
            seen = Skyline(planes.points[rows], azimuths, horizons[rows], horizons[rows], {})
            factors.append(float(seen.sky_view_factor(tilt, azimuth).mean()))
        return np.array(factors)


def _middles(some: Modules, planes: Planes) -> Planes:
    """The middles of modules, with their normals."""
    assert planes.normals is not None
    points = np.add.reduceat(planes.points, some.starts[:-1], axis=0) / np.diff(some.starts)[:, None]
    return Planes(points, planes.normals[some.starts[:-1]], planes.corners)


def _of_strings(
    modules: Modules, shaded: NDArray[np.float64], factor: NDArray[np.float64]
) -> tuple[list[str], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """The names of strings; means of shaded fractions and sky-view factors, weighted by area; greatest fractions."""
    names = list(dict.fromkeys(module.string for module in modules.each if module.string))
    means, factors, most = list[np.ndarray](), list[np.ndarray](), list[np.ndarray]()
    for name in names:
        rows = np.array([k for k, module in enumerate(modules.each) if module.string == name])
        areas = np.array([modules.each[k].area for k in rows])
        weights = areas / areas.sum() if areas.all() else np.full(len(rows), 1.0 / len(rows))
        means.append(weights @ shaded[rows])
        factors.append(weights @ factor[rows])
        most.append(shaded[rows].max(0))
    return names, np.array(means), np.array(factors), np.array(most)
