"""A pinhole camera, and the rays through its pixel centres."""

from typing import NamedTuple

import numpy as np

from ..checks import number, vector, whole_number
from ..errors import InputError

MAX_SIZE = 32768  # pixels, each way
_FARTHEST = 1e30  # float32 holds all differences of coordinates below this


class CameraRays(NamedTuple):
    """A camera's rays for kernels, in the recentred frame of a scene.

    The ray of pixel (x, y), x right and y down, starts at ``origin``. Its direction is
    ``float32(corner + (x + 0.5) * dx + (y + 0.5) * dy)``, evaluated in float64 in that order, component by component.
    The direction's component along the view axis is 1, so t is the depth.
    """

    origin: np.ndarray  # (3,) float32, recentred
    corner: np.ndarray  # (3,) float64, direction to the image's upper left corner
    dx: np.ndarray  # (3,) float64, one pixel to the right
    dy: np.ndarray  # (3,) float64, one pixel down
    width: int  # pixels
    height: int


class Camera:
    """A pinhole camera in world space, right-handed. It looks from ``position`` to ``target``.

    Parameters
    ----------
    position, target, up : (3,) float, world space
    vfov : float
        Vertical field of view in degrees, 0 < vfov < 180.
    width, height : int
        Picture size in pixels, 1 to 32768.

    Raises
    ------
    InputError
        On non-finite or huge numbers, a target at the position, ``up`` along the view, or sizes out of range.
    """

    def __init__(self, position, target, up=(0.0, 1.0, 0.0), vfov=60.0, width=1024, height=1024):
        self.position = vector(position, "camera position")
        self.target = vector(target, "camera target")
        self.up = vector(up, "camera up")
        self.vfov = number(vfov, "camera vfov (degrees)", 0.0, 180.0)
        self.width = whole_number(width, "picture width", 1, MAX_SIZE)
        self.height = whole_number(height, "picture height", 1, MAX_SIZE)
        for name in ("position", "target", "up"):
            if np.abs(getattr(self, name)).max() > _FARTHEST:
                raise InputError(f"camera {name} is {getattr(self, name)}; nothing may be beyond {_FARTHEST:g}")
        view = self.target - self.position
        if not np.linalg.norm(view) > 0.0:
            raise InputError("camera target is at the camera position; move one of them")
        right = np.cross(view, self.up)
        if np.linalg.norm(right) <= 1e-9 * np.linalg.norm(view) * np.linalg.norm(self.up):
            raise InputError("camera up is along the view direction (or zero); choose another up")

    def resized(self, width: int, height: int) -> "Camera":
        """The same camera with another picture size."""
        return Camera(self.position, self.target, self.up, self.vfov, width, height)

    def rays(self, origin) -> CameraRays:
        """The pixels' rays in the frame whose zero is at world position ``origin`` ((3,) float64)."""
        view = self.target - self.position
        view = view / np.linalg.norm(view)
        right = np.cross(view, self.up)
        right = right / np.linalg.norm(right)
        down = np.cross(view, right)
        half = np.tan(np.radians(self.vfov) / 2.0)
        dx = right * (2.0 * half / self.height)
        dy = down * (2.0 * half / self.height)
        corner = view - dx * (self.width / 2.0) - dy * (self.height / 2.0)
        position = (self.position - np.asarray(origin, np.float64)).astype(np.float32)
        return CameraRays(position, corner, dx, dy, self.width, self.height)

    def __repr__(self) -> str:
        p, t, u = (", ".join(f"{c:g}" for c in v) for v in (self.position, self.target, self.up))
        return (
            f"Camera(position=({p}), target=({t}), up=({u}), vfov={self.vfov:g}, "
            f"width={self.width}, height={self.height})"
        )
