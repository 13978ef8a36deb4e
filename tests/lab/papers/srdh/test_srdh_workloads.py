"""The lightings of SRDH's scenes: opposed lights, lamps, ambient occlusion and a sky."""

import numpy as np
import pytest

import antumbra as at
from antumbra.base.errors import InputError
from antumbra.engine.accelerator import Accelerator
from antumbra.lab.bench_parts import BenchParts
from antumbra.lab.papers.benchmark_views import BenchmarkView, scene_view
from antumbra.lab.papers.srdh import srdh_measurements
from antumbra.lab.papers.srdh.srdh_published import Lighting, SrdhTable
from antumbra.lab.papers.srdh.srdh_workloads import NAMES, RELIT, lit_view, workloads
from antumbra.scene.lights import AmbientOcclusion
from antumbra.scene.sky import Sky


@pytest.fixture(scope="module")
def view() -> BenchmarkView:
    return scene_view("atrium", at.procedural("atrium", triangles=3000), (24, 24))


def middle(light):
    return light.corner + (light.u + light.v) / 2


@pytest.mark.parametrize("lighting", list(Lighting))
def test_every_lighting_lights_a_part_of_what_is_seen(view, lighting):
    lit = lit_view(view, lighting)
    assert lit.name == f"atrium{NAMES[lighting]}" and lit.scene is view.scene and lit.camera is view.camera
    for light in lit.lights:
        share = at.render(lit.scene, lit.camera, [light], spp=4).visibility[0].mean()
        assert 0.02 < share < 0.98


def test_opposed_lights_are_distant_and_on_both_sides(view):
    centre, right = view.scene.bounds.mean(0), view.camera.axes[0]
    diagonal = np.linalg.norm(np.ptp(view.scene.bounds, axis=0))
    ways = [(middle(light) - centre) / diagonal for light in lit_view(view, Lighting.opposed).lights]
    assert [np.round(way @ right, 6) for way in ways] == [-round(0.5**0.5, 6), round(0.5**0.5, 6)]
    for way, light in zip(ways, lit_view(view, Lighting.opposed).lights):
        assert np.linalg.norm(way) == pytest.approx(1.0) and way[1] == pytest.approx(0.5**0.5)
        assert abs(light.u @ way) < 1e-6 * diagonal and light.area() == pytest.approx((diagonal / 10) ** 2)


def test_four_lamps_are_as_large_as_the_usual_one(view):
    lamps = lit_view(view, Lighting.lamps).lights
    diagonal = np.linalg.norm(np.ptp(view.scene.bounds, axis=0))
    assert len(lamps) == 4 and sum(lamp.area() for lamp in lamps) == pytest.approx((diagonal / 10) ** 2)
    assert all(abs(np.cross(lamp.u, lamp.v)[1]) == pytest.approx(lamp.area()) for lamp in lamps)  # they are level


def test_ambient_occlusion_and_sky(view):
    (ambient,), (sky,) = (lit_view(view, each).lights for each in (Lighting.ambient, Lighting.sky))
    assert isinstance(ambient, AmbientOcclusion) and isinstance(sky, Sky)
    assert ambient.radius == pytest.approx(np.linalg.norm(np.ptp(view.scene.bounds, axis=0)) / 10)


def test_default_and_chosen_lightings(view):
    other = view._replace(name="blinds")
    assert [w.name for w in workloads([view, other], None)] == [
        *(f"atrium{NAMES[x]}" for x in RELIT["atrium"]),
        "blinds",
    ]
    assert [w.name for w in workloads([other], [Lighting.sky])] == ["blinds, sky"]
    with pytest.raises(InputError, match="atrium, sky would be measured twice"):
        workloads([view], [Lighting.sky, Lighting.sky])


@pytest.fixture(scope="module")
def rows(view):
    views = workloads([view], [Lighting.own, Lighting.opposed, Lighting.ambient])
    parts, effort = BenchParts({table: {} for table in SrdhTable}), srdh_measurements.SrdhEffort(1, (16, 16), 1, 2)
    srdh_measurements.add_views(parts, views, effort, lambda text: None, None)
    return srdh_measurements.rows_of(parts)


def test_further_lightings_have_fewer_pixels_and_pre_renders(rows):
    names = ["atrium", "atrium, two opposed lights", "atrium, ambient occlusion"]
    assert srdh_measurements.scenes_of(rows.counts) == names == [check.scene for check in rows.rtsah]
    assert [row.scene for row in rows.memory] == ["atrium"]
    assert [row.scene for row in rows.builds[::2]] == names == list(dict.fromkeys(row.scene for row in rows.renders))
    pixels = {name: {row.pixels for row in rows.counts if row.scene == name} for name in names}
    assert pixels["atrium"] == {None, *srdh_measurements.PIXELS} and pixels[names[1]] == pixels[names[2]] == {None, 16}
    rays = [srdh_measurements.of(rows.counts, name, srdh_measurements.BASE).rays for name in names]
    assert rays[1] > rays[2] and rays[0] > 2 * rays[2]  # two lights and one, with a quarter of the pixels
    assert len({(gain.scene, gain.tracer) for gain in srdh_measurements.gains(rows.renders)}) == 3 * len(
        srdh_measurements.TRACERS
    )


def test_kernel_gains(rows):
    gains = srdh_measurements.kernel_gains(rows.counts, rows.trees)
    assert [gain.scene for gain in gains] == srdh_measurements.scenes_of(rows.counts)
    first, total = gains[0], lambda method: srdh_measurements.of(rows.counts, "atrium", method).total
    assert first.distance == total(srdh_measurements.DISTANCE) / total(srdh_measurements.CONSTANT) - 1 != 0
    assert first.both == total(srdh_measurements.PUBLISHED) / total(srdh_measurements.CONSTANT) - 1
    assert all(0 < gain.chosen < 1 for gain in gains)


def test_savings(rows):
    saved = srdh_measurements.savings(rows.counts)
    assert len(saved) == 3 * 2 and all(-1 < row["beyond_all"] < 1 and row["random"] < 1 for row in saved)
    ours = next(row for row in saved if (row["scene"], row["method"]) == ("atrium", srdh_measurements.OURS))
    assert ours["rtsah"] == srdh_measurements.saved(
        rows.counts, srdh_measurements.of(rows.counts, "atrium", srdh_measurements.OURS), "rtsah"
    )


def test_every_timed_picture_builds_its_tree(view, monkeypatch):
    """A renderer keeps the tree of a still scene, so that its build would be timed once."""
    built, execute = [], Accelerator.execute
    monkeypatch.setattr(Accelerator, "execute", lambda self, *args: built.append(self) or execute(self, *args))
    small = view._replace(camera=view.camera.resized(16, 16))
    rows = srdh_measurements.render_times(small, 2, 2, lambda text: None)
    assert len(built) == 3 * len(rows) == 24  # two rounds, and one before them
