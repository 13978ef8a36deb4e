"""Embree gives known answers: for a triangle, called from a kernel; and for a soup, in loops over rays and packets."""

import ctypes
import sys

import numba
import numpy as np
import pytest

import oracle
from antumbra.base.errors import InputError
from antumbra.kernels.jit import kernel
from peer_scenes import rays_through, soup, truth
from peers import embree
from peers.ray_contest import ORDERS, packets, valid_ids

pytest.importorskip("embreex", reason="Embree is not installed: pip install 'antumbra[peers]'")

TRIANGLE = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]]], np.float32)


def rays(*xy):
    """RTCRayHit records, 96 bytes each, of rays from z = -1 up through the plane z = 0."""
    records = np.zeros((len(xy), embree.HIT_WORDS), np.float32)
    records[:, :2], records[:, 2], records[:, 6], records[:, 8] = xy, -1, 1, np.inf
    records.view(np.int32)[:, [9, 17, 18, 19, 20]] = -1  # mask; no hit
    return records


@pytest.mark.parametrize("quality", embree.QUALITIES)
@pytest.mark.parametrize("faces", [None, [[0, 1, 2]]])
def test_scene_is_built_and_hit(quality, faces):
    call = embree.functions()
    intersect1, occluded1 = call.intersect1, call.occluded1

    @numba.njit
    def trace(scene, address, n, arguments, any_hit):
        for i in range(n):
            if any_hit:
                occluded1(scene, address + 96 * i, arguments)
            else:
                intersect1(scene, address + 96 * i, arguments)

    settings = embree.arguments(coherent=False)
    with embree.Device(2) as device, embree.EmbreeScene(device, TRIANGLE, faces, quality) as scene:
        assert scene.build_seconds > 0
        for any_hit in (True, False):
            records = rays((0.25, 0.25), (0.25, 0.5), (0.75, 0.75))
            trace(scene.handle, records.ctypes.data, 3, ctypes.addressof(settings), any_hit)
            hit = -np.inf if any_hit else 1.0
            assert records[:, 8].tolist() == pytest.approx([hit, hit, np.inf], rel=1e-6)


def test_sixteen_rays_at_once():
    occluded16 = embree.functions().occluded16
    block = np.zeros(1536 // 4 + 16, np.float32)  # twice an RTCRay16: without AVX-512, Embree also reads the hits
    start = -block.ctypes.data % 64 // 4
    fields = block[start : start + 192].reshape(12, 16)
    fields[0], fields[1], fields[2], fields[6], fields[8] = np.arange(16) / 8, 0.125, -1, 1, np.inf
    fields.view(np.int32)[9] = -1
    valid = np.full(32, -1, np.int32)
    at = -valid.ctypes.data % 64 // 4
    settings = embree.arguments(coherent=True)
    with embree.Device(1) as device, embree.EmbreeScene(device, TRIANGLE) as scene:
        address = lambda a: ctypes.c_void_p(a.ctypes.data)
        occluded16(address(valid[at:]), scene.handle, address(fields), ctypes.addressof(settings))
    assert (fields[8] < 0).tolist() == [True] * 8 + [False] * 8


def test_absence_is_told_with_its_cure(monkeypatch):
    monkeypatch.setitem(sys.modules, "embreex", None)
    with pytest.raises(InputError, match=r"pip install 'antumbra\[peers\]'"):
        embree.library.__wrapped__()


def test_unknown_quality_lists_the_known():
    with embree.Device(1) as device, pytest.raises(InputError, match="low, medium, high"):
        embree.EmbreeScene(device, TRIANGLE, quality="best")


# Loops over a soup: no ray is lost or mixed up


def ids_of(rays, order, lanes):
    return packets(rays, order, lanes) if lanes > 1 else valid_ids(packets(rays, order))


@pytest.fixture(params=[None, "avx2"])
def scene(request):
    with embree.Device(2, request.param) as device, embree.EmbreeScene(device, soup(), flags=embree.ROBUST) as scene:
        yield scene


@pytest.mark.parametrize("coherent", [False, True])
@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("lanes", [1, 4, 8, 16])
def test_any_hit(scene, lanes, order, coherent):
    rays = rays_through(1.0)
    records = embree.write(rays, ids_of(rays, order, lanes), threads=2)
    embree.trace(scene, records, coherent, threads=2)
    np.testing.assert_array_equal(embree.occluded_of(rays, records), truth(soup(), rays))


@pytest.mark.parametrize("lanes", [1, 4, 8, 16])
def test_nearest_hit(scene, lanes):
    rays = rays_through(np.inf)
    records = embree.write(rays, ids_of(rays, "pixels", lanes), hits=True, threads=2)
    embree.trace(scene, records, threads=2)
    _, expected = oracle.closest_hit(soup(), np.repeat(rays.origins, rays.each, 0), rays.directions)
    found = embree.faces_of(rays, records)
    assert (found[rays.active] >= 0).any() and (found[rays.active] < 0).any()
    np.testing.assert_array_equal(found, np.where(rays.active, expected, -1))


def test_device_uses_no_more_than_it_is_told():
    with embree.Device(1, "avx2") as narrow, embree.Device(1) as device:
        assert narrow.width == min(device.width, 8)
        assert device.version.startswith("4.")


def test_denormals_are_back_after_a_trace(scene):
    @kernel
    def register():
        return embree.control()

    rays = rays_through(1.0)
    before = register()
    embree.trace(scene, embree.write(rays, packets(rays, "pixels")), threads=1)
    assert register() == before and not before & embree.FLUSH
