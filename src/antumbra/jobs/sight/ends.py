"""Points as ends of sightlines, in the float32 frame in which sightlines are exact."""

import numpy as np
from numpy.typing import ArrayLike

from ...checks import as_array
from ...checks import points as checked_points
from ...engine.scene import AnyScene
from ...errors import InputError
from ...query.receivers import Receivers
from ..sensorfields import check_on_scene
from ..sensors import Sensors, point_sensors


def ends_of(scene: AnyScene, sensors: Sensors) -> Receivers:
    """The ends of sensors. Those with normals lie on surfaces, and are moved off them (docs/design/receivers.md).

    The cells of a raster are moved up, off the surfaces below them, but they see all around: the surface may be steep.
    """
    ends = Receivers.of(sensors.points, sensors.normals, scene.origin)
    return ends.seeing_all_around() if sensors.kind == "raster" else ends


def sensors_from(scene: AnyScene, given: ArrayLike | Sensors, normals: ArrayLike | None, what: str) -> Sensors:
    """Sensors of a scene as they are, or of points with normals. InputError names `what` they are."""
    if isinstance(given, Sensors):
        check_on_scene(given, scene)
        return given
    where = checked_points(given, what)
    if normals is not None:
        normals = np.atleast_2d(as_array(normals, f"normals of {what}"))
        if len(normals) not in (1, len(where)):
            raise InputError(f"normals of {what} must be one, or one for each of {len(where)}, not {normals.shape}")
        normals = np.broadcast_to(checked_points(normals, f"normals of {what}"), where.shape)
    return point_sensors(where, normals)
