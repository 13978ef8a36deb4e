"""Measures soft shadows by plans of ours and by Embree in all its modes: the same rays, in turns, in one process."""

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

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
from . import embree as embree_rays
from .ray_contest import ORDERS, OURS, Contender, PeerRays, contest, one_by_one, packets, query_of, rows, shadow_rays

# --- Contenders for the shadow rays of a query: plans of ours, and Embree in all its modes ----------------------------


BUILDS = [("medium", 0), ("high", 0), ("medium", embree.ROBUST), ("high", embree.ROBUST)]
_ISA_NAMES = {16: "AVX-512", 8: "AVX2 or AVX", 4: "SSE"}


class EmbreeModes(NamedTuple):
    """A mesh that Embree has built in several ways."""

    scenes: dict[tuple[str, int], embree.EmbreeScene]  # (quality, flags) of BUILDS -> scene; empty without Embree
    width: int  # rays of Embree's largest native packet


def our_contender(plan: Plan, prepared, query: ShadowQuery, threads: int) -> Contender:
    """A plan, from the query to its array of bits. `prepared` is what ``plan.tracer.prepare`` has made."""
    h, w = query.sides.shape
    spp = query.samples.shape[1]

    def run(_):
        bits = np.zeros((h, w, -(-spp // 64)), np.uint64)
        plan.tracer.trace(prepared, query, bits, threads, None, None)
        return bits

    def answer(bits):
        octets = bits.astype("<u8", copy=False).view(np.uint8)
        return np.unpackbits(octets, axis=-1, count=spp, bitorder="little").view(bool).ravel()

    return Contender(OURS, str(plan), lambda: None, run, answer)


@contextmanager
def built_embree(vertices, isa: str | None = None) -> Iterator[EmbreeModes]:
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
    """Contenders for every build, by single rays and by packets in `orders`, coherent and not.

    Packets wider than `built.width` are left out, because Embree would trace them ray by ray.

    hits : whether to find the closest hit, not any hit
    """
    if not built.scenes:
        return []
    by = {order: packets(rays, order, built.width) for order in orders}
    kinds = [(1, "", one_by_one(by[orders[-1]]))]  # all samples of a pixel in sequence
    kinds += [(built.width, f" by {order}" if len(orders) > 1 else "", ids) for order, ids in by.items()]
    modes = ((*build, *kind, coherent) for build in BUILDS for kind in kinds for coherent in (False, True))
    return [_embree_contender(built, rays, hits, threads, *mode) for mode in modes]


def _embree_contender(
    built: EmbreeModes, rays: PeerRays, hits: bool, threads: int, quality, flags, lanes, how, ids, coherent
) -> Contender:
    function = f"{'rtcIntersect' if hits else 'rtcOccluded'}{lanes}"
    robust = " robust" if flags & embree.ROBUST else ""
    read = embree_rays.faces_of if hits else embree_rays.occluded_of
    scene = built.scenes[quality, flags]

    def run(records):
        embree_rays.trace(scene, records, coherent, threads)
        return records

    return Contender(
        f"Embree {function}{robust}",
        f"{function}{how} {quality}{robust}{' coherent' if coherent else ''}",
        lambda: embree_rays.write(rays, ids, hits),
        run,
        lambda records: read(rays, records),
    )


# --- Measures soft shadows by plans of ours and by Embree: the same rays, in turns, in one process --------------------


REAL = ("sponza_crytek",)
"""Folders of $ANTUMBRA_SCENES that are measured if they exist."""

EDGE = 40
"""The edge of a light at the place that an info.json names is the scene's diagonal divided by this."""

Say = Callable[[str], None]


class PeerBuild(NamedTuple):
    """The time of a build."""

    scene: str
    method: str
    seconds: float  # wall time; of ours, with the blocks of the tracer


def default_names() -> list[str]:
    """The scenes that are measured if none is named."""
    return [*(name for name in REAL if real_path(name)), "forest"]


def named_view(name: str, size: tuple[int, int]) -> BenchmarkView:
    """The view of a folder of $ANTUMBRA_SCENES, of a procedural scene, or of a scene file."""
    return views.named_view(name, size, square(EDGE), REAL)


def measure(view: BenchmarkView, plan: Plan, spp: int, threads: Sequence[int], rounds: int, say: Say):
    """(the rows of `contest.rows` for each number of threads, `Built` of all builds) of a view's first light."""
    triangles = view.scene.triangles(0.0)
    vertices = triangles.vertices
    say(f"{view.name}, building")
    start = time.perf_counter()
    prepared = plan.tracer.prepare(BUILDERS[plan.build].build(vertices, None), thread_count(None))
    builds = [PeerBuild(view.name, plan.build, time.perf_counter() - start)]
    light = view.lights[0]
    query = query_of(triangles, view.camera, light, spp, thread_count(None))
    rays = shadow_rays(query)
    n, found = int(rays.asked.sum()), []
    with built_embree(vertices) as built:
        for (quality, robust), scene in built.scenes.items():
            builds.append(PeerBuild(view.name, f"Embree {quality}{' robust' * bool(robust)}", scene.build_seconds))
        for count in threads:
            contenders = [our_contender(plan, prepared, query, count)]
            contenders += embree_contenders(built, rays, ORDERS, False, count)
            tell = lambda text, count=count: say(f"{view.name}, {count} thread(s): {text}")
            results, blocked = contest(contenders, rays.asked, rounds, "wall", tell)
            case = {"scene": view.name, "triangles": len(vertices), "light": type(light).__name__, "edge": _edge(light)}
            found += rows({**case, "threads": count, "occluded": float(blocked.mean())}, results, n)
    return found, builds


def _edge(light: Light) -> float | None:
    return float(np.linalg.norm(light.u)) if hasattr(light, "u") else None


def finalists(found: Iterable[dict]) -> list[dict]:
    """The rows of ours, and of the fastest modes of Embree, which were timed in turns."""
    return [row for row in found if row["rounds"]]


# --- Draws the rates of the contenders as bars ------------------------------------------------------------------------


def write_plot(rows: list[dict], path: Path) -> None:
    """Write a plot with a panel for each scene and number of threads."""
    from matplotlib.figure import Figure

    shown = finalists(rows)
    cases = list(dict.fromkeys((row["scene"], row["threads"]) for row in shown))
    sheet = Figure(figsize=(8.0, 2.4 * len(cases)), layout="constrained")
    for panel, case in zip(sheet.subplots(len(cases), squeeze=False)[:, 0], cases):
        mine = [row for row in shown if (row["scene"], row["threads"]) == case][::-1]
        colours = ["tab:blue" if row["family"] == OURS else "0.7" for row in mine]
        panel.barh([row["contender"] for row in mine], [row["mrays"] for row in mine], color=colours)
        panel.set_title(f"{case[0]}, {case[1]} thread(s)", fontsize=9)
        panel.tick_params(labelsize=8)
        panel.set_xlabel("M rays/s", fontsize=8)
    with atomic_output(path) as temporary:
        sheet.savefig(temporary, format="png", dpi=110)
