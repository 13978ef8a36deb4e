"""Progressive pictures of a page: coarse to fine while the camera rests, traced by one thread with priorities.

A new task replaces a queued one of the same name. Box-test pictures show the work of a plan.
"""

import threading
from collections.abc import Callable, Iterable
from dataclasses import replace
from threading import Timer
from time import monotonic, perf_counter, sleep
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.progress import interrupted_by
from ..base.wording import counted
from ..engine.plan import parse_plan
from ..picture.frame import Frame
from ..picture.frame_request import TimeSample
from ..picture.heat_maps import draw_bar, linear_scale
from ..picture.image_files import screen_picture
from ..picture.render_options import RenderOptions
from ..picture.traversal_steps import explain
from ..scene.camera import Camera
from ..scene.light_lists import N_SETS
from ..scene.lights import Light
from ..scene.sky import Sky
from .viewer_model import BOX_TESTS, LIGHT_SHARE, Model, Pose, rotation_matrix

# --- Priority queue ---------------------------------------------------------------------------------------------------


CLICK, PICTURE, MESH, FINE, NEW_MESH = range(5)
"""Ranks of tasks; lower ranks run first. A proxy mesh in new light comes last, because it keeps the browser busy."""


class Interrupted(Exception):
    """Raised within a task that was replaced, dropped, or preempted by a lower rank."""


class _Task(NamedTuple):
    name: str
    rank: int
    due: float  # seconds of `monotonic`
    work: Callable[[Callable[..., None]], None]


class TaskQueue:
    """A thread that runs tasks by rank. A new task replaces a queued or running one of the same name.

    failed : function of an exception, called in the thread when a task raises one
    """

    def __init__(self, failed: Callable[[Exception], None] = lambda error: None):
        self._tasks: dict[str, _Task] = {}
        self._changed, self._failed = threading.Condition(), failed
        self._running: _Task | None = None
        self._closed = False
        self._thread = threading.Thread(target=self._serve, name="antumbra view", daemon=True)
        self._thread.start()

    def submit(self, name: str, rank: int, work: Callable[[Callable[..., None]], None], after: float = 0.0) -> None:
        """Queue a task, replacing a queued or running task of this name.

        work : function of `check`, which it calls often; a preempted task is restarted later
        after : seconds to wait first
        """
        with self._changed:
            self._tasks[name] = _Task(name, rank, monotonic() + after, work)
            self._changed.notify_all()

    def has(self, name: str) -> bool:
        """Whether a task of this name is queued or running."""
        return name in self._tasks

    def drop(self, name: str) -> None:
        """Remove the task of this name."""
        with self._changed:
            self._tasks.pop(name, None)
            self._changed.notify_all()

    def wait(self, timeout: float = 60.0) -> bool:
        """Wait until the queue is empty; return False on timeout. For tests."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._tasks and self._running is None, timeout)

    def close(self) -> None:
        """End the thread. A running task ends at its next check."""
        with self._changed:
            self._tasks.clear()
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
                    self._changed.wait(self._seconds_to_next())
                if self._closed:
                    return
                task = self._running = self._next()
            assert task is not None
            try:
                task.work(lambda *_, task=task: self._check(task))
            except Interrupted:
                continue
            except Exception as error:
                self._failed(error)
            with self._changed:
                if self._tasks.get(task.name) is task:
                    del self._tasks[task.name]

    def _check(self, task: _Task) -> None:
        with self._changed:
            first = self._next()
            if self._tasks.get(task.name) is not task or (first is not None and first.rank < task.rank):
                raise Interrupted

    def _next(self) -> _Task | None:
        """The due task with the lowest rank; of several, the oldest."""
        now = monotonic()
        return min((task for task in self._tasks.values() if task.due <= now), key=lambda task: task.rank, default=None)

    def _seconds_to_next(self) -> float | None:
        """Seconds until the next task is due; None without tasks."""
        due = min((task.due for task in self._tasks.values()), default=None)
        return None if due is None else max(due - monotonic(), 0.0)


# --- Box-test pictures ------------------------------------------------------------------------------------------------


_WIDTH, _LETTERS = 320, 15  # pixels: width of the legend, height of its letters


class BoxTestPicture(NamedTuple):
    """The box tests of a plan as a picture."""

    image: NDArray[np.uint8]  # (h, w, 3) sRGB; black where there are no rays
    rays: int
    each: str  # box tests per ray, as text
    legend: NDArray[np.uint8]  # (H, W, 3) sRGB: the colours and their numbers


def box_test_picture(model: Model, camera: Camera, lights: list[Light], spp: int) -> BoxTestPicture:
    """Count the box tests of a picture's shadow rays under the page's plan."""
    sample = TimeSample(model.time, camera, lights)
    explanation = explain(model.scene, [sample], [model.display.plan], spp=spp, threads=model.threads)
    (steps,) = explanation.plans
    scale = linear_scale(steps.boxes[explanation.asks])
    each = f"{steps.box_tests / max(explanation.rays, 1):.4g} boxes tested per ray by {steps.plan}"
    legend = draw_bar(scale.bar("boxes tested by the rays of a pixel"), _WIDTH, _LETTERS)
    return BoxTestPicture(scale.colours(steps.boxes, explanation.asks), explanation.rays, each, legend)


# --- Pictures and their steps -----------------------------------------------------------------------------------------


Check = Callable[..., None]
"""Called often during long work, which it ends by raising an exception. Arguments are ignored."""

MOST_PIXELS = 1_600_000
"""Most pixels of a picture. Larger pages show it enlarged."""

_NO_SURFACE = np.array([24, 26, 32], np.uint8)  # colour of pixels without a surface


class Step(NamedTuple):
    """The resolution and samples of a picture."""

    coarse: int  # pixels of the page per pixel of the picture, along a side
    spp: int  # shadow rays per pixel and light
    adaptive: bool = False  # sixteen sub-pixels at edges, and more rays in penumbrae

    def options(self, time: float) -> RenderOptions:
        """The options of the picture at a time; all but adaptive pictures are filtered."""
        refined = self.spp if self.adaptive else None
        return RenderOptions(spp=self.spp, time=time, filter=None if self.adaptive else True, adaptive=refined)

    def __str__(self) -> str:
        size = "full size" if self.coarse == 1 else f"1/{self.coarse} size"
        return f"{size}, {counted(self.spp, 'ray')} per light" + (", edges refined" if self.adaptive else "")


PICTURE_STEPS = Step(8, 1), Step(4, 2), Step(2, 4), Step(1, 4), Step(1, 16), Step(1, 64, True)
"""The pictures after a move; each takes two to five times as long as the one before."""

WORK_STEPS = Step(8, 1), Step(4, 1), Step(1, 1)
"""The box-test pictures, whose rays are neither filtered nor refined."""


class TracedPicture(NamedTuple):
    """A picture of the page."""

    image: NDArray[np.uint8]  # (h, w, 3) sRGB
    step: Step
    seconds: float
    rays: int
    note: str = ""  # description of the content unless it is a plain picture
    legend: NDArray[np.uint8] | None = None  # (H, W, 3) sRGB: the colours and their numbers
    cost: str = ""  # the times of its steps, after a comma, if a device traced it


_STEPS = {"evaluate": "triangles", "build": "tree", "gbuffer": "surfaces", "cull": "culling", "trace": "shadows"}
"""Phase of a frame -> what the panel calls it; the others are `shading`."""


def device_cost(frame: Frame) -> str:
    """The milliseconds of a frame's steps, after a comma, if a device traced it."""
    device = parse_plan(frame.plan).device
    if device is None:
        return ""
    times = {name: frame.timings[phase] for phase, name in _STEPS.items() if frame.timings[phase] > 0.0}
    times["shading"] = frame.timings["total"] - sum(times.values())
    return f", {device}: " + ", ".join(f"{name} {1000 * seconds:.1f}" for name, seconds in times.items()) + " ms"


def steps_of(model: Model) -> tuple[Step, ...]:
    """The sequence of pictures for the page."""
    return WORK_STEPS if model.display.show == BOX_TESTS else PICTURE_STEPS


def trace_picture(model: Model, camera: Camera, step: Step, check: Check = lambda *_: None) -> TracedPicture:
    """Trace one picture.

    camera : with the size of the page in pixels
    check : called about ten times a second while rays are traced, and after each pass

    Raises
    ------
    InputError
        If the plan of a box-test picture is unknown or has no tree.
    """
    start, camera, changes = perf_counter(), scaled_camera(camera, step.coarse), model.light_changes
    if model.display.show == BOX_TESTS:
        work = box_test_picture(
            model, camera, [with_quality(lamp.light, step.spp) for lamp in model.active_lights], step.spp
        )
        return TracedPicture(work.image, step, perf_counter() - start, work.rays, work.each, work.legend)
    if model.display.show.startswith(LIGHT_SHARE):
        name = model.display.show.removeprefix(LIGHT_SHARE)
        frame = _frame(model, camera, [with_all_samples(model.editable_light(name).light, step.spp)], step, check)
        image, note = _grey(frame.visibility[0], frame.mask), f"white: {name} is fully visible"
    else:
        lights = [with_quality(lamp.light, step.spp) for lamp in model.active_lights]
        frame = _frame(model, camera, lights, step, check, model.ground(camera))
        model.update_from(frame, changes)
        exposure = model.exposure
        assert exposure is not None  # set by update_from
        image, note = screen_picture(frame, exposure), ""
    seconds = perf_counter() - start
    return TracedPicture(image, step, seconds, frame.rays, note, cost=device_cost(frame))


def _frame(
    model: Model, camera: Camera, lights: list[Light], step: Step, check: Check, ground: float | bool = False
) -> Frame:
    options = replace(step.options(model.time), ground=ground)
    with interrupted_by(check):
        return model.renderer.render(camera, lights, options=options, progress=check)


def with_quality(light: Light, spp: int) -> Light:
    """The light with as many rays as the others: for coarse pictures, a sky of fewer distant lights."""
    if not isinstance(light, Sky) or not light.interleave:
        return light
    return light.resampled(min(N_SETS * spp, light.count))


def with_all_samples(light: Light, spp: int) -> Light:
    """The light without interleaving, so that each pixel tests all of it: a sky of few distant lights."""
    if not isinstance(light, Sky):
        return light
    return light.resampled(min(N_SETS + 4 * spp, light.count), interleave=False)


def scaled_camera(camera: Camera, coarse: int) -> Camera:
    """The camera for a picture whose pixels are at least `coarse` pixels of the page wide."""
    side = max(float(coarse), (camera.width * camera.height / MOST_PIXELS) ** 0.5)
    return camera.resized(*(max(1, round(n / side)) for n in (camera.width, camera.height)))


def _grey(share: NDArray[np.float32], mask: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """(h, w, 3) uint8: shares from black to white where a surface is visible."""
    grey = np.round(255.0 * share).astype(np.uint8)[..., None]
    return np.where(mask[..., None], grey, _NO_SURFACE)


# --- The view of one browser ------------------------------------------------------------------------------------------


REST_DELAY = 0.15
"""Seconds after the last move until the camera counts as resting."""

DISPLAY_DELAY = 0.1
"""Seconds until a browser shows a picture."""

FIRST_DELAY = 0.3
"""Seconds without work after the coarsest picture; a browser without a GPU needs the cores to draw it."""

_CHECK_PERIOD = 0.01  # seconds between checks while nothing is traced
_QUICK_SPP = 4  # most shadow rays per pixel and light of pictures traced at the rank PICTURE
_QUALITY = 92  # of JPEG
_FARTHEST = 1e9  # page units: largest coordinate of a camera
_MAX_SIDE = 1 << 14  # most pixels along a side of a page

HAZE = np.repeat(np.linspace((150, 178, 214), (226, 229, 233), 64).round().astype(np.uint8)[:, None], 16, axis=1)
"""(h, w, 3) sRGB: what is behind the proxy mesh, and on the page before a still (`page.css`)."""


class ClientView:
    """The camera and pictures of one browser.

    Parameters
    ----------
    model : Model
    worker : TaskQueue
    client : viser's handle of the browser
    on_sent : function of a `TracedPicture`
        Called in the worker's thread for each picture that was sent.
    still : (h, w, 3) uint8
        What the page shows before its first picture.
    """

    def __init__(
        self,
        model: Model,
        worker: TaskQueue,
        client: Any,
        on_sent: Callable[[TracedPicture], None],
        still: NDArray[np.uint8] = HAZE,
    ):
        self.model, self._worker, self._client, self._on_sent = model, worker, client, on_sent
        self.name = f"picture {client.client_id}"
        self.pose: Pose | None = None
        self._home: Pose | None = None  # where the page began to look from
        self._level = self._changes = 0
        self._proxy: Any = None
        self._navigating = False  # whether the proxy mesh is visible instead of a picture
        self.latest: TracedPicture | None = None  # that the browser shows
        pose = pose_of(client.camera)
        self._client.scene.set_background_image(HAZE if pose is None else fitted(still, _aspect(pose)), "png")

    async def look(self, camera: Any) -> None:
        """Update the camera from the browser. A page that changes its shape before the camera moves is fitted again."""
        pose = pose_of(camera)
        if pose is None or (self.pose is not None and same_pose(pose, self.pose)):
            return
        if self._home is not None and same_place(pose, self._home) and not same_pose(pose, self._home):
            self.go_home(camera)
            pose = pose_of(camera) or pose
        self.pose = pose
        self.model.last_camera = self.model.page_frame.camera(pose)
        stand_in = self._proxy is not None and self.latest is not None
        if stand_in and not self._navigating:
            self._navigating = True
            self._proxy.visible = True
            self._client.scene.set_background_image(HAZE, "png")
        self.begin(REST_DELAY if stand_in else 0.0)

    def go_home(self, camera: Any) -> None:
        """Move the browser's camera to the first view, which fits the page."""
        pose = pose_of(camera)
        if pose is not None:
            self._home = first_pose(self.model, pose.width, pose.height)
            place_camera(camera, self._home)

    def begin(self, after: float) -> None:
        """Restart with the coarsest picture after a delay in seconds."""
        self._level, self._changes = 0, self._changes + 1
        self._worker.submit(self.name, PICTURE, self._draw_first, after)

    def leave(self) -> None:
        """Stop: the browser has disconnected."""
        self.pose = None
        self._worker.drop(self.name)

    def put_proxy(self, data: bytes) -> None:
        """Send the proxy mesh, a GLB file, to the browser."""
        self._proxy = self._client.scene.add_glb("/proxy", data, visible=self._navigating)

    def _draw_first(self, check: Check) -> None:
        """Trace the coarsest picture, leave the cores to the browser until it has drawn it, and trace quick ones."""
        self._draw(check, 1)
        drawn = monotonic() + FIRST_DELAY
        while monotonic() < drawn:
            check()
            sleep(_CHECK_PERIOD)
        self._draw(check, sum(step.spp <= _QUICK_SPP for step in steps_of(self.model)), self._draw_fine)

    def _draw_fine(self, check: Check) -> None:
        self._draw(check, len(steps_of(self.model)))

    def _draw(self, check: Check, end: int, after: Callable[[Check], None] | None = None) -> None:
        """Trace the remaining pictures before `end`, then queue what comes after. The coarsest is always completed."""
        steps, changes = steps_of(self.model), self._changes
        while self.pose is not None and self._level < end:
            step, pose = steps[self._level], self.pose
            camera, checked = self.model.page_frame.camera(pose), check if self._level else lambda *_: None
            picture = trace_picture(self.model, camera, step, checked)
            if self.pose is None or (self.pose is not pose and self._proxy is not None):
                return
            checked()  # for a change since the last pass
            self._send(picture)
            if self._changes != changes:
                return  # `begin` has queued the next picture
            self._level += 1
        if after is not None and self._level < len(steps) and self._changes == changes:
            self._worker.submit(self.name, FINE, after)

    def _send(self, picture: TracedPicture) -> None:
        kind = "png" if picture.legend is not None else "jpeg"
        self._client.scene.set_background_image(picture.image, kind, jpeg_quality=_QUALITY)
        self.latest = picture
        if self._navigating:
            self._navigating = False
            later = Timer(DISPLAY_DELAY, self._hide)  # the browser decodes pictures asynchronously
            later.daemon = True
            later.start()
        self._on_sent(picture)

    def _hide(self) -> None:
        if not self._navigating and self._proxy is not None and self.pose is not None:
            self._proxy.visible = False


def pose_of(camera: Any) -> Pose | None:
    """The pose of viser's camera; None if the page has no area yet or the camera is invalid."""
    position, size = np.array(camera.position, np.float64), (int(camera.image_width), int(camera.image_height))
    wxyz, fov = np.array(camera.wxyz, np.float64), float(camera.fov)
    if not (1 <= min(size) <= max(size) <= _MAX_SIDE and position.shape == (3,) and wxyz.shape == (4,)):
        return None
    if not (np.abs(position).max() <= _FARTHEST and abs(np.linalg.norm(wxyz) - 1.0) < 1e-3 and 0.0 < fov < np.pi):
        return None
    _, down, forward = rotation_matrix(wxyz).T
    return Pose(position, position + forward, -down, fov, *size)


def first_pose(model: Model, width: int, height: int) -> Pose:
    """Where a page of this size begins to look from."""
    return model.page_frame.first_pose(model.first_camera(width, height))


def place_camera(camera: Any, pose: Pose) -> None:
    """Move a camera of viser."""
    camera.position, camera.look_at, camera.fov = pose.position, pose.target, pose.vfov


def same_place(a: Pose, b: Pose) -> bool:
    """Whether two poses have one position and one direction."""
    views = ((a.position, b.position), (_forward(a), _forward(b)))
    return all(np.allclose(x, y, rtol=0.0, atol=1e-4) for x, y in views)


def _forward(pose: Pose) -> NDArray[np.float64]:
    forward = pose.target - pose.position
    unit: NDArray[np.float64] = forward / np.linalg.norm(forward)
    return unit


def same_pose(a: Pose, b: Pose) -> bool:
    """Whether two poses show the same view. Slow browsers use fewer pixels for it."""
    views: Iterable[tuple[Any, Any]] = zip(a[:4], b[:4])
    return all(np.allclose(x, y, rtol=0.0, atol=1e-6) for x, y in views) and abs(_aspect(a) - _aspect(b)) < 0.01


def fitted(picture: NDArray[np.uint8], aspect: float) -> NDArray[np.uint8]:
    """A picture of this ratio of width to height: cropped, or, for upright pages, continued above and below."""
    height, width = picture.shape[:2]
    if aspect < 1.0:
        more = min(round(width / aspect), 8 * height) - height
        return np.pad(picture, ((max(more, 0) // 2, (max(more, 0) + 1) // 2), (0, 0), (0, 0)), "edge")
    rows, columns = max(1, min(height, round(width / aspect))), min(width, round(height * aspect))
    top, left = (height - rows) // 2, (width - columns) // 2
    return picture[top : top + rows, left : left + columns]


def _aspect(pose: Pose) -> float:
    return pose.width / pose.height
