"""Mitsuba and Open3D give the oracle's answers on a soup."""

import numpy as np
import pytest

from antumbra.base.errors import InputError
from peer_scenes import rays_through, soup, truth
from peers import mitsuba_rays, open3d_rays
from peers.ray_contest import ORDERS, packets, valid_ids


def needed(peer):
    try:
        peer.library()
    except InputError as error:
        pytest.skip(str(error))


@pytest.mark.parametrize("coherent", [False, True])
@pytest.mark.parametrize("order", ORDERS)
def test_mitsuba(order, coherent):
    needed(mitsuba_rays)
    rays = rays_through(1.0)
    ids = valid_ids(packets(rays, order))
    scene = mitsuba_rays.MitsubaScene(soup(), robust=True)
    blocked = scene.trace(scene.write(rays, ids), coherent)
    np.testing.assert_array_equal(mitsuba_rays.occluded_of(rays, ids, blocked), truth(soup(), rays))
    assert scene.build_seconds > 0


def test_open3d():
    needed(open3d_rays)
    rays = rays_through(1.0)
    ids = valid_ids(packets(rays, "samples"))
    scene = open3d_rays.Open3DScene(soup(), 2)
    blocked = scene.trace(scene.write(rays, ids), rays.tmax, 2)
    np.testing.assert_array_equal(open3d_rays.occluded_of(rays, ids, blocked), truth(soup(), rays))
    assert scene.build_seconds > 0


@pytest.mark.parametrize("peer, module", [(mitsuba_rays, "mitsuba"), (open3d_rays, "open3d")])
def test_absence_is_told_with_its_cure(peer, module, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, module, None)
    with pytest.raises(InputError, match=r"pip install 'antumbra\[all-peers\]'"):
        peer.library.__wrapped__()


def test_the_sun_beside_radiance(run):
    small = "--boxes", 4, "--sensors", 300, "--days", "2026-03-21", "--threads", 1
    alone = run("radiance_sun", *small, without="pyradiance")
    assert [line.split()[1] for line in alone.skipped()] == ["Radiance"] and alone.rows == []
    pytest.importorskip("pyradiance", reason="Radiance is not installed: pip install 'antumbra[all-peers]'")
    assert run("radiance_sun", *small).rows == []


def test_radiometry_beside_mitsuba(run):
    small = "--size", 8, "--reference", 64, "--counts", 16
    alone = run("radiometry", *small, without="mitsuba")
    assert [line.split()[1] for line in alone.skipped()] == ["Mitsuba"] and alone.rows == []
    pytest.importorskip("mitsuba", reason="Mitsuba is not installed: pip install 'antumbra[all-peers]'")
    done = run("radiometry", *small, "--cases", "disk, d = R")
    assert [row["case"] for row in done.rows] == ["disk, d = R", "disk, d = R / 2"]
    assert all(0.0 <= row["lit"] < 2.0 and row["pixels"] > 0 for row in done.rows)
    assert all(0.0 < row["penumbra"]["4096"] < 4.0 for row in done.rows)
    assert [row["count"] for row in run("radiometry", *small, "--cases", "soft").rows] == [16]
