"""Measures soft shadows with our plans and with all modes of Embree: same rays, alternating runs, one process."""

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...engine.method_registry import BUILDERS
from ...engine.plan import Plan
from ...files import atomic_output
from ...kernels.parallel import thread_count
from ...query.shadow_query import ShadowQuery
from ...scene.lights import Light
from .. import benchmark_views as views
from ..benchmark_views import BenchmarkView, real_path, square
from . import embree
from .ray_contest import ORDERS, OURS, Contender, PeerRays, contest, packets, query_of, rows, shadow_rays, valid_ids

# --- Contenders -------------------------------------------------------------------------------------------------------


BUILDS = [("medium", 0), ("high", 0), ("medium", embree.ROBUST), ("high", embree.ROBUST)]
_ISA_NAMES = {16: "AVX-512", 8: "AVX2 or AVX", 4: "SSE"}


class EmbreeModes(NamedTuple):
    """A mesh built by Embree in all ways of BUILDS."""

    scenes: dict[tuple[str, int], embree.EmbreeScene]  # (quality, flags) -> scene; empty without Embree
    width: int  # rays of Embree's largest native packet


def our_contender(plan: Plan, prepared: Any, query: ShadowQuery, threads: int) -> Contender:
    """A plan, timed from the query to its array of bits. `prepared` is the result of ``plan.tracer.prepare``."""
    h, w = query.sides.shape
    spp = query.samples.shape[1]

    def run(_: None) -> np.ndarray:
        bits = np.zeros((h, w, -(-spp // 64)), np.uint64)
        plan.tracer.trace(prepared, query, bits, threads, None, None)
        return bits

    def answer(bits: np.ndarray) -> np.ndarray:
        octets = bits.astype("<u8", copy=False).view(np.uint8)
        return np.unpackbits(octets, axis=-1, count=spp, bitorder="little").view(bool).ravel()

    return Contender(OURS, str(plan), lambda: None, run, answer)


@contextmanager
def built_embree(vertices: np.ndarray, isa: str | None = None) -> Iterator[EmbreeModes]:
    """Embree's scenes of triangles, (n, 3, 3) float32, built in all ways of BUILDS."""
    with embree.Device(isa=isa) as device:
        scenes: dict[tuple[str, int], embree.EmbreeScene] = {}
        try:
            for quality, flags in BUILDS:
                scenes[quality, flags] = embree.EmbreeScene(device, vertices, quality=quality, flags=flags)
            yield EmbreeModes(scenes, device.width)
        finally:
            for scene in scenes.values():
                scene.close()


def describe_embree(isa: str | None = None) -> str:
    """Version and instruction set of Embree."""
    with embree.Device(isa=isa) as device:
        instructions = _ISA_NAMES.get(device.width, "scalar")
        return f"Embree {device.version}, {instructions}" + (f" (isa={isa})" if isa else "")


def embree_contenders(
    built: EmbreeModes, rays: PeerRays, orders: Sequence[str], hits: bool, threads: int
) -> list[Contender]:
    """Contenders for every build, with single rays and with packets in `orders`, with and without the coherent flag.

    Packets wider than `built.width` are skipped, because Embree would trace them ray by ray.

    hits : whether to find the closest hit, not any hit
    """
    if not built.scenes:
        return []
    by = {order: packets(rays, order, built.width) for order in orders}
    kinds: list[tuple[int, str, np.ndarray]] = [
        (1, "", valid_ids(by[orders[-1]]))
    ]  # all samples of a pixel in sequence
    kinds += [(built.width, f" by {order}" if len(orders) > 1 else "", ids) for order, ids in by.items()]
    modes = [
        _Mode(quality, flags, lanes, name, ids, coherent)
        for quality, flags in BUILDS
        for lanes, name, ids in kinds
        for coherent in (False, True)
    ]
    return [_embree_contender(built, rays, hits, threads, mode) for mode in modes]


class _Mode(NamedTuple):
    """A build, and the way to trace rays in it."""

    quality: str
    flags: int
    lanes: int  # rays per call
    packets: str  # " by ORDER", or "" where there is no choice
    ids: np.ndarray  # ray ids, as for `embree.write`
    coherent: bool

    def name(self, function: str) -> str:
        robust = " robust" if self.flags & embree.ROBUST else ""
        return f"{function}{self.packets} {self.quality}{robust}{' coherent' if self.coherent else ''}"


def _embree_contender(built: EmbreeModes, rays: PeerRays, hits: bool, threads: int, mode: _Mode) -> Contender:
    function = f"{'rtcIntersect' if hits else 'rtcOccluded'}{mode.lanes}"
    robust = " robust" if mode.flags & embree.ROBUST else ""
    read = embree.faces_of if hits else embree.occluded_of
    scene = built.scenes[mode.quality, mode.flags]

    def run(records: embree.Records) -> embree.Records:
        embree.trace(scene, records, mode.coherent, threads)
        return records

    return Contender(
        f"Embree {function}{robust}",
        mode.name(function),
        lambda: embree.write(rays, mode.ids, hits),
        run,
        lambda records: read(rays, records),
    )


# --- Measurement ------------------------------------------------------------------------------------------------------


REAL = ("sponza_crytek",)
"""Folders of $ANTUMBRA_SCENES to measure if they exist."""

EDGE = 40
"""The edge of a light placed by an info.json is 1 / EDGE of the scene's diagonal."""

Say = Callable[[str], None]


class PeerBuild(NamedTuple):
    """The time of one build."""

    scene: str
    method: str
    seconds: float  # wall time; ours includes the tracer's blocks


def default_names() -> list[str]:
    """The default scenes."""
    return [*(name for name in REAL if real_path(name)), "forest"]


def named_view(name: str, size: tuple[int, int]) -> BenchmarkView:
    """The view of a folder of $ANTUMBRA_SCENES, of a procedural scene, or of a scene file."""
    return views.named_view(name, size, square(EDGE), REAL)


def measure(
    view: BenchmarkView, plan: Plan, spp: int, threads: Sequence[int], rounds: int, say: Say
) -> tuple[list[dict[str, Any]], list[PeerBuild]]:
    """(rows of `ray_contest.rows` for each thread count, all builds) for a view's first light."""
    assert plan.build is not None
    triangles = view.scene.triangles(0.0)
    vertices = triangles.vertices
    say(f"{view.name}, building")
    start = time.perf_counter()
    prepared = plan.tracer.prepare(BUILDERS[plan.build].build(vertices, None), thread_count(None))
    builds = [PeerBuild(view.name, plan.build, time.perf_counter() - start)]
    light = view.lights[0]
    query = query_of(triangles, view.camera, light, spp, thread_count(None))
    rays = shadow_rays(query)
    n, contest_rows = int(rays.active.sum()), []
    with built_embree(vertices) as built:
        for (quality, robust), scene in built.scenes.items():
            builds.append(PeerBuild(view.name, f"Embree {quality}{' robust' * bool(robust)}", scene.build_seconds))
        for count in threads:
            contenders = [our_contender(plan, prepared, query, count)]
            contenders += embree_contenders(built, rays, ORDERS, False, count)
            report = lambda text, count=count: say(f"{view.name}, {count} thread(s): {text}")
            results, blocked = contest(contenders, rays.active, rounds, "wall", report)
            case = {"scene": view.name, "triangles": len(vertices), "light": type(light).__name__, "edge": _edge(light)}
            contest_rows += rows({**case, "threads": count, "occluded": float(blocked.mean())}, results, n)
    return contest_rows, builds


def _edge(light: Light) -> float | None:
    return float(np.linalg.norm(light.u)) if hasattr(light, "u") else None


def finalists(rows: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """Our rows, and those of Embree's fastest modes, which were measured in rounds."""
    return [row for row in rows if row["rounds"]]


# --- Plot -------------------------------------------------------------------------------------------------------------


def write_plot(rows: list[dict[str, Any]], path: Path) -> None:
    """Write a bar plot of rates with a panel per scene and thread count."""
    from matplotlib.figure import Figure

    measured = finalists(rows)
    cases = list(dict.fromkeys((row["scene"], row["threads"]) for row in measured))
    sheet = Figure(figsize=(8.0, 2.4 * len(cases)), layout="constrained")
    for panel, case in zip(sheet.subplots(len(cases), squeeze=False)[:, 0], cases):
        mine = [row for row in measured if (row["scene"], row["threads"]) == case][::-1]
        colours = ["tab:blue" if row["family"] == OURS else "0.7" for row in mine]
        panel.barh([row["contender"] for row in mine], [row["mrays"] for row in mine], color=colours)
        panel.set_title(f"{case[0]}, {case[1]} thread(s)", fontsize=9)
        panel.tick_params(labelsize=8)
        panel.set_xlabel("M rays/s", fontsize=8)
    with atomic_output(path) as temporary:
        sheet.savefig(temporary, format="png", dpi=110)
