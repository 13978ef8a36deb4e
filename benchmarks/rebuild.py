"""Ray hierarchies versus building: shadows in scenes with new triangles in each frame, by our plans and by Embree.

    python benchmarks/rebuild.py [scene ...] [--sizes N,...] [--size W H] [--frames N] [--plot FILE] [--json FILE]

A scene is a folder of the real scenes, a file, or a procedural scene. Procedural scenes are also generated in several
sizes. There is one point light, and one shadow ray per pixel. `differs` counts pixels whose answer differs from that of
`lbvh+multifrusta`.

All methods get the same triangles, G-buffer and receivers, and alternate in random order, since what runs after a large
tree takes longer. None keeps anything from earlier frames, so `auto` chooses as in the first frame of a scene, and its
choice is under `how`. Shadow times include culling, building and tracing. Time to image adds the shared steps
(evaluating, rasterising, receivers and shading), measured once per frame and round. Copying vertices into Embree's
buffer is not timed.
"""

import json
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import NamedTuple, Protocol

import numpy as np

from antumbra.base.errors import InputError
from antumbra.base.files import atomic_output
from antumbra.cli import console as report
from antumbra.cli.arguments import parse_count
from antumbra.engine.auto_accelerator import accelerator_of
from antumbra.engine.plan import parse_plan
from antumbra.engine.plan_records import precompile_plan
from antumbra.engine.scene import procedural
from antumbra.lab.papers.benchmark_views import BenchmarkView, scene_view
from antumbra.lab.papers.ray_hierarchy.ray_hierarchy_views import SCENES, times_of, with_point
from antumbra.picture.renderer import Renderer
from antumbra.query.gbuffer import GBuffer
from antumbra.query.light_samples import light_samples
from antumbra.query.shadow_query import ShadowQuery, shadow_queries
from antumbra.scene.triangles import Triangles
from common import arguments, machine
from peers import embree
from peers.embree_frames import Hits, Shadow, light_points, shadows

PLANS = ("cones", "lbvh+single", "lbvh+packet16", "lbvh+multifrusta", "auto")
REFERENCE = "lbvh+multifrusta"
"""Our plans, and the plan whose bits are compared with those of all methods."""

PROCEDURAL = ("atrium", "city")
"""Procedural scenes that are generated in several sizes."""

BUILDS = [(quality, flags) for quality in ("low", "medium") for flags in (0, embree.DYNAMIC)]
"""Embree's builds to try. The fastest for each packet width enters the rounds."""

_WIDTH, _STYLES, _MARKERS = 170, ("-", "--", ":", "-."), "osD^vP*X"
_SMALL = 110_000  # triangles of small scenes, which are summed up apart, with 10 % slack
_COMMON = "evaluate", "gbuffer", "filter", "shade"


class FrameInput(NamedTuple):
    """The input of every method."""

    triangles: Triangles
    gbuffer: GBuffer
    query: ShadowQuery


class Rebuilt(NamedTuple):
    """Seconds of one method in one scene, medians over times and rounds."""

    scene: str
    triangles: int
    family: str  # name of a procedural scene generated in several sizes; "" for other scenes
    method: str
    how: str  # the plan that ran in the last frame, or how Embree builds and traces
    cull: float
    build: float
    trace: float
    shadows: float  # cull + build + trace
    image: float  # shadows and the shared steps
    differs: int  # pixels, over all times, whose answer differs from that of REFERENCE


class _Method(Protocol):
    name: str
    how: str

    def shadows(self, frame_input: FrameInput) -> tuple[dict[str, float], np.ndarray]:
        """(seconds of "cull", "build" and "trace", bits)."""
        ...


class Ours:
    """One of our plans."""

    def __init__(self, plan: str, threads: int):
        self.name = self.how = plan
        self._new_accelerator = partial(accelerator_of, parse_plan(plan), threads)

    def shadows(self, frame_input):
        accelerator, query = self._new_accelerator(), frame_input.query
        accelerator.begin(query.sides.size)
        start = perf_counter()
        cut = {"cull": start}
        ready = accelerator.tree_for(
            frame_input.triangles, [query], lap=lambda step: cut.update({step: perf_counter()})
        )
        ready.begin()
        built = perf_counter()
        bits = accelerator.answer(ready, query)
        end = perf_counter()
        self.how = str(accelerator.executed(ready))
        return {"cull": cut["cull"] - start, "build": built - cut["cull"], "trace": end - built}, bits


class _Embree:
    """Embree, with its scene."""

    def __init__(
        self, device, build: tuple[str, int], mode: Shadow, frame_input: FrameInput, points: np.ndarray, threads: int
    ):
        (self.quality, self.flags), self.mode, self.points, self.threads = build, mode, points, threads
        vertices = frame_input.triangles.vertices
        self.scene = embree.EmbreeScene(device, vertices, quality=self.quality, flags=self.flags)

    @property
    def name(self) -> str:
        return f"Embree rtcOccluded{self.mode.lanes}"

    @property
    def how(self) -> str:
        return f"{self.quality}{' dynamic' if self.flags else ''}, {self.mode}"

    def shadows(self, frame_input):
        self.scene.fill(frame_input.triangles.vertices)
        self.scene.build_again()
        start = perf_counter()
        bits = shadows(
            self.scene, Hits(frame_input.gbuffer, frame_input.query.origins), self.points, self.mode, self.threads
        )
        return {"cull": 0.0, "build": self.scene.build_seconds, "trace": perf_counter() - start}, bits

    def close(self) -> None:
        self.scene.close()


def rebuild(
    view: BenchmarkView, family: str, frames: int, threads: int, rounds: int, say: Callable[[str], None]
) -> list[Rebuilt]:
    """Measure all methods in one scene, without Embree if it is not installed.

    family : name of the scene if it is generated in several sizes
    """
    common, times = Renderer(view.scene, REFERENCE, threads), times_of(view.scene, frames)
    first, _ = input_of(common, view, times[len(times) // 2])
    with ExitStack() as stack:
        methods: list[_Method] = [Ours(plan, threads) for plan in PLANS]
        if embree_version():
            device = stack.enter_context(embree.Device(threads))
            say(f"{view.name}, trying Embree")
            for build, mode in _fastest(device, first, view, threads):
                methods.append(stack.enter_context(_opened(device, build, mode, first, view, threads)))
        laps: dict[str, list[dict[str, float]]] = {m.name: [] for m in methods}
        differs, rng = dict.fromkeys(laps, 0), np.random.default_rng(0)
        for turn in range(-1, rounds):  # the first round is a warm-up and compares answers
            for k, time in enumerate(times):
                say(f"{view.name}, frame {k + 1} of {len(times)}, round {max(turn, 0) + 1} of {rounds}")
                frame_input, common_seconds = input_of(common, view, time)
                bits = {}
                for m in (methods[i] for i in rng.permutation(len(methods))):
                    seconds, bits[m.name] = m.shadows(frame_input)
                    if turn >= 0:
                        total = sum(seconds.values())
                        laps[m.name].append({**seconds, "shadows": total, "image": total + common_seconds})
                if turn < 0:
                    for m in methods:
                        differs[m.name] += int(np.count_nonzero(bits[m.name] != bits[REFERENCE]))
        middle = {name: {p: median(lap[p] for lap in some) for p in some[0]} for name, some in laps.items()}
        case = view.name, view.scene.n_triangles, family
        return [Rebuilt(*case, m.name, m.how, **middle[m.name], differs=differs[m.name]) for m in methods]


def embree_version() -> str:
    """Embree's version; "" if it is not installed."""
    try:
        with embree.Device(1) as device:
            return device.version
    except InputError:
        return ""


def input_of(common: Renderer, view: BenchmarkView, time: float) -> tuple[FrameInput, float]:
    """(input of all methods at a time, seconds of everything except culling, building and tracing)."""
    frame = common.render(view.camera, view.lights, spp=1, time=time)
    triangles = view.scene.triangles(time, common.threads)
    start = perf_counter()
    (query,) = shadow_queries(
        triangles, frame.gbuffer, view.lights, [light_samples(view.lights[0], 1)], threads=common.threads
    )
    seconds = perf_counter() - start
    return FrameInput(triangles, frame.gbuffer, query), seconds + sum(frame.timings[phase] for phase in _COMMON)


def _points(frame_input: FrameInput, view: BenchmarkView) -> np.ndarray:
    return light_points(view.lights[0], frame_input.triangles.origin, 1)


@contextmanager
def _opened(device, build, mode, frame_input, view, threads) -> Iterator[_Embree]:
    peer = _Embree(device, build, mode, frame_input, _points(frame_input, view), threads)
    try:
        yield peer
    finally:
        peer.close()


def _fastest(
    device, frame_input: FrameInput, view: BenchmarkView, threads: int
) -> list[tuple[tuple[str, int], Shadow]]:
    """The fastest build and mode for single rays, and for the widest native packets."""
    seconds: dict[int, list] = {lanes: [] for lanes in dict.fromkeys((1, device.width))}
    for build in BUILDS:
        modes = [Shadow(n, "samples" if n == 1 else "pixels", c) for n in seconds for c in (False, True)]
        with _opened(device, build, modes[0], frame_input, view, threads) as peer:
            for peer.mode in modes:
                laps = [sum(peer.shadows(frame_input)[0].values()) for _ in range(3)][1:]  # the first warms up
                seconds[peer.mode.lanes].append((min(laps), build, peer.mode))
    return [min(timings)[1:] for timings in seconds.values()]


def sized(name: str, triangles: int, size: tuple[int, int]) -> BenchmarkView:
    """A procedural scene of about `triangles` triangles, with one point light."""
    return with_point(scene_view(f"{name}, {triangles:,}", procedural(name, triangles), size))


def ratio(rows: Iterable[Rebuilt], row: Rebuilt) -> float | None:
    """The shadow speed of a row relative to Embree's best; None without Embree."""
    peers = [r.shadows for r in rows if r.scene == row.scene and r.method.startswith("Embree")]
    return min(peers) / row.shadows if peers else None


def crossings(sizes: Sequence[int], ours: Sequence[float], theirs: Sequence[float]) -> list[tuple[float, float]]:
    """(triangles, seconds) where two curves cross, interpolated linearly on logarithmic axes."""
    n, a, b = (np.log(np.asarray(values, float)) for values in (sizes, ours, theirs))
    gap, points = a - b, []
    for k in np.flatnonzero(gap[:-1] * gap[1:] < 0.0):
        share = gap[k] / (gap[k] - gap[k + 1])
        points.append(
            (float(np.exp(n[k] + share * (n[k + 1] - n[k]))), float(np.exp(a[k] + share * (a[k + 1] - a[k]))))
        )
    return points


def curve(rows: Iterable[Rebuilt], family: str, method: str) -> tuple[list[int], list[float]]:
    """(triangles, shadow seconds) of a method in a procedural scene of several sizes."""
    some = sorted((r.triangles, r.shadows) for r in rows if (r.family, r.method) == (family, method))
    return [n for n, _ in some], [s for _, s in some]


# --- tables and plots --------------------------------------------------------------------------------------------


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:,.1f}"


def overview(rows: list[Rebuilt]) -> tuple[list[str], list[list[str]]]:
    """(heads, cells) of a table of shadow milliseconds: a row per scene, a column per method; the fastest has a *."""
    methods = list(dict.fromkeys(r.method for r in rows))
    table = []
    for scene in dict.fromkeys(r.scene for r in rows):
        of_scene = {r.method: r for r in rows if r.scene == scene}
        best = min(of_scene.values(), key=lambda r: r.shadows)
        cells = [_ms(r.shadows) + "*" * (r is best) for r in (of_scene[method] for method in methods)]
        table.append([scene, f"{best.triangles:,}", *cells])
    return ["scene", "triangles", *methods], table


def _print_rebuilt(rows: list[Rebuilt], version: str) -> None:
    """Print the times, and where a ray hierarchy is faster than building."""
    table = []
    for r in rows:
        faster = ratio(rows, r)
        times = map(_ms, (r.cull, r.build, r.trace, r.shadows, r.image))
        shares = f"{faster:.2f}" if faster else "", f"{r.differs:,}"
        table.append((r.scene, f"{r.triangles:,}", r.method, r.how, *times, *shares))
    head = ["scene", "triangles", "method", "how", "cull", "build", "trace", "shadows", "time to image"]
    head += ["Embree / it", "differs"]
    print(f"Shadows with new triangles in each frame, ms (Embree {version or 'is not installed'})")
    report.print_table(head, table, right=(1, *range(4, len(head))), width=_WIDTH)
    print("The same, culling, building and tracing together; *: the fastest method")
    head, cells = overview(rows)
    report.print_table(head, cells, right=range(1, len(head)), width=_WIDTH)
    report.print_fields(_comparisons(rows))
    print()


def _comparisons(rows: list[Rebuilt]) -> list[tuple[str, str]]:
    """(what, text): where our ray hierarchy is faster than each other method, and how often each is the fastest."""
    fields = []
    ours, *others = dict.fromkeys(r.method for r in rows)
    for name in PROCEDURAL:
        for method in others:
            sizes, theirs = curve(rows, name, method)
            if sizes:
                fields.append((f"{ours} / {method}, {name}", _winner(sizes, curve(rows, name, ours)[1], theirs)))
    for method in others:
        pairs = [(a, b) for a in rows for b in rows if (a.method, b.method, a.scene) == (ours, method, b.scene)]
        ratios = [b.shadows / a.shadows for a, b in pairs if a.triangles <= _SMALL]
        if ratios:
            wins = sum(r > 1 for r in ratios)
            text = f"{min(ratios):.2f} to {max(ratios):.2f} times as fast; faster in {wins} of {len(ratios)}"
            fields.append((f"{ours} / {method}, to {_SMALL:,} triangles", text))
    scenes = dict.fromkeys(r.scene for r in rows)
    best = [min((r for r in rows if r.scene == scene), key=lambda r: r.shadows).method for scene in scenes]
    fields.append(("fastest", ", ".join(f"{method} {best.count(method)}" for method in dict.fromkeys(best))))
    return fields


def _winner(sizes: list[int], ours: list[float], theirs: list[float]) -> str:
    """A text that states where our curve is below the other."""
    points = [n for n, _ in crossings(sizes, ours, theirs)]
    first = "faster" if ours[0] < theirs[0] else "slower"
    if not points:
        return f"{first} from {sizes[0]:,} to {sizes[-1]:,} triangles"
    return f"{first} at {sizes[0]:,} triangles; the curves cross at {', '.join(f'{n:,.0f}' for n in points)}"


def write_plot(rows: list[Rebuilt], path: Path) -> None:
    """Write a plot of shadow times over the number of triangles."""
    from matplotlib.figure import Figure

    sheet = Figure(figsize=(14.0, 5.5), layout="constrained")
    _draw_rebuild(sheet.subplots(), rows)
    with atomic_output(path) as temporary:
        sheet.savefig(temporary, format="png", dpi=110)


def _draw_rebuild(panel, rows: list[Rebuilt]) -> None:
    """Draw each method in its own colour: lines for procedural scenes, markers for others, and rings at crossings."""
    ours, *others = dict.fromkeys(r.method for r in rows)
    families = [name for name in dict.fromkeys(r.family for r in rows) if name]
    for k, method in enumerate((ours, *others)):
        for name, style in zip(families, _STYLES):
            sizes, seconds = curve(rows, name, method)
            panel.plot(sizes, [1e3 * s for s in seconds], style, marker=".", color=f"C{k}")
            if method != ours:
                for n, at in crossings(sizes, curve(rows, name, ours)[1], seconds):
                    panel.plot(n, 1e3 * at, "o", markersize=12, fillstyle="none", color=f"C{k}")
        panel.plot([], [], color=f"C{k}", label=method)
    for name, style in zip(families, _STYLES):
        panel.plot([], [], style, color="black", label=name)
    for mark, name in zip(_MARKERS, dict.fromkeys(r.scene for r in rows if not r.family)):
        for r in (r for r in rows if r.scene == name):
            panel.plot(r.triangles, 1e3 * r.shadows, mark, color=f"C{[ours, *others].index(r.method)}")
        panel.plot([], [], mark, color="black", label=name)
    panel.plot([], [], "o", markersize=12, fillstyle="none", color="black", label=f"{ours} crosses the other method")
    panel.set(xscale="log", yscale="log", xlabel="triangles, all new in each frame", ylabel="build and trace, ms")
    panel.legend(fontsize=8, ncols=3)
    panel.grid(alpha=0.3, which="both")


def main() -> None:
    parser = arguments(__doc__)
    parser.set_defaults(rounds=3)
    parser.add_argument("--size", type=int, nargs=2, default=(1024, 1024), metavar=("W", "H"))
    parser.add_argument("--frames", type=int, default=10, help="frames of each animated scene")
    parser.add_argument("--sizes", default="10k,30k,100k,300k,1M,2M", help="triangles of the procedural scenes")
    parser.add_argument("--plot", type=Path, help="write curves to a .png file")
    options = parser.parse_args()
    threads, size = options.threads or os.cpu_count() or 1, tuple(options.size)
    for plan in (*PLANS, "srdh+single"):  # `auto` chooses among methods whose kernels are on disk
        precompile_plan(parse_plan(plan), "raster")
    say = lambda text: print(f"\r{text:80s}", end="", file=sys.stderr, flush=True)
    rows: list[Rebuilt] = []
    for name in [str(path) for path in options.scene] or SCENES.default_names():
        rows += rebuild(with_point(SCENES.view(name, size)), "", options.frames, threads, options.rounds, say)
    for name in PROCEDURAL:
        for text in options.sizes.split(","):
            rows += rebuild(sized(name, parse_count(text, "--sizes"), size), name, 1, threads, options.rounds, say)
    say("")
    print(file=sys.stderr)
    _print_rebuilt(rows, embree_version())
    if options.plot:
        write_plot(rows, options.plot)
    if options.json:
        records = [{**r._asdict(), "ratio": ratio(rows, r)} for r in rows]
        options.json.write_text(json.dumps({"machine": machine(threads), "size": size, "rows": records}, indent=1))


if __name__ == "__main__":
    main()
