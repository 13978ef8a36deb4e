"""A browser that looks at a page: its camera, and the pictures that it gets, ever finer while the camera rests."""

from collections.abc import Callable
from threading import Timer
from typing import Any

import numpy as np

from .model import Model
from .pictures import Traced, steps_of, traced
from .stage import Pose, turned
from .worker import FINE, PICTURE, Worker

REST = 0.15
"""Seconds after the last move until the camera rests."""

_QUICK = 4  # most shadow rays of the pictures that come before all other work
_QUALITY = 92  # of JPEG
_LARGEST = 1 << 14  # pixels of a side of a page
_SHOWN = 0.1  # seconds until a browser shows a picture that was sent


class Viewing:
    """What one browser sees.

    Parameters
    ----------
    model : Model
    worker : Worker
    client : the browser, as viser hands it out
    drawn : function of a `Traced`
        Called, in the worker's thread, for each picture that was sent.
    """

    def __init__(self, model: Model, worker: Worker, client: Any, drawn: Callable[[Traced], None]):
        self.model, self._worker, self._client, self._drawn = model, worker, client, drawn
        self.name = f"picture {client.client_id}"
        self.pose: Pose | None = None
        self._level = self._changes = 0
        self._standin: Any = None
        self._navigating = False  # the stand-in is seen, and no picture

    async def look(self, camera: Any) -> None:
        """Take over the browser's camera."""
        pose = pose_of(camera)
        if pose is None or (self.pose is not None and same(pose, self.pose)):
            return
        first, self.pose = self.pose is None, pose
        self.model.seen_by = self.model.stage.camera(pose)
        if self._standin is not None and not self._navigating:
            self._navigating = True
            self._standin.visible = True
            self._client.scene.set_background_image(None)
        self.begin(REST if self._standin is not None and not first else 0.0)

    def begin(self, after: float) -> None:
        """Begin with the coarsest picture, after some seconds."""
        self._level, self._changes = 0, self._changes + 1
        self._worker.ask(self.name, PICTURE, self._draw_quick, after)

    def leave(self) -> None:
        """The browser has gone: it gets nothing more."""
        self.pose = None
        self._worker.drop(self.name)

    def put_standin(self, data: bytes) -> None:
        """Give the browser the stand-in, a GLB file."""
        self._standin = self._client.scene.add_glb("/stand-in", data, visible=self._navigating)

    def _draw_quick(self, check: Callable[..., None]) -> None:
        self._draw(check, _QUICK)
        if self._level < len(steps_of(self.model)):
            self._worker.ask(self.name, FINE, self._draw)

    def _draw(self, check: Callable[..., None], most: int | None = None) -> None:
        """Draw the pictures that are left; up to `most` shadow rays. The coarsest one is always finished."""
        steps = steps_of(self.model)
        while self.pose is not None and self._level < len(steps):
            step, pose, changes = steps[self._level], self.pose, self._changes
            if most is not None and step.spp > most:
                return
            camera = self.model.stage.camera(pose)
            picture = traced(self.model, camera, step, check if self._level else lambda *_: None)
            if self.pose is None or (self.pose is not pose and self._standin is not None):
                return
            self._send(picture)
            if self._changes == changes:
                self._level += 1

    def _send(self, picture: Traced) -> None:
        kind = "png" if picture.legend is not None else "jpeg"
        self._client.scene.set_background_image(picture.image, kind, jpeg_quality=_QUALITY)
        if self._navigating:
            self._navigating = False
            later = Timer(_SHOWN, self._hide)  # the browser decodes pictures in its own time
            later.daemon = True
            later.start()
        self._drawn(picture)

    def _hide(self) -> None:
        if not self._navigating and self._standin is not None and self.pose is not None:
            self._standin.visible = False


def pose_of(camera: Any) -> Pose | None:
    """The pose of viser's camera; None if the browser has no area yet, or sends what is no camera."""
    position, size = np.array(camera.position, np.float64), (int(camera.image_width), int(camera.image_height))
    wxyz, fov = np.array(camera.wxyz, np.float64), float(camera.fov)
    if not (1 <= min(size) <= max(size) <= _LARGEST and position.shape == (3,) and wxyz.shape == (4,)):
        return None
    if not (np.isfinite(position).all() and abs(np.linalg.norm(wxyz) - 1.0) < 1e-3 and 0.0 < fov < np.pi):
        return None
    _, down, forward = turned(wxyz).T
    return Pose(position, position + forward, -down, fov, *size)


def same(a: Pose, b: Pose) -> bool:
    """Whether two poses show the same. Browsers that draw slowly take fewer pixels for the same view."""
    views = zip(a[:4], b[:4])
    return all(np.allclose(x, y, rtol=0.0, atol=1e-6) for x, y in views) and abs(_aspect(a) - _aspect(b)) < 0.01


def _aspect(pose: Pose) -> float:
    return pose.width / pose.height
