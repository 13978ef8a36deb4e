"""Measures and draws Figures 6 and 7 and Table 2 of the report on ray hierarchies [Olsson and Assarsson 2011].

Views are BART's robots in motion, its museum from four places, and still scenes. The published figures were measured on
a GPU (Sec. 5, Tables 1 and 2).
"""

from collections.abc import Callable, Iterable
from pathlib import Path
from statistics import fmean, median, pstdev
from typing import NamedTuple

import numpy as np

from ...engine.scene import Scene
from ...errors import InputError
from ...files import atomic_output
from ...picture.frame import Frame
from ...picture.renderer import Renderer
from ...scene.camera import Camera
from ...scene.lights import Light, PointLight
from .. import benchmark_views as views
from ..benchmark_views import BenchmarkView, digest, info_view, point, real_path
from .cone_hierarchy import with_culling

# ---------------------------------------------------------------------------------------------------------------------
# Figures that the report on ray hierarchies measured on a GPU [Olsson and Assarsson 2011, Sec. 5, Tables 1 and 2].


VARIANTS = ("Spheres", "SpheresSorted", "Precise", "PreciseSorted", "PreciseSEA", "PreciseEATP", "PreciseSEATP")
"""Table 1: sphere tests or precise tests; rays in the picture's order or sorted (S); with early accept (EA); with two
passes (TP)."""

MEASURED = VARIANTS[:4]
"""The variants of Figure 6 and Table 2. The others are in Figure 7, beside PreciseSorted."""

FIGURE7 = VARIANTS[3:]
"""The variants of Figure 7: more culling, and more time."""

NODES = {
    "Spheres": (19.89e6, 317.91e6, 5.77e6, 2199.22e6),
    "SpheresSorted": (2.66e6, 6.79e6, 5.40e6, 6.60e6),
    "Precise": (17.58e6, 292.84e6, 2.25e6, 2163.30e6),
    "PreciseSorted": (0.82e6, 2.24e6, 2.20e6, 1.97e6),
}
"""Table 2: cones visited in four views of the museum. The third has the most screen coherence, the last the least."""

MILLISECONDS = {
    "Spheres": (29.40, 446.10, 10.53, 3771.55),
    "SpheresSorted": (11.90, 16.75, 15.05, 16.69),
    "Precise": (38.50, 557.91, 8.26, 4172.61),
    "PreciseSorted": (10.65, 13.40, 12.63, 12.60),
}
"""Table 2: time of the shadows in the same views, in milliseconds."""


def published_cut(unsorted: str, sorted_: str, table: dict[str, tuple[float, ...]] = NODES) -> float:
    """The ratio of a table without and with sorting, in the view where sorting helps most.

    The report's text says "up to three orders of magnitude fewer nodes" and "over two orders of magnitude faster".
    """
    return max(a / b for a, b in zip(table[unsorted], table[sorted_]))


# --- Views of the ray hierarchy benchmark: BART's robots in motion, its museum from four places, and still scenes -----
#
# BART's own camera walks through the robots' city, and the report follows it. Here the camera of the robots stands
# still, because their folder has no camera path. Each picture has one point light.


ROBOTS, MUSEUM = "bart_robots", "bart_museum8_subdivided"
MOVING = (ROBOTS, MUSEUM)
"""Folders of $ANTUMBRA_SCENES whose vertex frames are used. All other folders give their still scene.glb."""

REAL = (*MOVING, "sponza_crytek", "synthetic_garden_foxes")
MADE = ("atrium", "forest")
"""Procedural scenes for machines without the real ones. Neither moves."""

MUSEUM_NAME = "subdivided museum"
"""The report has BART's museum at its finest tessellation. This one is a coarse one with its triangles subdivided."""

STILL_CAMERA = "The robots are seen by a camera that stands still: their folder has no camera path"

_MUSEUM = {
    "hall": (1.0, None),
    "before the cloud": (2.0, ((-0.9, 2.6, 1.0), (0.5, 2.4, -0.6), 70.0)),
    "wall": (1.0, ((1.8, 1.8, 1.2), (5.0, 1.6, -0.8), 60.0)),
    "in the cloud": (1.75, ((-0.6, 2.7, 0.6), (0.5, 2.4, -0.6), 75.0)),
}
"""Place -> (seconds, (position, target, vfov) of the camera, None: from info.json), in the order of Table 2. The first
and the third see large surfaces. The others see the far wall between hundreds of small triangles that hang in the air.
"""


class PictureCase(NamedTuple):
    """A scene at one moment."""

    name: str
    of: str  # name of the scene
    frame: int | None  # number within an animation; None: the scene is still, or each picture has another camera
    scene: Scene
    camera: Camera
    light: Light
    time: float  # seconds


def default_names() -> list[str]:
    """The scenes that are measured if none is named."""
    real = [name for name in REAL if real_path(name, "frames.npy" if name in MOVING else "scene.glb")]
    return real or list(MADE)


def named_view(name: str, size: tuple[int, int]) -> BenchmarkView:
    """The view of a folder of $ANTUMBRA_SCENES, a procedural scene, a scene file, or a folder of vertex frames."""
    frames = real_path(name, "frames.npy") if name in MOVING else Path(name) / "frames.npy"
    if frames and frames.is_file():
        return info_view(frames.parent.resolve().name, frames.parent, size, point)
    return views.named_view(name, size, point, REAL)


def with_point(view: BenchmarkView) -> BenchmarkView:
    """The view with a single light: a point in the centre of its first light."""
    light, bounds = view.lights[0], view.scene.bounds
    patch = light.patch(view.scene.origin, float(np.linalg.norm(bounds[1] - bounds[0])))
    middle = patch.base + (patch.u + patch.v) / 2 if light.domain == "square" else patch.base
    return view._replace(lights=[PointLight(view.scene.origin + middle)])


def times_of(scene: Scene, frames: int) -> list[float]:
    """`frames` times, spread evenly over the animation; a single time for a still scene."""
    return np.linspace(0.0, scene.duration, frames).tolist() if scene.animated else [0.0]


def pictures(view: BenchmarkView, frames: int) -> list[PictureCase]:
    """The pictures of a view: the museum from four places, another animation in `frames` frames, a still scene once."""
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


def _placed(camera: Camera, where) -> Camera:
    if where is None:
        return camera
    position, target, vfov = where
    return Camera(position, target, camera.up, vfov, camera.width, camera.height)


# --- Measures Figures 6 and 7 and Table 2 of the report on ray hierarchies [Olsson and Assarsson 2011] ----------------
#
# Each variant makes cones from the shadow rays of a picture, one for each pixel, and traces the triangles through
# them. Times are of the phase `trace` of a frame, which includes making the cones. Variants take turns within each
# round. The median of the rounds counts. Smaller pictures predict the time of a variant; if it is too long, the
# variant is left out.


OURS, BEST = "cones", "PreciseSorted"
PLANS = {OURS: "cones", **{name: f"cones:{name}" for name in VARIANTS}}
"""Variant -> plan: our variant, then those of Table 1 by the report's names."""

CULLING_PLANS = {OURS: "cones", **{name: with_culling(name) for name in VARIANTS}}
"""The same, if faces are culled: all drop culled faces before the traversal."""

REFERENCE = "lbvh+single"
"""All variants must have the bits of this plan."""

SHRINK = (8, 4)
"""Divisors of the width and the height for the smaller pictures, which are traced first. The prediction assumes that
nodes and seconds grow with every doubling by the same factor as between these two, but not faster than the rays."""


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
    """The cost of one variant in one picture. None: it was left out, because it would have taken too long."""

    picture: str
    variant: str  # a key of PLANS
    predicted: float  # seconds, predicted from smaller pictures
    predicted_nodes: float
    nodes: int | None = None  # pairs of a triangle and a cone that were tested
    tests: int | None = None  # ray tests, of up to 16 rays each
    seconds: float | None = None  # time of the phase `trace`
    bits: bytes | None = None  # digest of the answer
    passed: int | None = None  # tested pairs that may meet


class RelativeCost(NamedTuple):
    """Medians over the pictures of a scene: how many times the nodes and the time of BEST a variant takes."""

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
    frames: int  # frames that were measured
    missing: int  # frames that were left out
    median: float
    ratio: float  # longest / shortest
    quartiles: float  # third quartile - first quartile
    deviation: float  # standard deviation / mean


def measure(
    picture: PictureCase,
    threads: int,
    rounds: int,
    limit: float,
    say: Callable[[str], None],
    cull_faces: str | None = None,
) -> tuple[PictureRays, list[Cost]]:
    """Measure all variants in one picture; InputError if its camera sees nothing.

    limit : the most seconds that a variant may take
    cull_faces : the side of triangles, seen from a receiver, that does not block; "back" is as published
    """
    plans = PLANS if cull_faces is None else CULLING_PLANS
    renderers = {name: Renderer(picture.scene, plan, threads) for name, plan in plans.items()}

    def trace(name: str, renderer: Renderer, shrink=1, counters=False) -> Frame:
        camera = picture.camera.resized(*(max(n // shrink, 1) for n in (picture.camera.width, picture.camera.height)))
        say(f"{picture.name}, {name}, {camera.width} x {camera.height}")
        asked = {"spp": 1, "time": picture.time, "counters": counters, "cull_faces": cull_faces}
        return renderer.render(camera, [picture.light], **asked)

    frame = trace(REFERENCE, Renderer(picture.scene, REFERENCE, threads))
    if not frame.rays:
        raise InputError(f"{picture.name}: the camera sees nothing; choose a scene whose camera sees something")
    seen = _seen(picture, frame)
    predicted = {n: _predicted(*(trace(n, r, part, True) for part in SHRINK)) for n, r in renderers.items()}
    counted = {n: trace(n, r, counters=True) for n, r in renderers.items() if predicted[n][0] <= limit}
    laps: dict[str, list[float]] = {name: [] for name in counted}
    for turn in range(rounds):
        for name, first in counted.items():
            if turn == 0 or (turn + 1) * first.timings["trace"] <= limit:  # slow variants have one round
                laps[name].append(trace(name, renderers[name]).timings["trace"])
    costs = []
    for name in PLANS:
        cost = Cost(picture.name, name, *predicted[name])
        if name in counted:
            nodes, passed, tests = _counts(counted[name])
            cost = cost._replace(nodes=nodes, passed=passed, tests=tests)
            cost = cost._replace(seconds=median(laps[name]), bits=digest(counted[name].bits))
        costs.append(cost)
    return seen, costs


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


def _seen(picture: PictureCase, frame: Frame) -> PictureRays:
    blocked = int(np.bitwise_count(frame.bits[0]).sum())
    shown = picture.name, picture.of, picture.frame, picture.scene.n_triangles
    return PictureRays(*shown, frame.rays, blocked, digest(frame.bits))


def answers(seen: Iterable[PictureRays], costs: Iterable[Cost]) -> list[tuple[str, bytes]]:
    """(picture, digest) of all answers, for `papers.benchmark_views.agree`."""
    return [(s.picture, s.bits) for s in seen] + [(c.picture, c.bits) for c in costs if c.bits is not None]


def of(costs: Iterable[Cost], picture: str, variant: str) -> Cost:
    """The cost of a variant in a picture."""
    return next(c for c in costs if (c.picture, c.variant) == (picture, variant))


def fewest(costs: Iterable[Cost], picture: str, among: Iterable[str]) -> str:
    """The variant that visits the fewest nodes, the first one of equals; "" if all were left out."""
    costs = list(costs)
    found = [c for c in (of(costs, picture, variant) for variant in among) if c.nodes is not None]
    return min(found, key=lambda c: c.nodes or 0).variant if found else ""


def cut(
    costs: Iterable[Cost], unsorted: str, sorted_: str, fields: tuple[str, str] = ("nodes", "predicted_nodes")
) -> tuple[float, str, bool]:
    """The largest reduction of nodes, or of another field, by sorting, as (ratio, picture, measured).

    `measured` is False if the unsorted variant was left out, so that its nodes are predicted. The result is
    (nan, "", False) if the sorted variant visited no node.

    fields : names of the measured and of the predicted field
    """
    costs, found, (field, predicted) = list(costs), [], fields
    for a in (c for c in costs if c.variant == unsorted):
        b = getattr(of(costs, a.picture, sorted_), field)
        if b:
            value = getattr(a, predicted if a.nodes is None else field)
            found.append((value / b, a.picture, a.nodes is not None))
    return max(found, default=(np.nan, "", False))


def relative_costs(seen: Iterable[PictureRays], costs: Iterable[Cost], variants: Iterable[str]) -> list[RelativeCost]:
    """The variants of Figure 7 beside BEST, for each scene, over the pictures where both were measured."""
    seen, costs, rows = list(seen), list(costs), []
    for name in dict.fromkeys(s.of for s in seen):
        pictures = [s.picture for s in seen if s.of == name]
        for variant in variants:
            pairs = [(of(costs, p, variant), of(costs, p, BEST)) for p in pictures]
            both = [(a, b) for a, b in pairs if a.nodes and b.nodes]
            if both:
                ratios = [
                    median(getattr(a, f) / max(getattr(b, f), 1e-9) for a, b in both)
                    for f in ("nodes", "passed", "seconds")
                ]
                rows.append(RelativeCost(name, variant, len(both), *ratios))
    return rows


def spreads(seen: Iterable[PictureRays], costs: Iterable[Cost]) -> list[Spread]:
    """The spreads of each animation with at least two frames, and of each variant that was measured in two of them."""
    seen, costs, rows = list(seen), list(costs), []
    for name in dict.fromkeys(s.of for s in seen if s.frame is not None):
        frames = [s.picture for s in seen if s.of == name]
        for variant in PLANS:
            every = [of(costs, picture, variant).seconds for picture in frames]
            some = [s for s in every if s is not None]
            if len(some) > 1:
                quarter, most = np.percentile(some, (25, 75)).tolist()
                shares = median(some), max(some) / min(some), most - quarter, pstdev(some) / fmean(some)
                rows.append(Spread(name, variant, len(some), len(every) - len(some), *shares))
    return rows


# --- Draws Figures 6 and 7 of the report on ray hierarchies, as measured here -----------------------------------------


_WIDTH, _MARKERS = 7.0, "osD^vP*X"
_FIGURES = (
    ("Figure 6: spheres, precise test and sorting", (OURS, *MEASURED)),
    ("Figure 7: early accept, two passes", FIGURE7),
)
"""(title, variants) of the rows of the plot."""


def write_plot(seen: list[PictureRays], costs: list[Cost], path: Path) -> None:
    """Write a plot of the nodes and the time of each variant in each picture, a row for each figure."""
    from matplotlib.figure import Figure

    sheet = Figure(figsize=(max(2 * _WIDTH, 0.9 * len(seen)), 10.0), layout="constrained")
    panels = sheet.subplots(len(_FIGURES), 2, sharex=True)
    for (nodes, time), (title, variants) in zip(panels, _FIGURES):
        nodes.set_title(title)
        time.set_title(title)
        _draw_pictures(nodes, seen, costs, variants, ("nodes", "predicted_nodes"), "nodes tested, millions", 1e-6)
        _draw_pictures(time, seen, costs, variants, ("seconds", "predicted"), "trace, ms", 1e3)
        nodes.legend(fontsize=8)
    with atomic_output(path) as temporary:
        sheet.savefig(temporary, format="png", dpi=110)


def _draw_pictures(
    panel, seen: list[PictureRays], costs: list[Cost], variants: tuple[str, ...], fields, label: str, scale: float
) -> None:
    """Draw each variant in a colour. Lines join the frames of an animation.

    A hollow mark shows the predicted value of a variant that was left out.
    """
    field, predicted = fields
    for variant in variants:
        k = list(PLANS).index(variant)
        style = {"color": f"C{k}", "marker": _MARKERS[k % 8], "markersize": 4}
        for x, cost in enumerate(of(costs, s.picture, variant) for s in seen):
            if cost.nodes is None:
                panel.plot(x, scale * getattr(cost, predicted), fillstyle="none", **style)
        for start, end in _runs(seen):
            values = [getattr(of(costs, s.picture, variant), field) for s in seen[start:end]]
            heights = [float("nan") if v is None else scale * v for v in values]
            name = variant if start == 0 else None
            panel.plot(range(start, end), heights, label=name, **style)
    names = [s.picture for s in seen]
    panel.set_xticks(range(len(seen)), names, rotation=40, ha="right", rotation_mode="anchor", fontsize=8)
    panel.set_yscale("log")
    panel.set_ylabel(label)
    panel.grid(alpha=0.3)


def _runs(seen: list[PictureRays]) -> list[tuple[int, int]]:
    """(first, end) of runs of pictures: frames of the same animation, or a single picture."""
    starts = [k for k, s in enumerate(seen) if k == 0 or s.frame is None or s.of != seen[k - 1].of]
    return list(zip(starts, [*starts[1:], len(seen)]))
