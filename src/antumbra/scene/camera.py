"""Cameras, and the rays through their pixels."""

from typing import NamedTuple

import numpy as np

from ..checks import choice, number, vector, whole_number
from ..errors import InputError
from .listed_rays import ListedRays
from .recentre import settled

MAX_SIZE = 32768  # pixels, each way
PROJECTIONS = "perspective", "orthographic", "panoramic"
_FARTHEST = 1e30  # float32 holds all differences of coordinates below this


class CameraRays(NamedTuple):
    """A perspective camera's rays for kernels, in the recentred frame of a scene.

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

    def directions(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """(..., 3) float32: about the directions through places of the picture, (...) float32 pixels right and down."""
        corner, dx, dy = (part.astype(np.float32) for part in (self.corner, self.dx, self.dy))
        return corner + x[..., None] * dx + y[..., None] * dy


class Camera:
    """A camera in world space, right-handed. It looks from ``position`` to ``target``.

    Parameters
    ----------
    position, target, up : (3,) float, world space
    vfov : float
        Vertical field of view in degrees, 0 < vfov < 180, of a perspective camera.
    width, height : int
        Picture size in pixels, 1 to 32768.
    projection : "perspective", "orthographic" or "panoramic"
        Orthographic: all rays are parallel, and start in the plane through `position`. Panoramic: rays into all
        directions from `position`, as an equirectangular map. The heading of `target` is in its middle, and `up` is the
        zenith, so the horizon is level. Its picture is twice as wide as high, or stretched.
    extent : float or None
        Height of an orthographic picture in world units; None for other projections.

    Raises
    ------
    InputError
        On non-finite or huge numbers, a target at the position, ``up`` along the view, or sizes out of range. If the
        projection is unknown, or has no extent or needs none.
    """

    def __init__(
        self, position, target, up=(0.0, 1.0, 0.0), vfov=60.0, width=1024, height=1024, *, projection="perspective",
        extent=None,
    ):  # fmt: skip
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
        choice(projection, "camera projection", PROJECTIONS)
        if (projection == "orthographic") != (extent is not None):
            raise InputError("camera extent is the height of an orthographic picture; give both or neither")
        self.projection: str = projection
        self.extent = None if extent is None else number(extent, "camera extent", 0.0, _FARTHEST)

    def resized(self, width: int, height: int) -> "Camera":
        """The same camera with another picture size."""
        return Camera(
            self.position, self.target, self.up, self.vfov, width, height, projection=self.projection,
            extent=self.extent,
        )  # fmt: skip

    def panoramic(self) -> "Camera":
        """A panoramic camera at the same place, whose middle is the heading of this camera."""
        place = self.position
        return Camera(
            place, place + self.axes[2], self.up, width=self.width, height=self.height, projection="panoramic"
        )

    @property
    def listed(self) -> bool:
        """Whether the camera is not perspective: its rays are listed one by one, and found by tracing alone."""
        return self.projection != "perspective"

    @property
    def axes(self) -> np.ndarray:
        """(3, 3) float64: unit vectors to the right and down in the picture, and along the view, in rows."""
        view = self.target - self.position
        view = view / np.linalg.norm(view)
        right = np.cross(view, self.up)
        right = right / np.linalg.norm(right)
        return np.stack([right, np.cross(view, right), view])

    @property
    def frame(self) -> np.ndarray:
        """As `axes`; of a panorama, whose horizon is level, down is away from the zenith."""
        if self.projection != "panoramic":
            return self.axes
        right, zenith = self.axes[0], self.up / np.linalg.norm(self.up)
        return np.stack([right, -zenith, np.cross(zenith, right)])

    def view(self, origin) -> "CameraRays | ListedRays":
        """The pixels' rays in the frame whose zero is at world position ``origin`` ((3,) float64)."""
        if not self.listed:
            return self.rays(origin)
        position = settled(self.position - np.asarray(origin, np.float64))
        return ListedRays(position, self.frame, self.width, self.height, self.extent)

    def rays(self, origin) -> CameraRays:
        """As `view`, of a perspective camera. Raises InputError for other projections."""
        if self.listed:
            raise InputError(f"this needs a perspective camera, and the camera is {self.projection}; give another one")
        right, down, view = self.axes
        half = np.tan(np.radians(self.vfov) / 2.0)
        dx = right * (2.0 * half / self.height)
        dy = down * (2.0 * half / self.height)
        corner = view - dx * (self.width / 2.0) - dy * (self.height / 2.0)
        position = settled(self.position - np.asarray(origin, np.float64)).astype(np.float32)
        return CameraRays(position, corner, dx, dy, self.width, self.height)

    def __repr__(self) -> str:
        p, t, u = (", ".join(f"{c:g}" for c in v) for v in (self.position, self.target, self.up))
        more = f", projection={self.projection!r}" if self.listed else ""
        more += "" if self.extent is None else f", extent={self.extent:g}"
        return (
            f"Camera(position=({p}), target=({t}), up=({u}), vfov={self.vfov:g}, "
            f"width={self.width}, height={self.height}{more})"
        )
