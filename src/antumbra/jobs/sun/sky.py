"""How much of the sky sensors see: `sky_view`, and the sky-view factor of `sun_hours`."""

import numpy as np
from numpy.typing import ArrayLike

from ...checks import whole_number
from ...engine.plan import DEFAULT_PLAN, Plan, parse_plan
from ...engine.scene import AnyScene
from ...engine.scene_loading import SceneLike, scene_of
from ...kernels.parallel import thread_count
from ...progress import Progress, with_progress
from ..readsensors import sensors_of
from ..sensors import Sensors
from ..sight.ends import sensors_from
from ..table import Column, Table
from .hours import Asked, answer, ask
from .positions import Suns
from .tally import Tally

MOST_DIRECTIONS = 1 << 14
ABOUT = "sky-view factor: share of a uniform sky's light that arrives"


def sky_directions(count: int, up: str) -> np.ndarray:
    """(count, 3) float64: unit vectors to points of equal share of the sky, on a spiral (Vogel's, lifted)."""
    i = np.arange(count)
    height, angle = (i + 0.5) / count, i * np.pi * (3.0 - np.sqrt(5.0))
    width = np.sqrt(1.0 - height * height)
    east, north = width * np.cos(angle), width * np.sin(angle)
    return np.stack([east, north, height] if up == "z" else [east, height, -north], axis=1)


@with_progress
def sky_view(
    scene: SceneLike, sensors: Sensors | ArrayLike | str = "face", *, directions: int = 4096,
    plan: str | Plan | None = None, threads: int | None = None, progress: Progress = None,
) -> Table:  # fmt: skip
    """Find how much of the sky each sensor sees. It needs no place and no dates.

    Two definitions are common, and each has its column:

    - ``sky_view``: the sky-view factor, in which a direction counts by its cosine to the sensor's normal. It is the
      share of a uniform sky's light that arrives, over the light on an open horizontal plane.
    - ``sky_share``: the share of the sky's hemisphere that is visible, in which all directions count alike. On a
      floor, obstructions near the horizon take more from it than from ``sky_view``.

    Both are 1 on an open floor and 0.5 on a free wall: half of the hemisphere above the wall's plane is ground.

    Directions below the horizon belong to the ground. Sensors without normals are points in the air: both columns count
    all directions alike.

    Parameters
    ----------
    scene : Scene, PagedScene, or anything that `antumbra.load` takes
    sensors : Sensors, str, or (n, 3) float
        As in `sun_hours`.
    directions : int
        Number of directions, 1 to 16384. In a street, 1024 err by up to 0.007, and 4096 by up to 0.002.
    plan, threads
        As in `antumbra.render`.
    progress : function of (text, done, total), or bool, optional
        Called while the job works. False: nothing is shown. None: terminals and notebooks show a bar after a second.

    Returns
    -------
    Table
        Columns "sky_view" and "sky_share", both from 0 to 1.

    Raises
    ------
    InputError
        If a text has another form, or a number is out of range.
    """
    count = whole_number(directions, "directions", 1, MOST_DIRECTIONS)
    scene, threads = scene_of(scene), thread_count(threads)
    parse_plan(DEFAULT_PLAN if plan is None else plan)
    named = sensors_of(sensors, scene, threads) if isinstance(sensors, str) else sensors
    sensors = sensors_from(scene, named, None, "sensors")
    tally = answer(asked_sky(scene, sensors, count, plan, threads), what="sky")
    columns = {
        "sky_view": Column(share_of_sky(tally), "", ABOUT),
        "sky_share": Column(tally.hours / count, "", "share of the sky's hemisphere that is visible"),
    }
    return Table(sensors, columns, {"job": "sky view", "directions": count}, scene)


def asked_sky(scene: AnyScene, sensors: Sensors, count: int, plan, threads) -> Asked:
    """The directions of the sky as suns, whose energy is that of a uniform sky."""
    towards = sky_directions(count, scene.up)
    zeros, times = np.zeros(count), np.zeros(count, "datetime64[s]")
    suns = Suns(times, times, np.ones(count), towards, zeros, zeros)
    energy = np.full(count, 1.0 if sensors.normals is None else 2.0) / count
    return ask(scene, sensors, suns, np.empty((count, 0), np.int64), 1, energy=energy, plan=plan, threads=threads)


def share_of_sky(tally: Tally) -> np.ndarray:
    """(n,) float64 in [0, 1]: the sky-view factor, from the sums over the directions of `asked_sky`."""
    return np.minimum(tally.energy, 1.0)
