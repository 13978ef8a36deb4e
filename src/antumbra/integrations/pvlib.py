"""pvlib: `pvlib_shading`, the shading of direct and diffuse light at the times of a pandas index.

pvlib models the irradiance of open horizons. ``dni * (1 - shaded_fraction)`` and ``dhi * sky_view_factor`` are what
arrives between buildings, trees and hills.
"""

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ..base.checks import checked_instance, number, whole_number
from ..base.errors import InputError
from ..base.extras import import_extra
from ..base.progress import Progress, with_progress
from ..city.pv.module_shading import Traced, checked_times, light_through, module_shading, sky_of
from ..city.pv.modules import PvModule
from ..city.sensors.sensors import Sensors
from ..city.skyline.skyline import sensors_at, skyline
from ..city.sun.sun_options import MOST_SAMPLES
from ..engine.measured_scenes import measured_scene
from ..engine.plan import DEFAULT_PLAN, Plan, parse_plan
from ..engine.scene_loading import SceneLike
from ..kernels.parallel import thread_count
from ..query.receivers import Receivers
from ..sun.location import Place, checked_place, checked_place_of
from ..sun.sun_positions import months_of, solar_angles

if TYPE_CHECKING:
    import pandas

COLUMNS = "shaded_fraction", "sky_view_factor", "solar_azimuth", "solar_elevation"
"""The columns of `pvlib_shading`."""


@with_progress
def pvlib_shading(
    scene: SceneLike, points: "Sensors | ArrayLike | PvModule | dict[str, PvModule]", times: Any, *,
    normals: ArrayLike | None = None, tilt: float = 0.0,
    azimuth: float = 180.0, samples: int = 16, place: Place | None = None, plan: str | Plan | None = None,
    threads: int | None = None, progress: Progress = None,
) -> "pandas.DataFrame":  # fmt: skip
    """Find how much of a module is shaded, and how much of the sky it sees, at the times of a pandas index.

    Each sample of the sun's disk is traced exactly from each point, at the geometric position of the sun
    (``elevation`` of pvlib, not ``apparent_elevation``).

    Parameters
    ----------
    scene : Scene, PagedScene, or anything that `antumbra.load` takes
        Stores have no skylines and are refused.
    points : (3,) or (n, 3) float, Sensors, PvModule, or dict of str to PvModule
        World coordinates of points on a module; results are means over them. `antumbra.PvModule` describes fixed
        modules and trackers, of which many are computed in one call.
    times : pandas.DatetimeIndex
        With a time zone.
    normals : (3,) or (n, 3) float, optional
        For points on surfaces of the scene, towards the light. None: the points lie in free space.
    tilt, azimuth : float
        Degrees: of the module's plane, whose share of the sky is computed; as pvlib's ``surface_tilt`` and
        ``surface_azimuth``, clockwise from true north. A `PvModule` has its own.
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
        "solar_azimuth" and "solar_elevation", degrees. Its ``attrs["up"]`` is the axis of the scene that points up. For
        modules, it is `ModuleShading.frame`, indexed by module and time: ``table["shaded_fraction"].unstack("module")``
        has a column for each.

    Raises
    ------
    InputError
        If times are no index with a time zone, the place is unknown, an argument is invalid, or a package is missing
        (``antumbra[sun]``).

    Examples
    --------
    >>> import pandas
    >>> wall = at.Scene.from_arrays([[-9, -5, 0], [9, -5, 0], [9, -5, 3], [-9, -5, 3]], [[0, 1, 2], [0, 2, 3]], up="z")
    >>> noons = pandas.DatetimeIndex(["2026-06-21T12:00Z", "2026-12-21T12:00Z"])
    >>> shading = at.pvlib_shading(wall, [[0, 0, 1]], noons, place=at.Place(52.0, 4.36), tilt=30)
    >>> shading["shaded_fraction"].round(2).tolist()
    [0.0, 1.0]
    """
    pandas = import_extra("pandas", "pvlib_shading", "sun")
    if isinstance(points, (PvModule, dict)):
        options: dict[str, Any] = {"samples": samples, "place": place, "plan": plan, "threads": threads}
        if normals is not None or (tilt, azimuth) != (0.0, 180.0):
            raise InputError("modules have planes of their own; leave normals, tilt and azimuth out")
        return module_shading(scene, points, times, progress=progress, **options).frame()
    scene, threads = measured_scene(scene), thread_count(threads)
    parse_plan(DEFAULT_PLAN if plan is None else plan)
    number(tilt, "tilt (degrees)", 0.0, 180.0, "[]")
    number(azimuth, "azimuth (degrees)", -360.0, 360.0, "[]")
    samples = whole_number(samples, "samples", 1, MOST_SAMPLES)
    times = checked_times(times)
    place = checked_place_of(scene, None if place is None else checked_place(checked_instance(place, Place, "place")))
    sensors = sensors_at(scene, points, normals)
    instants = times.tz_convert("UTC").tz_localize(None).to_numpy().astype("datetime64[s]")
    elevation, bearing = solar_angles(place, instants)
    factor = skyline(scene, sensors, north=place.north, threads=threads).sky_view_factor(tilt, azimuth).mean()
    months = months_of(times.tz_localize(None).to_numpy())
    shaded, sky = np.ones(len(times)), sky_of(scene, place, elevation, bearing, months, samples)
    if len(sky.times):
        receivers = Receivers.of(sensors.points, sensors.normals, scene.origin, scene.middle)
        towards, of_samples = sky.towards.reshape(-1, 3), np.repeat(sky.months, samples)
        lit = light_through([Traced(scene, receivers)], towards, of_samples, np.zeros(1, np.int64), (plan, threads))
        shaded[sky.times] = 1.0 - (lit.reshape(sky.over.shape) * sky.over).mean(1)
    values = shaded, np.full(len(times), factor), bearing, elevation
    table = pandas.DataFrame(dict(zip(COLUMNS, values)), index=times)
    table.attrs["up"] = scene.up
    return table
