"""The peers as contenders for a ray set: Embree in all its modes, Mitsuba 3 and Open3D."""

from contextlib import contextmanager

from common import has_embree, installed
from contest import Contender
from peers import embree, embree_rays, mitsuba_rays, open3d_rays
from peers.ray_sets import ORDERS, RaySet, one_by_one, packets

BUILDS = [("medium", 0), ("high", 0), ("medium", embree.ROBUST), ("high", embree.ROBUST)]
ISA_NAMES = {16: "AVX-512", 8: "AVX2 or AVX", 4: "SSE"}


@contextmanager
def embree_scenes(vertices, isa: str | None):
    """({(quality, flags): EmbreeScene} of all BUILDS, width of Embree's largest native packet), or ({}, 0)."""
    if not has_embree():
        yield {}, 0
        return
    with embree.Device(isa=isa) as device:
        scenes = {}
        try:
            for quality, flags in BUILDS:
                scenes[quality, flags] = embree.EmbreeScene(device, vertices, quality=quality, flags=flags)
            yield scenes, device.width
        finally:
            for scene in scenes.values():
                scene.close()


def describe_embree(isa: str | None) -> str:
    """Version and instruction set of Embree."""
    if not has_embree():
        return "not installed"
    with embree.Device(isa=isa) as device:
        return f"Embree {device.version}, {ISA_NAMES.get(device.width, 'scalar')}" + (f" (isa={isa})" if isa else "")


def embree_contenders(built, rays: RaySet, orders, hits: bool, threads: int) -> list[Contender]:
    """Contenders for every build, by single rays and by packets in `orders`, coherent and not.

    built : from `embree_scenes`; wider packets are left out, because Embree would trace them ray by ray
    hits : whether to find the closest hit, not any hit
    """
    scenes, lanes = built
    if not scenes:
        return []
    by = {order: packets(rays, order, lanes) for order in orders}
    kinds = [(1, "", one_by_one(by[orders[-1]]))]  # all samples of a pixel in sequence
    kinds += [(lanes, f" by {order}" if len(orders) > 1 else "", ids) for order, ids in by.items()]
    function = "rtcIntersect" if hits else "rtcOccluded"
    read = embree_rays.faces_of if hits else embree_rays.occluded_of
    found = []
    for (quality, flags), scene in scenes.items():
        robust = " robust" if flags & embree.ROBUST else ""
        for lanes, how, ids in kinds:
            for coherent in (False, True):

                def run(records, scene=scene, coherent=coherent):
                    embree_rays.trace(scene, records, coherent, threads)
                    return records

                found.append(
                    Contender(
                        f"Embree {function}{lanes}{robust}",
                        f"{function}{lanes}{how} {quality}{robust}{' coherent' if coherent else ''}",
                        lambda ids=ids: embree_rays.write(rays, ids, hits),
                        run,
                        lambda records: read(rays, records),
                    )
                )
    return found


def mitsuba_contenders(scene, rays: RaySet, threads: int) -> list[Contender]:
    """Contenders that call ray_test in both orders, coherent and not."""
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
        for ids in [one_by_one(packets(rays, order))]
        for coherent in (False, True)
    ]


def open3d_contenders(scene, rays: RaySet, threads: int) -> list[Contender]:
    """The contender that calls test_occlusions, with all samples of a pixel in sequence."""
    ids = one_by_one(packets(rays, "samples"))
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
    """[(function that makes contenders, scene)] of Mitsuba and Open3D. A line names each that is not installed."""
    found = []
    if installed(mitsuba_rays.library):
        found.append((mitsuba_contenders, mitsuba_rays.MitsubaScene(vertices)))
    if installed(open3d_rays.library):
        found.append((open3d_contenders, open3d_rays.Open3DScene(vertices)))
    return found
