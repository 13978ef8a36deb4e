"""A process that makes one picture compiles the kernels of the default fixed plan; later ones compile the rest."""

import numpy as np
import pytest

import antumbra as at
from antumbra.engine import precompilation
from antumbra.engine.auto.cost_model import choose_builder
from antumbra.engine.auto.one_picture import LIMITS, Few, few
from antumbra.engine.plan import Plan, parse_plan
from antumbra.engine.plan_records import kernels_of_plan, one_picture, precompile_plan

AUTO, FIXED = parse_plan("auto"), Plan()


@pytest.fixture
def disk(monkeypatch):
    """The kernels on disk, at first none; compiling one adds it."""
    found = set()
    monkeypatch.setattr(precompilation, "missing_of", lambda kernels: set(kernels) - found)
    monkeypatch.setattr(precompilation, "_compile", lambda missing, levels, what: found.update(missing))
    precompile_plan.cache_clear()
    yield found
    precompile_plan.cache_clear()


@pytest.mark.parametrize("counters", [False, True])
@pytest.mark.parametrize("gbuffer", ["raster", "rays"])
def test_the_first_picture_compiles_only_the_default_fixed_plan(disk, gbuffer, counters):
    fixed, auto = kernels_of_plan(FIXED, gbuffer, False), kernels_of_plan(AUTO, gbuffer, counters)
    with one_picture():
        assert not precompile_plan(AUTO, gbuffer, counters)
        assert disk == fixed and few() == Few(FIXED.trace, FIXED.build)
        assert {choose_builder(10**n, 0.0, False) for n in range(7)} == {FIXED.build}
    assert few() is None and auto - fixed
    with one_picture():  # as in a later process
        assert not precompile_plan(AUTO, gbuffer, counters)
        assert few() is None and disk >= auto


def test_only_a_single_picture_by_auto_limits_its_choices(disk):
    precompile_plan(AUTO, "raster")
    assert few() is None and disk == kernels_of_plan(AUTO, "raster", False)
    disk.clear()
    precompile_plan.cache_clear()
    with one_picture():
        precompile_plan(parse_plan("bsah+single"), "raster")
        assert few() is None


def test_an_error_ends_the_limit(disk):
    with pytest.raises(ZeroDivisionError), one_picture():
        precompile_plan(AUTO, "raster")
        raise ZeroDivisionError
    assert few() is None and not LIMITS.makes_one_picture


@pytest.fixture
def limited(monkeypatch):
    monkeypatch.setattr(LIMITS, "few", Few(FIXED.trace, FIXED.build))


@pytest.mark.parametrize(
    "light",
    [
        at.QuadLight(corner=(-1, 7, -1), u=(2, 0, 0), v=(0, 0, 2), intensity=200),
        at.PointLight((0.0, 3.0, 0.0), intensity=10),
        at.DirectionalLight((1, -2, 1)),
        at.AmbientOcclusion(2.0),
    ],
    ids=lambda light: type(light).__name__,
)
def test_a_limited_auto_gives_the_same_bits(limited, light):
    scene = at.procedural("atrium", triangles=2_000)
    camera = scene.cameras[0].resized(48, 32)
    frame = at.render(scene, camera, [light], spp=4)
    tracer = "packet16" if isinstance(light, at.AmbientOcclusion) else "multifrusta"  # which does not suit all
    assert frame.plan == f"bsah+{tracer}"
    other = at.render(scene, camera, [light], spp=4, plan="bsah+single")
    assert 0 < np.mean(frame.visibility[0]) < 1
    assert all(np.array_equal(a, b) for a, b in zip(frame.bits, other.bits, strict=True))
