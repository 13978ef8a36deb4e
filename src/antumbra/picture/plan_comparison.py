"""Compare plans on the same frame: seconds, counters, tests per ray, and whether all plans give the same bits.

Each plan renders one frame with counters, one untimed frame, and then one frame per round; within a round the plans
take turns. Each frame has a new `Renderer`, so nothing is cached between frames.
"""

from collections.abc import Callable, Sequence
from statistics import median
from typing import NamedTuple

import numpy as np

from ..checks import whole_number
from ..engine.plan import Plan, parse_plan
from ..engine.scene import AnyScene
from ..errors import InputError
from ..kernels.parallel import thread_count
from ..query.receivers import NOTHING
from ..scene.lights import check_lights
from .frame import Frame
from .frame_request import PictureQueries, TimeSample, build_for, picture_queries
from .option_fields import field_values
from .render_options import EngineOptions, RenderOptions
from .renderer import Renderer
from .traversal_steps import WINDOW, trace_windows

Say = Callable[[str, int, int], object]
"""Function of (what is done, steps done, all steps)."""

PLAIN, BY_RASTER = RenderOptions(antialias=False), EngineOptions(gbuffer="raster")
"""The usual options of a comparison."""

_UNTIMED = 3  # steps of each plan that are not rounds: counters, warm-up, windows


class Difference(NamedTuple):
    """How the frame of one plan differs from the frame of another plan."""

    bits: int  # bits of shadow rays that differ
    pixels: int  # pixels in which a bit or the colour differs
    first: tuple[int, int] | None  # (x, y) of the first of these pixels; None: there is none


class PlanMeasurement(NamedTuple):
    """The measurements of one plan."""

    plan: Plan
    seconds: list[dict[str, float]]  # of each round: seconds of each phase in `frame.PHASES`, and "total"
    rays: int  # shadow rays of a frame
    counters: dict[str, int]  # sums over the shadow rays of a frame
    paging: dict[str, int] | None  # stores only: chunks read and evicted in a frame, see `store.chunk_residency.Paging`
    windows: np.ndarray | None  # (rows, columns) float64: tests per ray, NaN without rays; None: see `_tests_of`
    difference: Difference  # from the reference

    @property
    def medians(self) -> dict[str, float]:
        """Seconds of each phase, and "total": the median over the rounds."""
        return {phase: median(one[phase] for one in self.seconds) for phase in self.seconds[0]}

    @property
    def rays_per_second(self) -> float | None:
        """Shadow rays per second of the phase "trace"; None: there are no rays."""
        seconds = self.medians["trace"]
        return self.rays / seconds if self.rays and seconds > 0.0 else None

    @property
    def tests_per_ray(self) -> float | None:
        """Tests of boxes and triangles per shadow ray; None: there are no rays."""
        tests = self.counters["box_tests"] + self.counters["triangle_tests"]
        return tests / self.counters["rays"] if self.counters["rays"] else None


class Comparison(NamedTuple):
    """The measurements of several plans."""

    frame: Frame  # of the reference
    reference: Plan  # the first exact plan; if there is none, the first plan
    asks: np.ndarray  # (H, W) bool: pixels with shadow rays
    plans: list[PlanMeasurement]

    @property
    def wrong(self) -> list[PlanMeasurement]:
        """Exact plans whose bits or colours differ from the reference. There are none, or there is a bug."""
        return [one for one in self.plans if one.plan.tracer.exact and one.difference.pixels]

    @property
    def fastest(self) -> PlanMeasurement:
        """The plan with the least median total."""
        return min(self.plans, key=lambda one: one.medians["total"])


class _ComparedFrame(NamedTuple):
    """The frame that all plans render."""

    scene: AnyScene
    moment: TimeSample
    options: RenderOptions
    engine: EngineOptions  # without the plan

    def renderer(self, plan: Plan) -> Renderer:
        return Renderer(self.scene, **field_values(self.engine) | {"plan": plan})

    def draw(self, plan: Plan, counters: bool = False) -> Frame:
        time, camera, lights = self.moment
        return self.renderer(plan).render(camera, lights, options=self.options, time=time, counters=counters)


def compare(
    scene: AnyScene, moment: TimeSample, plans: Sequence[str | Plan], options: RenderOptions = PLAIN,
    engine: EngineOptions = BY_RASTER, *, rounds: int = 5, say: Say | None = None,
) -> Comparison:  # fmt: skip
    """Measure several plans on the same frame.

    Parameters
    ----------
    scene : Scene or PagedScene
    moment : Moment
    plans : list of str or Plan, two or more
    options : RenderOptions
        Those of the picture, without its time. By default edges are not smoothed: a pixel that differs shows in no
        other pixel then.
    engine : EngineOptions
        Its plan is left out.
    rounds : int
        Timed frames of each plan, 1 to 1000.
    say : function of (what is done, steps done, all steps), optional

    Raises
    ------
    InputError
        If a value is out of range, or a plan is unknown, named twice, or unable to render the scene.
    """
    plans = compared_plans(plans)
    whole_number(rounds, "rounds", 1, 1000)
    work = _ComparedFrame(scene, moment._replace(lights=check_lights(moment.lights, scene.up)), options, engine)
    for plan in plans:
        work.renderer(plan)  # refuses a plan before the others are measured
    steps = _Steps(say, len(plans) * (_UNTIMED + rounds))
    counted = [_count_frame(work, plan, steps) for plan in plans]
    reference = next((plan for plan in plans if plan.tracer.exact), plans[0])
    frame, differences = _difference_frames(work, plans, reference, steps)
    seconds: list[list[dict[str, float]]] = [[] for _ in plans]
    for i in range(rounds):
        for plan, measurements in zip(plans, seconds):
            steps.next(f"round {i + 1} of {rounds}: {plan}")
            measurements.append(work.draw(plan).timings)
    rays, windows = _windows(work, plans, steps)
    measurements = [
        PlanMeasurement(plan, one, *of_frame, tests, difference)
        for plan, one, of_frame, tests, difference in zip(plans, seconds, counted, windows, differences)
    ]
    return Comparison(frame, reference, rays > 0, measurements)


def windows_to_pixels(windows: np.ndarray, asks: np.ndarray) -> np.ndarray:
    """(H, W) float64: the number of each pixel's window, or 0 where `asks` is False."""
    rows, columns = (np.arange(n) // WINDOW for n in asks.shape)
    return np.where(asks, windows[rows[:, None], columns], 0.0)


def compared_plans(plans: Sequence[str | Plan]) -> list[Plan]:
    """Parse the plans; InputError if one is unknown or named twice, or if there is only one."""
    parsed = [parse_plan(plan) for plan in plans]
    if len(parsed) < 2:
        raise InputError("a comparison wants two plans or more, such as --plan bsah+single --plan bsah+multifrusta")
    for i, plan in enumerate(parsed):
        if plan in parsed[:i]:
            raise InputError(f"plan {str(plan)!r} is named twice; leave one of them out")
    return parsed


class _Steps:
    """Tells the steps of a comparison."""

    def __init__(self, tell: Say | None, total: int):
        self._tell, self._done, self._total = tell, 0, total

    def say(self, text: str) -> None:
        if self._tell is not None:
            self._tell(text, self._done, self._total)

    def next(self, text: str) -> None:
        """Tell the step that begins."""
        self.say(text)
        self._done += 1


def _count_frame(work: _ComparedFrame, plan: Plan, steps: _Steps) -> tuple[int, dict[str, int], dict[str, int] | None]:
    """The rays of a frame, its counters, and its chunks read and evicted."""
    steps.next(f"counting: {plan}")
    frame = work.draw(plan, counters=True)
    assert frame.counters is not None
    return frame.rays, frame.counters, frame.paging


def _difference_frames(
    work: _ComparedFrame, plans: list[Plan], reference: Plan, steps: _Steps
) -> tuple[Frame, list[Difference]]:
    """Render a frame by each plan, so that its kernels are loaded: the reference's frame, and all differences."""
    steps.next(f"warming up: {reference}")
    first = work.draw(reference)
    differences = []
    for plan in plans:
        if plan == reference:
            differences.append(difference(first, first))
        else:
            steps.next(f"warming up: {plan}")
            differences.append(difference(first, work.draw(plan)))
    return first, differences


def difference(first: Frame, other: Frame) -> Difference:
    """The bits of two frames that differ, and the pixels in which bits or colours do."""
    differs = (first.image != other.image).any(axis=-1)
    bits = 0
    for a, b in zip(first.bits, other.bits, strict=True):
        if not np.array_equal(a, b):
            bits += int(np.bitwise_count(a ^ b).sum())
            differs |= (a != b).any(axis=-1)
    ys, xs = np.nonzero(differs)
    return Difference(bits, len(xs), (int(xs[0]), int(ys[0])) if len(xs) else None)


def _windows(work: _ComparedFrame, plans: list[Plan], steps: _Steps) -> tuple[np.ndarray, list[np.ndarray | None]]:
    """(H, W) int64, the shadow rays of each pixel; and for each plan its tests per ray, see `_tests_of`."""
    picture, tests = _picture(work, plans[0]), []
    rays = np.sum([(q.sides != NOTHING) * np.int64(q.samples.shape[1]) for q in picture.queries], axis=0)
    of_store = picture.source is not None
    for i, plan in enumerate(plans):
        steps.next(f"mapping tests: {plan}")
        if i and of_store:  # the tracer of a store belongs to a plan
            del picture  # its chunks make room for those of the next one
            picture = _picture(work, plan)
        tests.append(_tests_of(work, plan, picture, rays))
    return rays, tests


def _picture(work: _ComparedFrame, plan: Plan) -> PictureQueries:
    return picture_queries(work.scene, work.moment, work.options, thread_count(work.engine.threads), plan)


def _tests_of(work: _ComparedFrame, plan: Plan, picture: PictureQueries, rays: np.ndarray) -> np.ndarray | None:
    """(rows, columns) float64: the tests per ray of each window. None if the plan names no builder.

    Such a plan makes a hierarchy of all rays, or chooses its methods by all rays. In single windows it would do other
    things.
    """
    if plan.build is None:
        return None
    maker = work.renderer(plan).accelerator
    ready = build_for(maker, picture) if picture.source is None else picture.source.accelerated
    tests = np.sum([trace_windows(maker, ready, query)[1].sum(axis=-1) for query in picture.queries], axis=0)
    return _per_ray(tests, rays)


def _per_ray(tests: np.ndarray, rays: np.ndarray) -> np.ndarray:
    """(rows, columns) float64: the tests of each window divided by its rays; NaN without rays."""
    rows, columns = (np.arange(n) // WINDOW for n in rays.shape)
    window = rows[:, None] * tests.shape[1] + columns
    n = np.bincount(window.ravel(), rays.ravel(), tests.size).reshape(tests.shape)
    return np.where(n > 0, tests / np.maximum(n, 1), np.nan)
