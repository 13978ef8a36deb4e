"""Progressive pictures of a page: coarse to fine while the camera rests, traced by one thread with priorities.

A new task replaces a queued one of the same name. Box-test pictures show the work of a plan.
"""

import threading
from collections.abc import Callable
from dataclasses import replace
from threading import Timer
from time import monotonic, perf_counter
from typing import Any, NamedTuple

import numpy as np

from ..picture.frame import Frame
from ..picture.frame_request import TimeSample
from ..picture.heat_maps import draw_bar, linear_scale
from ..picture.image_files import to_srgb8
from ..picture.render_options import RenderOptions
from ..picture.traversal_steps import explain
from ..scene.camera import Camera
from ..scene.light_lists import N_SETS
from ..scene.lights import Light
from ..scene.sky import Sky
from .viewer_model import BOX_TESTS, LIGHT_SHARE, Model, Pose, rotation_matrix

# --- One thread that traces for all that ask: what matters most first, and of work with one name only the latest ------


CLICK, PICTURE, MESH, FINE = range(4)
"""Ranks of work; the lower ones come first."""


class Interrupted(Exception):
    """Raised within work that has become void, or that something of a lower rank overtakes."""


class _Task(NamedTuple):
    name: str
    rank: int
    due: float  # seconds of `monotonic`
    work: Callable[[Callable[..., None]], None]


class TaskQueue:
    """A thread that does work, one piece after the other.

    failed : function of an exception, called in the thread when work raises one
    """

    def __init__(self, failed: Callable[[Exception], None] = lambda error: None):
        self._jobs: dict[str, _Task] = {}
        self._changed, self._failed = threading.Condition(), failed
        self._running: _Task | None = None
        self._closed = False
        self._thread = threading.Thread(target=self._serve, name="antumbra view", daemon=True)
        self._thread.start()

    def ask(self, name: str, rank: int, work: Callable[[Callable[..., None]], None], after: float = 0.0) -> None:
        """Ask for work; earlier work of this name is void, also if it is under way.

        work : function of `check`, which it calls often; work that something overtakes is called again later
        after : seconds to wait first
        """
        with self._changed:
            self._jobs[name] = _Task(name, rank, monotonic() + after, work)
            self._changed.notify_all()

    def has(self, name: str) -> bool:
        """Whether work of this name waits or is under way."""
        return name in self._jobs

    def drop(self, name: str) -> None:
        """Forget the work of this name."""
        with self._changed:
            self._jobs.pop(name, None)
            self._changed.notify_all()

    def wait(self, timeout: float = 60.0) -> bool:
        """Wait until nothing is left to do; False: it took too long. Tests use it."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._jobs and self._running is None, timeout)

    def close(self) -> None:
        """End the thread. Work under way ends at its next check."""
        with self._changed:
            self._jobs.clear()
            self._closed = True
            self._changed.notify_all()
        if self._thread is not threading.current_thread():
            self._thread.join(timeout=10.0)

    def _serve(self) -> None:
        while True:
            with self._changed:
                self._running = None
                self._changed.notify_all()
                while not self._closed and self._next() is None:
                    self._changed.wait(self._seconds())
                if self._closed:
                    return
                job = self._running = self._next()
            assert job is not None
            try:
                job.work(lambda *_, job=job: self._check(job))
            except Interrupted:
                continue
            except Exception as error:
                self._failed(error)
            with self._changed:
                if self._jobs.get(job.name) is job:
                    del self._jobs[job.name]

    def _check(self, job: _Task) -> None:
        with self._changed:
            first = self._next()
            if self._jobs.get(job.name) is not job or (first is not None and first.rank < job.rank):
                raise Interrupted

    def _next(self) -> _Task | None:
        """The work that is due, of the lowest rank and asked first."""
        now = monotonic()
        return min((job for job in self._jobs.values() if job.due <= now), key=lambda job: job.rank, default=None)

    def _seconds(self) -> float | None:
        """Until the next work is due."""
        due = min((job.due for job in self._jobs.values()), default=None)
        return None if due is None else max(due - monotonic(), 0.0)


# --- The work of a plan in colours: the boxes that the rays of each pixel test ----------------------------------------


_WIDTH, _LETTERS = 320, 15  # pixels: width of the legend, and height of its letters


class BoxTestPicture(NamedTuple):
    """The work of a plan in a picture."""

    image: np.ndarray  # (h, w, 3) uint8 sRGB; black where no ray is asked
    rays: int
    each: str  # box tests for each ray, as text
    legend: np.ndarray  # (H, W, 3) uint8 sRGB: the colours and their numbers


def box_test_picture(model: Model, camera: Camera, lights: list[Light], spp: int) -> BoxTestPicture:
    """Count the box tests of a picture's shadow rays under the page's plan."""
    moment = TimeSample(model.time, camera, lights)
    explanation = explain(model.scene, [moment], [model.looks.plan], spp=spp, threads=model.threads)
    (steps,) = explanation.plans
    scale = linear_scale(steps.boxes[explanation.asks])
    each = f"{steps.box_tests / max(explanation.rays, 1):.4g} boxes tested a ray by {steps.plan}"
    legend = draw_bar(scale.bar("boxes tested for each pixel's rays"), _WIDTH, _LETTERS)
    return BoxTestPicture(scale.colours(steps.boxes, explanation.asks), explanation.rays, each, legend)


# --- Traced pictures of a page, from coarse to fine, while its camera rests -------------------------------------------


Check = Callable[..., None]
"""Called often during long work; it raises an exception to end the work. Arguments are ignored."""

MOST_PIXELS = 1_600_000
"""Of a picture. Pages with more pixels show it enlarged."""

_UNLIT = np.array([24, 26, 32], np.uint8)  # where no surface is seen


class Step(NamedTuple):
    """How fine a picture is."""

    coarse: int  # pixels of the page along the side of one of the picture
    spp: int  # shadow rays for each pixel and light
    adaptive: bool = False  # sixteen sub-pixels at edges, and more rays in penumbrae

    def options(self, time: float) -> RenderOptions:
        """The options of the picture of a time: coarse pictures are smoothed."""
        refined = self.spp if self.adaptive else None
        return RenderOptions(spp=self.spp, time=time, filter=None if self.adaptive else True, adaptive=refined)

    def __str__(self) -> str:
        size = "full size" if self.coarse == 1 else f"1/{self.coarse} of the size"
        return f"{size}, {self.spp} rays a light" + (", edges refined" if self.adaptive else "")


STEPS_OF_PICTURES = Step(8, 1), Step(4, 2), Step(2, 4), Step(1, 4), Step(1, 16), Step(1, 64, True)
"""From the first picture after a move to the last one; each takes two to five times as long as the one before."""

STEPS_OF_WORK = Step(8, 1), Step(4, 1), Step(1, 1)
"""Of pictures of the work of a plan, which counts the rays as they are."""


class TracedPicture(NamedTuple):
    """A picture of the page."""

    image: np.ndarray  # (h, w, 3) uint8 sRGB
    step: Step
    seconds: float
    rays: int
    note: str = ""  # what is shown, if it is no plain picture
    legend: np.ndarray | None = None  # (H, W, 3) uint8 sRGB: the colours and their numbers


def steps_of(model: Model) -> tuple[Step, ...]:
    """The pictures that a page gets, one after the other."""
    return STEPS_OF_WORK if model.looks.show == BOX_TESTS else STEPS_OF_PICTURES


def trace_picture(model: Model, camera: Camera, step: Step, check: Check = lambda *_: None) -> TracedPicture:
    """Trace one picture.

    camera : its size is that of the page in pixels
    check : called about ten times a second

    Raises
    ------
    InputError
        If the plan of the work is unknown, or has no tree.
    """
    start, camera = perf_counter(), scaled_camera(camera, step.coarse)
    if model.looks.show == BOX_TESTS:
        work = box_test_picture(model, camera, [at_quality(lamp.light, step.spp) for lamp in model.shining], step.spp)
        return TracedPicture(work.image, step, perf_counter() - start, work.rays, work.each, work.legend)
    if model.looks.show.startswith(LIGHT_SHARE):
        name = model.looks.show.removeprefix(LIGHT_SHARE)
        frame = _frame(model, camera, [in_full(model.lamp(name).light, step.spp)], step, check)
        image, note = _grey(frame.visibility[0], frame.mask), f"white: all of {name} is seen"
    else:
        frame = _frame(model, camera, [at_quality(lamp.light, step.spp) for lamp in model.shining], step, check)
        model.learn(frame)
        image, note = to_srgb8(frame.image, model.exposure), ""
    return TracedPicture(image, step, perf_counter() - start, frame.rays, note)


def _frame(model: Model, camera: Camera, lights: list[Light], step: Step, check: Check) -> Frame:
    return model.renderer.render(camera, lights, options=step.options(model.time), progress=check)


def at_quality(light: Light, spp: int) -> Light:
    """The light with as many rays as others: a sky of fewer distant lights for coarse pictures."""
    if not isinstance(light, Sky) or not light.interleave:
        return light
    return replace(light, count=min(N_SETS * spp, light.count)).named(light.name)


def in_full(light: Light, spp: int) -> Light:
    """The light such that each pixel tests all of it: a sky of few distant lights."""
    if not isinstance(light, Sky):
        return light
    return replace(light, interleave=False, count=min(N_SETS + 4 * spp, light.count)).named(light.name)


def scaled_camera(camera: Camera, coarse: int) -> Camera:
    """The camera for a picture of the page whose pixels are so many pixels of the page wide, or more."""
    side = max(float(coarse), (camera.width * camera.height / MOST_PIXELS) ** 0.5)
    return camera.resized(*(max(1, round(n / side)) for n in (camera.width, camera.height)))


def _grey(share: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """(h, w, 3) uint8: shares from black to white, where a surface is seen."""
    grey = np.round(255.0 * share).astype(np.uint8)[..., None]
    return np.where(mask[..., None], grey, _UNLIT)


# --- A browser that looks at a page: its camera, and the pictures that it gets, ever finer while the camera rests -----


REST = 0.15
"""Seconds after the last move until the camera rests."""

_QUICK = 4  # most shadow rays of the pictures that come before all other work
_QUALITY = 92  # of JPEG
_LARGEST = 1 << 14  # pixels of a side of a page
_SHOWN = 0.1  # seconds until a browser shows a picture that was sent


class ClientView:
    """What one browser sees.

    Parameters
    ----------
    model : Model
    worker : Worker
    client : the browser, as viser hands it out
    drawn : function of a `Traced`
        Called, in the worker's thread, for each picture that was sent.
    """

    def __init__(self, model: Model, worker: TaskQueue, client: Any, on_sent: Callable[[TracedPicture], None]):
        self.model, self._worker, self._client, self._drawn = model, worker, client, on_sent
        self.name = f"picture {client.client_id}"
        self.pose: Pose | None = None
        self._level = self._changes = 0
        self._standin: Any = None
        self._navigating = False  # the stand-in is seen, and no picture

    async def look(self, camera: Any) -> None:
        """Take over the browser's camera."""
        pose = pose_of(camera)
        if pose is None or (self.pose is not None and same_pose(pose, self.pose)):
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
            picture = trace_picture(self.model, camera, step, check if self._level else lambda *_: None)
            if self.pose is None or (self.pose is not pose and self._standin is not None):
                return
            self._send(picture)
            if self._changes == changes:
                self._level += 1

    def _send(self, picture: TracedPicture) -> None:
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
    _, down, forward = rotation_matrix(wxyz).T
    return Pose(position, position + forward, -down, fov, *size)


def same_pose(a: Pose, b: Pose) -> bool:
    """Whether two poses show the same. Browsers that draw slowly take fewer pixels for the same view."""
    views = zip(a[:4], b[:4])
    return all(np.allclose(x, y, rtol=0.0, atol=1e-6) for x, y in views) and abs(_aspect(a) - _aspect(b)) < 0.01


def _aspect(pose: Pose) -> float:
    return pose.width / pose.height
