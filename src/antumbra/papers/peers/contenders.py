"""Contenders for the shadow rays of a query: plans of ours, and Embree in all its modes."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np

from ...plan import Plan
from ...query.shadow_query import ShadowQuery
from . import embree, embree_rays
from .contest import OURS, Contender
from .ray_sets import RaySet, one_by_one, packets

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
    built: EmbreeModes, rays: RaySet, orders: Sequence[str], hits: bool, threads: int
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
    built: EmbreeModes, rays: RaySet, hits: bool, threads: int, quality, flags, lanes, how, ids, coherent
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
