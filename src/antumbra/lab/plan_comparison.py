"""Compare plans on the same frame: timings, counters, tests per ray, and whether all plans give the same bits.

Each plan renders one frame with counters, one untimed frame, and then one frame per round, in which the plans take
turns. Each frame has a new `Renderer`, so nothing is cached between frames.
"""

from collections.abc import Sequence
from statistics import median
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.checks import whole_number
from ..base.errors import InputError
from ..base.option_fields import field_values
from ..base.progress import ProgressListener
from ..engine.plan import Plan, parse_plan
from ..engine.scene import AnyScene
from ..kernels.parallel import thread_count
from ..picture.frame import Frame
from ..picture.frame_request import PictureQueries, TimeSample, build_for, picture_queries
from ..picture.render_options import EngineOptions, RenderOptions
from ..picture.renderer import Renderer
from ..picture.traversal_steps import WINDOW, trace_windows
from ..query.receivers import NOTHING
from ..scene.lights import check_lights

PLAIN, BY_RASTER = RenderOptions(antialias=False), EngineOptions(gbuffer="raster")
"""Default options of a comparison."""

_UNTIMED = 3  # steps of each plan besides the rounds: counters, warm-up, windows


class Difference(NamedTuple):
    """The difference between the frames of two plans."""

    bits: int  # bits of shadow rays that differ
    pixels: int  # pixels in which a bit or the colour differs
    first: tuple[int, int] | None  # (x, y) of the first such pixel; None: no difference


class PlanMeasurement(NamedTuple):
    """The measurements of one plan."""

    plan: Plan
    seconds: list[dict[str, float]]  # per round: seconds of each phase in `frame.PHASES`, and "total"
    rays: int  # shadow rays of a frame
    counters: dict[str, int]  # sums over the shadow rays of a frame
    paging: dict[str, int] | None  # stores only: chunks read and evicted in a frame, see `store.chunk_residency.Paging`
    windows: NDArray[np.float64] | None  # (rows, columns): tests per ray, NaN without rays; None: see `_tests_per_ray`
    difference: Difference  # to the reference

    @property
    def medians(self) -> dict[str, float]:
        """Median seconds over the rounds, of each phase and "total"."""
        return {phase: median(one[phase] for one in self.seconds) for phase in self.seconds[0]}

    @property
    def rays_per_second(self) -> float | None:
        """Shadow rays per second of the phase "trace"; None without rays."""
        seconds = self.medians["trace"]
        return self.rays / seconds if self.rays and seconds > 0.0 else None

    @property
    def tests_per_ray(self) -> float | None:
        """Box and triangle tests per shadow ray; None without rays."""
        tests = self.counters["box_tests"] + self.counters["triangle_tests"]
        return tests / self.counters["rays"] if self.counters["rays"] else None


class Comparison(NamedTuple):
    """The measurements of several plans."""

    frame: Frame  # of the reference
    reference: Plan  # the first exact plan, or else the first plan
    asks: NDArray[np.bool_]  # (H, W) bool: pixels with shadow rays
    plans: list[PlanMeasurement]

    @property
    def wrong(self) -> list[PlanMeasurement]:
        """Exact plans whose bits or colours differ from the reference. Any such plan is a bug."""
        return [one for one in self.plans if one.plan.tracer.exact and one.difference.pixels]

    @property
    def fastest(self) -> PlanMeasurement:
        """The plan with the smallest median total."""
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
    scene: AnyScene,
    moment: TimeSample,
    plans: Sequence[str | Plan],
    options: RenderOptions = PLAIN,
    engine: EngineOptions = BY_RASTER,
    *,
    rounds: int = 5,
    say: ProgressListener | None = None,
) -> Comparison:
    """Measure several plans on the same frame.

    Parameters
    ----------
    scene : Scene or PagedScene
    moment : TimeSample
    plans : list of str or Plan, two or more
    options : RenderOptions
        Options of the picture; the time is that of `moment`. By default edges are not smoothed, so that a pixel that
        differs affects no other pixel.
    engine : EngineOptions
        Its plan is ignored.
    rounds : int
        Timed frames of each plan, 1 to 1000.
    say : function of (current step, steps done, total steps), optional

    Raises
    ------
    InputError
        If a value is out of range, or a plan is unknown, named twice, or unable to render the scene.
    """
    parsed = compared_plans(plans)
    whole_number(rounds, "rounds", 1, 1000)
    work = _ComparedFrame(scene, moment._replace(lights=check_lights(moment.lights, scene.up)), options, engine)
    for plan in parsed:
        work.renderer(plan)  # rejects a plan before any plan is measured
    steps = _Steps(say, len(parsed) * (_UNTIMED + rounds))
    counted = [_count_frame(work, plan, steps) for plan in parsed]
    reference = next((plan for plan in parsed if plan.tracer.exact), parsed[0])
    frame, differences = _difference_frames(work, parsed, reference, steps)
    seconds: list[list[dict[str, float]]] = [[] for _ in parsed]
    for i in range(rounds):
        for plan, timings in zip(parsed, seconds):
            steps.next(f"round {i + 1} of {rounds}: {plan}")
            timings.append(work.draw(plan).timings)
    rays, windows = _windows(work, parsed, steps)
    measurements = [
        PlanMeasurement(plan, timings, *counts, tests, difference)
        for plan, timings, counts, tests, difference in zip(parsed, seconds, counted, windows, differences)
    ]
    return Comparison(frame, reference, rays > 0, measurements)


def windows_to_pixels(windows: NDArray[np.float64], has_rays: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(H, W) float64: the value of each pixel's window, or 0 where `has_rays` is False."""
    rows, columns = (np.arange(n) // WINDOW for n in has_rays.shape)
    return np.where(has_rays, windows[rows[:, None], columns], 0.0)


def compared_plans(plans: Sequence[str | Plan]) -> list[Plan]:
    """Parse the plans; InputError if one is unknown or named twice, or if there is only one."""
    parsed = [parse_plan(plan) for plan in plans]
    if len(parsed) < 2:
        raise InputError("a comparison needs two plans or more, such as --plan bsah+single --plan bsah+multifrusta")
    for i, plan in enumerate(parsed):
        if plan in parsed[:i]:
            raise InputError(f"plan {str(plan)!r} is named twice; leave one of them out")
    return parsed


class _Steps:
    """Reports the steps of a comparison."""

    def __init__(self, say: ProgressListener | None, total: int) -> None:
        self._say, self._done, self._total = say, 0, total

    def next(self, text: str) -> None:
        """Report the next step."""
        if self._say is not None:
            self._say(text, self._done, self._total)
        self._done += 1


def _count_frame(work: _ComparedFrame, plan: Plan, steps: _Steps) -> tuple[int, dict[str, int], dict[str, int] | None]:
    """Render a frame with counters: its rays, its counters, and its chunks read and evicted."""
    steps.next(f"counting: {plan}")
    frame = work.draw(plan, counters=True)
    assert frame.counters is not None
    return frame.rays, frame.counters, frame.paging


def _difference_frames(
    work: _ComparedFrame, plans: list[Plan], reference: Plan, steps: _Steps
) -> tuple[Frame, list[Difference]]:
    """Render an untimed frame by each plan, which loads its kernels: the reference's frame, and all differences."""
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
    """Count the bits in which two frames differ, and the pixels that differ in bits or colour."""
    differs = (first.image != other.image).any(axis=-1)
    bits = 0
    for a, b in zip(first.bits, other.bits, strict=True):
        if not np.array_equal(a, b):
            bits += int(np.bitwise_count(a ^ b).sum())
            differs |= (a != b).any(axis=-1)
    ys, xs = np.nonzero(differs)
    return Difference(bits, len(xs), (int(xs[0]), int(ys[0])) if len(xs) else None)


def _windows(work: _ComparedFrame, plans: list[Plan], steps: _Steps) -> tuple[np.ndarray, list[np.ndarray | None]]:
    """(H, W) int64, the shadow rays of each pixel; and the tests per ray of each plan, see `_tests_per_ray`."""
    picture, tests = _picture(work, plans[0]), []
    rays = np.sum([(q.sides != NOTHING) * np.int64(q.samples.shape[1]) for q in picture.queries], axis=0)
    of_store = picture.source is not None
    for i, plan in enumerate(plans):
        steps.next(f"mapping tests: {plan}")
        if i and of_store:  # the tracer of a store depends on the plan
            del picture  # frees its chunks for those of the next picture
            picture = _picture(work, plan)
        tests.append(_tests_per_ray(work, plan, picture, rays))
    return rays, tests


def _picture(work: _ComparedFrame, plan: Plan) -> PictureQueries:
    return picture_queries(work.scene, work.moment, work.options, thread_count(work.engine.threads), plan)


def _tests_per_ray(
    work: _ComparedFrame, plan: Plan, picture: PictureQueries, rays: NDArray[np.int64]
) -> NDArray[np.float64] | None:
    """(rows, columns) float64: the tests per ray of each window. None if the plan names no builder.

    Such a plan builds a hierarchy over all rays, or chooses its methods by all rays, and would behave differently in
    single windows.
    """
    if plan.build is None:
        return None
    accelerator = work.renderer(plan).accelerator
    accelerated = build_for(accelerator, picture) if picture.source is None else picture.source.accelerated
    tests = np.sum(
        [trace_windows(accelerator, accelerated, query)[1].sum(axis=-1) for query in picture.queries], axis=0
    )
    return _divide_by_rays(tests, rays)


def _divide_by_rays(tests: NDArray[np.int64], rays: NDArray[np.int64]) -> NDArray[np.float64]:
    """(rows, columns) float64: the tests of each window divided by its rays; NaN without rays."""
    rows, columns = (np.arange(n) // WINDOW for n in rays.shape)
    window = rows[:, None] * tests.shape[1] + columns
    n = np.bincount(window.ravel(), rays.ravel(), tests.size).reshape(tests.shape)
    return np.where(n > 0, tests / np.maximum(n, 1), np.nan)
