"""Bands of rows on a device that runs out of memory: the CPU finds the surfaces, and the picture stays the same."""

import numpy as np
import pytest

import antumbra as at
from antumbra.devices.device import OutOfDeviceMemory
from antumbra.engine.device_tracers import OnDeviceTracer
from antumbra.picture.renderer import Renderer
from antumbra.picture.row_bands import band_array_names, bits_of_bands

SCENE = at.procedural("atrium", triangles=2000)
CAMERA = SCENE.cameras[0].resized(44, 50)
LIGHTS = [at.SphereLight((0, 4, 0), 0.4, intensity=30.0), at.Sky()]
OPTIONS = at.RenderOptions(spp=4, filter=True, adaptive=32)


@pytest.mark.parametrize("plan", ["bsah+device:host:0", "grid32+lbvh+device:host:0"])
@pytest.mark.parametrize("last", [1, 6], ids=["first band", "later band"])
def test_memory_that_ends_in_a_band(plan, last, monkeypatch):
    whole, calls, trace = (
        Renderer(SCENE, "bsah+single").render(CAMERA, LIGHTS, options=OPTIONS),
        [],
        OnDeviceTracer.trace,
    )

    def tight(self, *arguments, **keywords):
        calls.append(self)
        if len(calls) == last:
            raise OutOfDeviceMemory("full", 1, 0)
        return trace(self, *arguments, **keywords)

    monkeypatch.setattr(OnDeviceTracer, "trace", tight)
    renderer = Renderer(SCENE, plan)
    request = renderer.request(CAMERA, LIGHTS, OPTIONS)
    rows = renderer.rows(request)
    bands = [rows.band(first, min(first + 12, 50)) for first in range(0, 50, 12)]
    assert len(calls) > last and renderer.source.gbuffer == "raster"
    arrays = {name: np.concatenate([band[name] for band in bands]) for name in band_array_names(request)}
    made = renderer.from_rows(request, bits_of_bands(arrays))
    for name in "image", "visibility", "bits":
        np.testing.assert_array_equal(getattr(made, name), getattr(whole, name))
    assert 0.05 < np.mean(whole.visibility) < 0.95


def test_an_error_for_which_the_cpu_sees_already_is_raised(monkeypatch):
    def refuse(self, *arguments, **keywords):
        raise OutOfDeviceMemory("full", 1, 0)

    monkeypatch.setattr(OnDeviceTracer, "trace", refuse)
    renderer = Renderer(SCENE, "bsah+device:host:0")
    rows = renderer.rows(renderer.request(CAMERA, LIGHTS, OPTIONS))
    with pytest.raises(OutOfDeviceMemory, match="full"):
        rows.band(0, 12)
