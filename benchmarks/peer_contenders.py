"""The peers as contenders for a ray set: Embree in all its modes, Mitsuba 3 and Open3D. Missing ones are left out."""

from contextlib import contextmanager

from antumbra.papers.peers import peer_measurements as contenders
from antumbra.papers.peers.peer_measurements import EmbreeModes, built_embree
from antumbra.papers.peers.ray_contest import ORDERS, Contender, PeerRays, one_by_one, packets
from common import has_embree, installed
from peers import mitsuba_rays, open3d_rays


@contextmanager
def embree_scenes(vertices, isa: str | None):
    """Embree's scenes, as of `built_embree`; none without Embree."""
    if not has_embree():
        yield EmbreeModes({}, 0)
        return
    with built_embree(vertices, isa) as built:
        yield built


def describe_embree(isa: str | None) -> str:
    """Version and instruction set of Embree."""
    return contenders.describe_embree(isa) if has_embree() else "not installed"


def mitsuba_contenders(scene, rays: PeerRays, threads: int) -> list[Contender]:
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


def open3d_contenders(scene, rays: PeerRays, threads: int) -> list[Contender]:
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
