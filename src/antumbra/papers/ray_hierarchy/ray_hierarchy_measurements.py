"""Measures Figures 6 and 7 and Table 2 of the report on ray hierarchies [Olsson and Assarsson 2011].

The views are frames of BART's robots, its museum from four viewpoints, and static scenes, each with one point light.
The report follows BART's own camera through the robots' city; here the camera is static, because the scene folder has
no camera path.

Each variant builds cones from the shadow rays of a picture, one per pixel, and traces the triangles through them. Times
are of the phase `trace` of a frame, which includes building the cones. Variants alternate within each round, and the
median of the rounds counts. Smaller pictures predict the time of a variant, which is skipped if it would take too long.

The published results were measured on a GPU (Sec. 5, Tables 1 and 2).
"""

from collections.abc import Iterable, Mapping
from statistics import fmean, median, pstdev
from typing import NamedTuple

import numpy as np

from ...engine.scene import AnyScene
from ...errors import InputError
from ...picture.frame import Frame
from ...picture.renderer import Renderer
from ...scene.camera import Camera
from ...scene.lights import Light, PointLight
from ..bench_runner import Say, interleave
from ..benchmark_views import BenchmarkScenes, BenchmarkView, digest, point
from .cone_hierarchy import with_culling

# --- Published results ------------------------------------------------------------------------------------------------


VARIANTS = ("Spheres", "SpheresSorted", "Precise", "PreciseSorted", "PreciseSEA", "PreciseEATP", "PreciseSEATP")
"""Table 1: sphere tests or precise tests; rays in image order or sorted (S); early accept (EA); two passes (TP)."""

MEASURED = VARIANTS[:4]
"""The variants of Figure 6 and Table 2. Figure 7 compares the others with PreciseSorted."""

FIGURE7 = VARIANTS[3:]
"""The variants of Figure 7: fewer nodes, but more time."""

NODES = {
    "Spheres": (19.89e6, 317.91e6, 5.77e6, 2199.22e6),
    "SpheresSorted": (2.66e6, 6.79e6, 5.40e6, 6.60e6),
    "Precise": (17.58e6, 292.84e6, 2.25e6, 2163.30e6),
    "PreciseSorted": (0.82e6, 2.24e6, 2.20e6, 1.97e6),
}
"""Table 2: visited cones in four views of the museum. The third has the most screen coherence, the last the least."""

MILLISECONDS = {
    "Spheres": (29.40, 446.10, 10.53, 3771.55),
    "SpheresSorted": (11.90, 16.75, 15.05, 16.69),
    "Precise": (38.50, 557.91, 8.26, 4172.61),
    "PreciseSorted": (10.65, 13.40, 12.63, 12.60),
}
"""Table 2: shadow times in the same views, in milliseconds."""


def published_cut(unsorted: str, sorted_: str, table: Mapping[str, tuple[float, ...]] = NODES) -> float:
    """The ratio of a table's values without and with sorting, in the view where sorting helps most.

    The report's text says "up to three orders of magnitude fewer nodes" and "over two orders of magnitude faster".
    """
    return max(a / b for a, b in zip(table[unsorted], table[sorted_]))


# --- Views ------------------------------------------------------------------------------------------------------------


ROBOTS, MUSEUM = "bart_robots", "bart_museum8_subdivided"
SCENES = BenchmarkScenes(
    real=(ROBOTS, MUSEUM, "sponza_crytek", "synthetic_garden_foxes"),
    beside_real=(),
    without_real=("atrium", "forest"),
    make_light=point,
    moving=(ROBOTS, MUSEUM),
)

MUSEUM_NAME = "subdivided museum"
"""The report uses BART's museum at its finest tessellation; this is a coarse one with subdivided triangles."""

STILL_CAMERA = "The robots have a static camera, because their folder has no camera path"

_MUSEUM = {
    "hall": (1.0, None),
    "before the cloud": (2.0, ((-0.9, 2.6, 1.0), (0.5, 2.4, -0.6), 70.0)),
    "wall": (1.0, ((1.8, 1.8, 1.2), (5.0, 1.6, -0.8), 60.0)),
    "in the cloud": (1.75, ((-0.6, 2.7, 0.6), (0.5, 2.4, -0.6), 75.0)),
}
"""Viewpoint -> (seconds, (position, target, vfov) of the camera, or None: from info.json), in the order of Table 2. The
first and third show large surfaces; the others show the far wall behind hundreds of small floating triangles."""


class PictureCase(NamedTuple):
    """A scene at one time."""

    name: str
    of: str  # name of the scene
    frame: int | None  # frame number in an animation; None: static scene, or a different camera in each picture
    scene: AnyScene
    camera: Camera
    light: Light
    time: float  # seconds


def with_point(view: BenchmarkView) -> BenchmarkView:
    """The view with a single point light, at the centre of its first light."""
    light, bounds = view.lights[0], view.scene.bounds
    patch = light.patch(view.scene.origin, float(np.linalg.norm(bounds[1] - bounds[0])))
    middle = patch.base + (patch.u + patch.v) / 2 if light.domain == "square" else patch.base
    return view._replace(lights=[PointLight(view.scene.origin + middle)])


def times_of(scene: AnyScene, frames: int) -> list[float]:
    """`frames` times, evenly spaced over the animation; 0 alone for a static scene."""
    return np.linspace(0.0, scene.duration, frames).tolist() if scene.animated else [0.0]


def pictures(view: BenchmarkView, frames: int) -> list[PictureCase]:
    """The pictures of a view: the museum from four viewpoints, `frames` frames of another animation, or one picture."""
    name, scene, camera, (light, *_) = view
    if name == MUSEUM:
        return [
            PictureCase(f"{MUSEUM_NAME}, {place}", name, None, scene, _placed(camera, where), light, time)
            for place, (time, where) in _MUSEUM.items()
        ]
    if not scene.animated:
        return [PictureCase(name, name, None, scene, camera, light, 0.0)]
    times = times_of(scene, frames)
    return [PictureCase(f"{name}, {t:.2f} s", name, k, scene, camera, light, t) for k, t in enumerate(times)]


_Viewpoint = tuple[tuple[float, float, float], tuple[float, float, float], float]


def _placed(camera: Camera, where: _Viewpoint | None) -> Camera:
    if where is None:
        return camera
    position, target, vfov = where
    return Camera(position, target, camera.up, vfov, camera.width, camera.height)


# --- Measurements -----------------------------------------------------------------------------------------------------


OURS, BEST = "cones", "PreciseSorted"
PLANS = {OURS: "cones", **{name: f"cones:{name}" for name in VARIANTS}}
"""Variant -> plan: our variant, then those of Table 1."""

CULLING_PLANS = {OURS: "cones", **{name: with_culling(name) for name in VARIANTS}}
"""The same with face culling: all drop culled faces before the traversal."""

REFERENCE = "lbvh+single"
"""All variants must return the bits of this plan."""

SHRINK = (8, 4)
"""Divisors of the width and height for the smaller pictures, which are traced first. The prediction assumes that each
doubling multiplies nodes and seconds by the same factor as between these two, but by no more than the rays."""


class PictureRays(NamedTuple):
    """The shadow rays of a picture."""

    picture: str
    of: str  # name of the scene
    frame: int | None  # number within its animation
    triangles: int
    rays: int
    blocked: int
    bits: bytes  # digest of the answer of REFERENCE


class Cost(NamedTuple):
    """The cost of one variant in one picture; None if it was skipped because it would have taken too long."""

    picture: str
    variant: str  # a key of PLANS
    predicted: float  # seconds, predicted from smaller pictures
    predicted_nodes: float
    nodes: int | None = None  # tested pairs of a triangle and a cone
    tests: int | None = None  # ray tests of up to 16 rays
    seconds: float | None = None  # time of the phase `trace`
    bits: bytes | None = None  # digest of the answer
    passed: int | None = None  # tested pairs with a possible intersection


class RelativeCost(NamedTuple):
    """A variant's nodes and time relative to BEST, as medians over the pictures of a scene."""

    of: str
    variant: str
    pictures: int
    nodes: float
    passed: float
    seconds: float


class Spread(NamedTuple):
    """The variation of the times of one variant over the frames of an animation."""

    of: str
    variant: str
    frames: int  # measured frames
    missing: int  # skipped frames
    median: float
    ratio: float  # longest / shortest
    quartiles: float  # third quartile - first quartile
    deviation: float  # standard deviation / mean


class Effort(NamedTuple):
    """How much to measure."""

    threads: int
    rounds: int
    limit: float  # maximum seconds per variant and picture
    cull_faces: str | None = None  # triangle side, as seen from the receiver, that does not block; published: "back"


def measure(picture: PictureCase, effort: Effort, say: Say) -> tuple[PictureRays, list[Cost]]:
    """Measure all variants in one picture; InputError if its camera sees nothing."""
    plans = PLANS if effort.cull_faces is None else CULLING_PLANS
    renderers = {name: Renderer(picture.scene, plan, effort.threads) for name, plan in plans.items()}

    def trace(name: str, renderer: Renderer, shrink: int = 1, counters: bool = False) -> Frame:
        camera = picture.camera.resized(*(max(n // shrink, 1) for n in (picture.camera.width, picture.camera.height)))
        say(f"{picture.name}, {name}, {camera.width} x {camera.height}")
        return renderer.render(
            camera, [picture.light], spp=1, time=picture.time, counters=counters, cull_faces=effort.cull_faces
        )

    frame = trace(REFERENCE, Renderer(picture.scene, REFERENCE, effort.threads))
    if not frame.rays:
        raise InputError(f"{picture.name}: the camera sees nothing; choose a scene whose camera sees something")
    predicted = {n: _predicted(*(trace(n, r, part, True) for part in SHRINK)) for n, r in renderers.items()}
    counted = {n: trace(n, r, counters=True) for n, r in renderers.items() if predicted[n][0] <= effort.limit}

    def seconds(name: str, turn: int) -> float | None:
        if turn and (turn + 1) * counted[name].timings["trace"] > effort.limit:  # slow variants run once
            return None
        return trace(name, renderers[name]).timings["trace"]

    laps = interleave(counted, effort.rounds, seconds)
    costs = []
    for name in PLANS:
        cost = Cost(picture.name, name, *predicted[name])
        if name in counted:
            nodes, passed, tests = _counts(counted[name])
            cost = cost._replace(nodes=nodes, passed=passed, tests=tests)
            cost = cost._replace(seconds=median(laps[name]), bits=digest(counted[name].bits))
        costs.append(cost)
    return _picture_rays(picture, frame), costs


def _counts(frame: Frame) -> tuple[int, int, int]:
    """(nodes, passed, tests) from a frame's counters."""
    assert frame.counters is not None
    return frame.counters["nodes"], frame.counters["candidates"], frame.counters["triangle_tests"]


def _predicted(smallest: Frame, small: Frame) -> tuple[float, float]:
    """Predict (seconds, nodes) of the full picture from two smaller ones."""
    nodes = _counts(small)[0]
    doublings = np.log2(SHRINK[1]) / np.log2(SHRINK[0] / SHRINK[1])
    growth = min((nodes / max(_counts(smallest)[0], 1)) ** doublings, SHRINK[1] ** 2)
    return float(growth * small.timings["trace"]), float(growth * nodes)


def _picture_rays(picture: PictureCase, frame: Frame) -> PictureRays:
    blocked = int(np.bitwise_count(frame.bits[0]).sum())
    fields = picture.name, picture.of, picture.frame, picture.scene.n_triangles
    return PictureRays(*fields, frame.rays, blocked, digest(frame.bits))


def answers(pictures: Iterable[PictureRays], costs: Iterable[Cost]) -> list[tuple[str, bytes]]:
    """(picture, digest) of all answers, for `papers.benchmark_views.agree`."""
    return [(s.picture, s.bits) for s in pictures] + [(c.picture, c.bits) for c in costs if c.bits is not None]


def of(costs: Iterable[Cost], picture: str, variant: str) -> Cost:
    """The cost of a variant in a picture."""
    return next(c for c in costs if (c.picture, c.variant) == (picture, variant))


def fewest(costs: Iterable[Cost], picture: str, among: Iterable[str]) -> str:
    """The first variant that visits the fewest nodes; "" if all were skipped."""
    costs = list(costs)
    measured = [c for c in (of(costs, picture, variant) for variant in among) if c.nodes is not None]
    return min(measured, key=lambda c: c.nodes or 0).variant if measured else ""


def cut(
    costs: Iterable[Cost], unsorted: str, sorted_: str, fields: tuple[str, str] = ("nodes", "predicted_nodes")
) -> tuple[float, str, bool]:
    """The largest reduction of nodes, or of another field, by sorting, as (ratio, picture, measured).

    `measured` is False if the unsorted variant was skipped and its value is predicted. The result is (nan, "", False)
    if the sorted variant visited no nodes.

    fields : names of the measured and the predicted field
    """
    costs, cuts, (field, predicted) = list(costs), [], fields
    for a in (c for c in costs if c.variant == unsorted):
        b = getattr(of(costs, a.picture, sorted_), field)
        if b:
            value = getattr(a, predicted if a.nodes is None else field)
            cuts.append((value / b, a.picture, a.nodes is not None))
    return max(cuts, default=(np.nan, "", False))


def relative_costs(
    pictures: Iterable[PictureRays], costs: Iterable[Cost], variants: Iterable[str]
) -> list[RelativeCost]:
    """The variants of Figure 7 relative to BEST, for each scene, over the pictures where both were measured."""
    pictures, costs, rows = list(pictures), list(costs), []
    for name in dict.fromkeys(s.of for s in pictures):
        names = [s.picture for s in pictures if s.of == name]
        for variant in variants:
            pairs = [(of(costs, p, variant), of(costs, p, BEST)) for p in names]
            both = [(a, b) for a, b in pairs if a.nodes and b.nodes]
            if both:
                ratios = [
                    median(getattr(a, f) / max(getattr(b, f), 1e-9) for a, b in both)
                    for f in ("nodes", "passed", "seconds")
                ]
                rows.append(RelativeCost(name, variant, len(both), *ratios))
    return rows


def spreads(pictures: Iterable[PictureRays], costs: Iterable[Cost]) -> list[Spread]:
    """The spread of each variant in each animation, if it was measured in at least two frames."""
    pictures, costs, rows = list(pictures), list(costs), []
    for name in dict.fromkeys(s.of for s in pictures if s.frame is not None):
        frames = [s.picture for s in pictures if s.of == name]
        for variant in PLANS:
            every = [of(costs, picture, variant).seconds for picture in frames]
            some = [s for s in every if s is not None]
            if len(some) > 1:
                quarter, most = np.percentile(some, (25, 75)).tolist()
                shares = median(some), max(some) / min(some), most - quarter, pstdev(some) / fmean(some)
                rows.append(Spread(name, variant, len(some), len(every) - len(some), *shares))
    return rows
