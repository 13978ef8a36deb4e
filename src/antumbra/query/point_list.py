"""Point lists: the checked points of queries about places, such as `Scene.contains`, in the scene's frame."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.checks import as_array
from ..base.errors import InputError
from ..scene.scene_bounds import flush_to_zero

MAX_COORDINATE = 1e38
"""Points must be closer to 0, so that float32 can represent them."""


class PointArguments(NamedTuple):
    """Points with checked shapes and numbers."""

    points: NDArray[Any]  # (..., 3) world
    frame: tuple[float, float, float]  # world position of the origin of the scene's frame

    @property
    def shape(self) -> tuple[int, ...]:
        """That of the points, (...)."""
        return self.points.shape[:-1]

    def checked(self) -> "PointArguments":
        """Themselves. InputError if a point is NaN, infinite or beyond float32."""
        failed = self.without_failed()[1]
        if len(failed):
            raise InputError(f"points are NaN, infinite or beyond float32 (point {failed[0]})")
        return self

    def without_failed(self) -> "tuple[PointArguments, NDArray[np.intp]]":
        """The points with another in the place of each that fails alone; and the indices of those, in C order.

        A point fails if a coordinate is NaN, infinite or beyond float32. InputError if all points do.
        """
        low, high = self.points.min(initial=0.0), self.points.max(initial=0.0)  # of all, without other arrays
        if low > -MAX_COORDINATE and high < MAX_COORDINATE:
            return self, np.empty(0, np.intp)
        good = (np.abs(self.points) < MAX_COORDINATE).all(-1)
        if not good.any():
            raise InputError("points are NaN, infinite or beyond float32 (point 0)")
        points = np.where(good[..., None], self.points, self.points[good][0])
        return self._replace(points=points), np.flatnonzero(~good)

    def local(self) -> NDArray[np.float32]:
        """(n, 3) float32: the points in the scene's frame, recentred in float64 and rounded once."""
        world = self.points.reshape(-1, 3).astype(np.float64)
        return np.ascontiguousarray(flush_to_zero((world - self.frame).astype(np.float32)))


def points_of(points: ArrayLike, frame: tuple[float, float, float]) -> PointArguments:
    """Points, (..., 3) world. InputError if the shape is another."""
    array = as_array(points, "points", strided=True)
    if array.ndim < 1 or array.shape[-1] != 3:
        raise InputError(f"points must have shape (..., 3), not {array.shape}")
    return PointArguments(array, frame)
