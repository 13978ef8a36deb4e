"""The contenders of a ray set: our plans, Embree in all its modes, Mitsuba 3 and Open3D. Missing peers are skipped."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np

from antumbra.engine.plan import Plan
from antumbra.query.shadow_query import ShadowQuery
from common import has_embree, installed

from . import embree, mitsuba_rays, open3d_rays
from .ray_contest import ORDERS, OURS, Contender, PeerRays, packets, valid_ids

# --- Our plans and Embree ---------------------------------------------------------------------------------------------


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
def embree_scenes(vertices: np.ndarray, isa: str | None = None) -> Iterator[EmbreeModes]:
    """Embree's scenes of triangles, (n, 3, 3) float32, built in all ways of BUILDS; none without Embree."""
    if not has_embree():
        yield EmbreeModes({}, 0)
        return
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
    if not has_embree():
        return "not installed"
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


# --- Mitsuba and Open3D -----------------------------------------------------------------------------------------------


def mitsuba_contenders(scene, rays: PeerRays, threads: int) -> list[Contender]:
    """Contenders that call ray_test in both orders, with and without the coherent flag."""
    mitsuba_rays.set_threads(threads)
    return [
        Contender(
            "Mitsuba",
            f"Mitsuba ray_test by {order}{' coherent' if coherent else ''}",
            lambda ids=ids: scene.write(rays, ids),
            lambda ray, coherent=coherent: scene.trace(ray, coherent),
            lambda blocked, ids=ids: mitsuba_rays.occluded_of(rays, ids, blocked),
        )
        for order in ORDERS
        for ids in [valid_ids(packets(rays, order))]
        for coherent in (False, True)
    ]


def open3d_contenders(scene, rays: PeerRays, threads: int) -> list[Contender]:
    """The contender that calls test_occlusions, with all samples of a pixel in sequence."""
    ids = valid_ids(packets(rays, "samples"))
    return [
        Contender(
            "Open3D",
            "Open3D test_occlusions",
            lambda: scene.write(rays, ids),
            lambda tensor: scene.trace(tensor, rays.tmax, threads),
            lambda blocked: open3d_rays.occluded_of(rays, ids, blocked),
        )
    ]


def other_peers(vertices) -> list:
    """[(function that makes contenders, scene)] of Mitsuba and Open3D, if they are installed."""
    peers = []
    if installed(mitsuba_rays.library):
        peers.append((mitsuba_contenders, mitsuba_rays.MitsubaScene(vertices)))
    if installed(open3d_rays.library):
        peers.append((open3d_contenders, open3d_rays.Open3DScene(vertices)))
    return peers
