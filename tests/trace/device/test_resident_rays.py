"""Rays in arrays on devices: the hits of the same rays on the host, in arrays on the device."""

import numpy as np
import pytest

from antumbra.base.errors import InputError
from antumbra.devices.arrays import DeviceArray
from antumbra.engine.device_tracers import device_tracer
from antumbra.engine.engine import Engine
from antumbra.trace.device import settling
from cutout_scenes import scene_with_cutouts
from devices import opened
from truths import soup_scene


@pytest.fixture(scope="module", params=["host", "opencl"])
def device(request):
    opened(request.param)
    return device_tracer(f"{request.param}:0").device


def on(device, array):
    """An array, copied to a device."""
    array = np.ascontiguousarray(array)
    return DeviceArray(device.upload(array), array.shape, array.dtype, device.queue)


def rays_in(scene, shape, seed=1):
    low, high = np.asarray(scene.bounds)
    origins, targets = low + np.random.default_rng(seed).random((2, *shape, 3)) * (high - low)
    targets.reshape(-1, 3)[:20] = scene.triangles().vertices[3, 1] + scene.origin  # a corner
    return origins, targets


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("cull_faces", [None, "back"])
def test_arrays_on_the_device_have_the_hits_of_arrays_on_the_host(device, dtype, cull_faces):
    scene = soup_scene(3)
    engine, (origins, targets) = Engine(scene, device=device.name), rays_in(scene, (4, 50))
    origins, targets = origins.astype(dtype), targets.astype(dtype)
    directions, here = (targets - origins).astype(dtype), {"cull_faces": cull_faces}
    blocked = engine.occluded(on(device, origins), targets=on(device, targets), **here)
    assert isinstance(blocked, DeviceArray) and blocked.shape == (4, 50) and blocked.dtype == bool
    np.testing.assert_array_equal(blocked.numpy(), scene.occluded(origins, targets=targets, **here))
    assert 0 < blocked.numpy().mean() < 1
    here |= {"tmin": 0.25, "tmax": 2.0}
    ours = engine.closest_hit(on(device, origins), on(device, directions), **here)
    theirs = scene.closest_hit(origins, directions, **here)
    for name in ("t", "face", "u", "v"):
        np.testing.assert_array_equal(getattr(ours, name).numpy(), getattr(theirs, name))
    again = engine.occluded(on(device, origins), on(device, directions), **here)
    np.testing.assert_array_equal(again.numpy(), theirs.face >= 0)


def test_numbers_that_the_device_cannot_round_come_from_the_cpu(device, monkeypatch):
    scene = soup_scene(3)
    engine, (origins, targets) = Engine(scene, device=device.name), rays_in(scene, (100,))
    sizes, numbers_of = [], settling.numbers_of
    monkeypatch.setattr(settling, "numbers_of", lambda *x: sizes.append(len(x[0])) or numbers_of(*x))
    origins = origins.astype(np.float32) + np.float32(1e-7)  # differences that float64 does not hold
    origins[::2] *= np.float32(1e-20)
    directions = (targets - origins).astype(np.float32)
    ours, theirs = (
        engine.closest_hit(on(device, origins), on(device, directions)),
        scene.closest_hit(origins, directions),
    )
    np.testing.assert_array_equal(ours.t.numpy(), theirs.t)
    assert sum(sizes) > 0


def test_one_point_on_the_host_serves_all_rays(device):
    scene = soup_scene(3)
    engine, (origins, targets) = Engine(scene, device=device.name), rays_in(scene, (60,))
    blocked = engine.occluded(on(device, origins), targets=targets[30])
    np.testing.assert_array_equal(blocked.numpy(), scene.occluded(origins, targets=targets[30]))


@pytest.mark.parametrize(
    "change, message",
    [
        ({"origins": np.full((4, 3), np.nan)}, r"origins hold NaN .*\(ray \d\)"),
        ({"directions": np.zeros((4, 3))}, "directions hold .* zero"),
        ({"origins": np.zeros((4, 2))}, r"origins must have shape \(\.\.\., 3\)"),
        ({"origins": np.zeros((4, 3), np.int32)}, "origins holds int32"),
        ({"directions": np.ones((3, 3))}, "must have one shape"),
        ({"tmin": [0.0, 0.1, 0.2, 0.3]}, "tmin must be one number"),
        ({"tmin": -1.0}, "tmin must be finite"),
        ({"skip_face": 0}, "without skip_face"),
        ({"directions": None}, "either directions or targets"),
    ],
)
def test_what_devices_do_not_take_is_refused(device, change, message):
    engine = Engine(soup_scene(3), device=device.name)
    given = {"origins": np.zeros((4, 3)), "directions": np.ones((4, 3))} | change
    given = {name: on(device, each) if isinstance(each, np.ndarray) else each for name, each in given.items()}
    with pytest.raises(InputError, match=message):
        engine.occluded(**given)


def test_cut_outs_are_hit_as_on_the_cpu(device):
    scene = scene_with_cutouts()
    engine, (origins, targets) = Engine(scene, device=device.name), rays_in(scene, (300,))
    blocked = engine.occluded(on(device, origins), targets=on(device, targets)).numpy()
    np.testing.assert_array_equal(blocked, scene.occluded(origins, targets=targets))
    ours = engine.closest_hit(on(device, origins), on(device, targets - origins))
    theirs = scene.closest_hit(origins, targets - origins)
    for name in ("t", "face", "u", "v"):
        np.testing.assert_array_equal(getattr(ours, name).numpy(), getattr(theirs, name))
    assert 0 < blocked.mean() < 1 and np.isin(theirs.face, scene.data.cutouts.faces).any()
