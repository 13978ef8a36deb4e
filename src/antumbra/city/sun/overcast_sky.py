"""The vertical sky component: the light of the CIE's overcast sky on a vertical plane, relative to open ground."""

import numpy as np

from ...base.errors import InputError
from ...base.wording import some_of
from ...engine.scene import AnyScene
from ..sensors.sensors import Sensors
from ..sensors.surface_groups import tilts
from .daylight_rules import Rule
from .sun_visibility import SunQuery

OVERCAST_DIRECTIONS = 8192
"""Directions to the sky. Opposite a long wall, the error is at most 0.04 percentage points."""

_UPRIGHT = 1.0  # degrees: a plane that is tilted by less is vertical


def overcast(query: SunQuery) -> SunQuery:
    """A query of sky directions, each for an equal share of the sky, whose energies add up to percent of open ground.

    The luminance of the CIE's overcast sky is proportional to 1 + 2 sin(altitude), so its light on open ground is 7/3
    of that of a uniform sky as bright as its horizon.
    """
    directions = query.calendar.directions
    heights = directions[:, "xyz".index(query.scene.up)]
    percent = 100.0 * (6.0 / 7.0) * (1.0 + 2.0 * heights) / len(directions)
    return query._replace(calendar=query.calendar._replace(energy=percent))


def upright_sensors(scene: AnyScene, sensors: Sensors, rule: Rule) -> tuple[Sensors, list[str]]:
    """The sensors on vertical planes, and a note if there are others.

    rule : that needs them

    Raises
    ------
    InputError
        If there are none, or the sensors do not know where they face.
    """
    cure = "give points on walls, with the columns nx, ny and nz, or the sensors face or grid"
    if sensors.normals is None or sensors.kind == "raster":
        raise InputError(f"rule {rule.name} needs to know where windows face; {cure}")
    upright = np.abs(tilts(sensors.normals, scene.up) - 90.0) <= _UPRIGHT
    if upright.all():
        return sensors, []
    if not upright.any():
        raise InputError(f"rule {rule.name} is about vertical planes, and no sensor lies on one; {cure}")
    left = len(sensors) - int(upright.sum())
    note = f"rule {rule.name} is about vertical planes: {some_of(left, len(sensors), 'sensor', 'are')} left out"
    return sensors.take(np.flatnonzero(upright)), [note]
