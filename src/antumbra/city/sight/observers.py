"""The observers of a viewshed: their eyes, names and limits, from points or from a table with a row for each."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...base.checks import as_array, points
from ...base.errors import InputError
from ...engine.scene import AnyScene
from ...kernels.parallel import thread_count
from ..sensors.point_attributes import names_of_rows
from ..sensors.point_checks import on_surface
from ..sensors.sensors import Sensors
from .viewshed_options import ViewshedOptions

PER_OBSERVER = "eye_height", "min_distance", "max_distance"
"""Columns of a table of observers that replace the options of these names."""


class Observers(NamedTuple):
    """The observers of a viewshed."""

    eyes: NDArray[np.float64]  # (k, 3)
    names: tuple[str, ...]
    limits: list[ViewshedOptions]  # of each

    def reach(self, some: NDArray[np.integer]) -> float:
        """The greatest distance of some of them."""
        return float(max(self.limits[k].reach for k in some.tolist()))


def observers_of(scene: AnyScene, observers: ArrayLike | Sensors, options: ViewshedOptions) -> Observers:
    """The observers' eyes, names and limits; attributes of `Sensors` replace options."""
    rows = observers if isinstance(observers, Sensors) else None
    given = np.atleast_2d(as_array(observers, "observers")) if rows is None else rows.points
    eyes = points(given, "observers").copy()
    if not len(eyes):
        raise InputError("there is no observer; give at least one")
    attributes = {} if rows is None else rows.attributes
    values = {name: _per_row(attributes.get(name), name, options, len(eyes)) for name in PER_OBSERVER}
    if options.on_surface:
        eyes = on_surface(scene, eyes, "observers", scene.clamped(options.time), thread_count(options.threads))
    eyes[:, "xyz".index(scene.up)] += values["eye_height"]
    names = tuple(names_of_rows("observers", attributes if options.each else {}, len(eyes)))
    limits = [options] * len(eyes)
    if {"min_distance", "max_distance"} & attributes.keys():
        ranges = zip(values["min_distance"].tolist(), values["max_distance"].tolist())
        limits = [
            replace(options, min_distance=low, max_distance=None if high == np.inf else high) for low, high in ranges
        ]
    return Observers(eyes, names, limits)


def _per_row(values: np.ndarray | None, name: str, options: ViewshedOptions, n: int) -> NDArray[np.float64]:
    """(n,) float64: an attribute of observers, or the option where there is none."""
    option = options.reach if name == "max_distance" else getattr(options, name)
    if values is None:
        return np.full(n, option)
    if values.dtype.kind not in "fiu":
        raise InputError(f"the column {name} of observers must hold numbers")
    return np.where(np.isnan(values.astype(np.float64)), option, values)
