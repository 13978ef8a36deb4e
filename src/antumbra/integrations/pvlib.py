"""pvlib: `pvlib_shading`, the shading of direct and diffuse light at the times of a pandas index.

pvlib models the irradiance of open horizons. ``dni * (1 - shaded_fraction)`` and ``dhi * sky_view_factor`` are what
arrives between buildings, trees and hills.
"""

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.checks import checked_instance, number, whole_number
from ..base.errors import InputError
from ..base.extras import import_extra
from ..base.progress import Progress, with_progress
from ..city.sensors.sensors import Sensors
from ..city.skyline.skyline import sensors_at, skyline
from ..city.sun.sun_options import MOST_SAMPLES
from ..city.sun.sun_visibility import (
    DISK,
    arriving_shares,
    bundle_order,
    disk_directions,
    seasons_of,
)
from ..engine.measured_scenes import measured_scene
from ..engine.plan import DEFAULT_PLAN, Plan, parse_plan
from ..engine.scene import AnyScene
from ..engine.scene_loading import SceneLike
from ..kernels.parallel import thread_count
from ..query.light_samples import light_samples
from ..query.receivers import Receivers
from ..scene.light_lists import DirectionalLights
from ..scene.lights import MAX_SPP
from ..sun.location import Place, checked_place, place_in
from ..sun.sun_positions import directions_of, months_of, solar_angles

if TYPE_CHECKING:
    import pandas

COLUMNS = "shaded_fraction", "sky_view_factor", "solar_azimuth", "solar_elevation"
"""The columns of `pvlib_shading`."""


@with_progress
def pvlib_shading(
    scene: SceneLike, points: Sensors | ArrayLike, times: Any, *, normals: ArrayLike | None = None, tilt: float = 0.0,
    azimuth: float = 180.0, samples: int = 16, place: Place | None = None, plan: str | Plan | None = None,
    threads: int | None = None, progress: Progress = None,
) -> "pandas.DataFrame":  # fmt: skip
    """Find the shaded fraction of a module, and the share of the sky that it sees, at the times of a pandas index.

    Each sample of the sun's disk is traced exactly from each point, at the geometric position of the sun
    (``elevation`` of pvlib, not ``apparent_elevation``).

    Parameters
    ----------
    scene : Scene, PagedScene, or anything that `antumbra.load` takes
        Stores have no skylines and are refused.
    points : (3,) or (n, 3) float, or Sensors
        World coordinates of points on a module; results are means over them.
    times : pandas.DatetimeIndex
        With a time zone.
    normals : (3,) or (n, 3) float, optional
        For points on surfaces of the scene, towards the light. None: the points lie in free space.
    tilt, azimuth : float
        Degrees: of the module's plane, whose share of the sky is computed; as pvlib's ``surface_tilt`` and
        ``surface_azimuth``, clockwise from true north.
    samples : int
        Points on the sun's disk, 1 to 64; 1: its centre.
    place : Place, optional
        None: that of the scene's CRS.
    plan, threads
        As in `antumbra.sun_hours`.
    progress : function of (text, done, total), or bool, optional
        Called during the work. False: show nothing. None: terminals and notebooks show a bar after a second.

    Returns
    -------
    pandas.DataFrame
        Indexed by `times`: "shaded_fraction", the share of the direct light that is blocked, 0 to 1, and 1 while the
        sun is below the horizon; "sky_view_factor" of the plane, the same at all times, by `Skyline.sky_view_factor`;
        "solar_azimuth" and "solar_elevation", degrees. Its ``attrs["up"]`` is the axis of the scene that points up.

    Raises
    ------
    InputError
        If times are no index with a time zone, the place is unknown, an argument is invalid, or a package is missing
        (``antumbra[sun]``).
    """
    pandas = import_extra("pandas", "pvlib_shading", "sun")
    scene, threads = measured_scene(scene), thread_count(threads)
    parse_plan(DEFAULT_PLAN if plan is None else plan)
    number(tilt, "tilt (degrees)", 0.0, 180.0, "[]")
    number(azimuth, "azimuth (degrees)", -360.0, 360.0, "[]")
    samples = whole_number(samples, "samples", 1, MOST_SAMPLES)
    if not isinstance(times, pandas.DatetimeIndex) or times.tz is None:
        raise InputError("times must be a pandas.DatetimeIndex with a time zone; tz_localize it")
    if times.hasnans:
        raise InputError("times hold NaT; drop these rows")
    place = place_in(scene, None if place is None else checked_place(checked_instance(place, Place, "place")))
    if place is None:
        raise InputError("the place is unknown; give a place, such as antumbra.Place(52.0, 4.36), or a CRS")
    sensors = sensors_at(scene, points, normals)
    instants = times.tz_convert("UTC").tz_localize(None).to_numpy().astype("datetime64[s]")
    elevation, bearing = solar_angles(place, instants)
    factor = skyline(scene, sensors, north=place.north, threads=threads).sky_view_factor(tilt, azimuth).mean()
    months = months_of(times.tz_localize(None).to_numpy())
    above = np.flatnonzero(elevation > -DISK / 2.0)
    shaded = np.ones(len(times))
    directions = directions_of(elevation[above], bearing[above] + place.north, scene.up)
    if len(above):
        towards = disk_directions(directions, samples)
        lit = _light(scene, sensors, towards.reshape(-1, 3), np.repeat(months[above], samples), plan, threads)
        over = towards[..., "xyz".index(scene.up)] > 0.0  # while the sun rises or sets, a part of its disk
        shaded[above] = 1.0 - (lit.reshape(over.shape) * over).mean(1)
    values = shaded, np.full(len(times), factor), bearing, elevation
    table = pandas.DataFrame(dict(zip(COLUMNS, values)), index=times)
    table.attrs["up"] = scene.up
    return table


def _light(
    scene: AnyScene, sensors: Sensors, towards: NDArray[np.float64], months: NDArray[np.int64],
    plan: str | Plan | None, threads: int,
) -> NDArray[np.float64]:  # fmt: skip
    """(k,) float64: the share of the light from each direction that arrives, a mean over the points.

    months : (k,) int64, of the transmittances of leaves
    """
    engine = scene.engine.with_options(plan, threads, None)
    receivers, seasons = (
        Receivers.of(sensors.points, sensors.normals, scene.origin, scene.middle),
        seasons_of(scene, months),
    )
    light = np.zeros(len(towards))
    for season in np.unique(seasons):
        rows = np.flatnonzero(seasons == season)
        rows = rows[bundle_order(towards[rows], seasons[rows])]
        for batch in np.split(rows, range(MAX_SPP, len(rows), MAX_SPP)):
            lights = DirectionalLights(-towards[batch])
            (traced,) = engine.shadows(receivers, [lights], [light_samples(lights, 1)], month=int(season))
            light[batch] = arriving_shares(traced).mean(0)
    return light
