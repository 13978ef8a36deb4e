"""Embree's loops, by single rays or by packets, give the oracle's answers on a soup. No ray is lost or mixed up."""

import numpy as np
import pytest

import oracle
from antumbra.kernels.jit import kernel
from antumbra.papers.peers.ray_contest import ORDERS, one_by_one, packets
from peer_scenes import rays_through, soup, truth

pytest.importorskip("embreex", reason="Embree is not installed: pip install 'antumbra[peers]'")

from antumbra.papers.peers import embree
from antumbra.papers.peers import embree as embree_rays
from antumbra.papers.peers.embree import FLUSH, control


def ids_of(rays, order, lanes):
    return packets(rays, order, lanes) if lanes > 1 else one_by_one(packets(rays, order))


@pytest.fixture(params=[None, "avx2"])
def scene(request):
    with embree.Device(2, request.param) as device, embree.EmbreeScene(device, soup(), flags=embree.ROBUST) as scene:
        yield scene


@pytest.mark.parametrize("coherent", [False, True])
@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("lanes", [1, 4, 8, 16])
def test_any_hit(scene, lanes, order, coherent):
    rays = rays_through(1.0)
    records = embree_rays.write(rays, ids_of(rays, order, lanes), threads=2)
    embree_rays.trace(scene, records, coherent, threads=2)
    np.testing.assert_array_equal(embree_rays.occluded_of(rays, records), truth(soup(), rays))


@pytest.mark.parametrize("lanes", [1, 4, 8, 16])
def test_nearest_hit(scene, lanes):
    rays = rays_through(np.inf)
    records = embree_rays.write(rays, ids_of(rays, "pixels", lanes), hits=True, threads=2)
    embree_rays.trace(scene, records, threads=2)
    _, expected = oracle.closest_hit(soup(), np.repeat(rays.origins, rays.each, 0), rays.directions)
    found = embree_rays.faces_of(rays, records)
    assert (found[rays.asked] >= 0).any() and (found[rays.asked] < 0).any()
    np.testing.assert_array_equal(found, np.where(rays.asked, expected, -1))


def test_device_uses_no_more_than_it_is_told():
    with embree.Device(1, "avx2") as narrow, embree.Device(1) as device:
        assert narrow.width == min(device.width, 8)
        assert device.version.startswith("4.")


def test_denormals_are_back_after_a_trace(scene):
    @kernel
    def register():
        return control()

    rays = rays_through(1.0)
    before = register()
    embree_rays.trace(scene, embree_rays.write(rays, packets(rays, "pixels")), threads=1)
    assert register() == before and not before & FLUSH
