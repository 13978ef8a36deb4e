"""Scenes in memory and in stores supply a `Renderer` by one protocol. No tree gets queries that it cannot answer."""

import subprocess
import sys

import numpy as np
import pytest

import antumbra as at
from antumbra.engine import accelerator, tree_choice
from antumbra.engine.sources.in_memory_source import InMemory
from antumbra.engine.sources.paged_source import Paged
from antumbra.engine.sources.source_protocols import (
    CameraSource,
    FixedTree,
    Geometry,
    HitSource,
    Memory,
    RayListSource,
    RenderSource,
)
from antumbra.picture.renderer import Renderer
from stores import built


@pytest.fixture(scope="module")
def both(tmp_path_factory):
    """(scene in memory, the same in a store)."""
    scene = at.procedural("atrium", triangles=2000)
    return scene, at.load(built(tmp_path_factory.mktemp("sources"), scene).path)


def names_of(*protocols):
    """The public members of protocols."""
    names = {name for each in protocols for name in {*vars(each), *each.__annotations__} if name[0] != "_"}
    assert names
    return names


def test_both_sources_have_all_of_the_protocol(both):
    for scene, kind in zip(both, (InMemory, Paged)):
        source = Renderer(scene).source
        assert type(source) is kind and names_of(RenderSource, CameraSource) <= set(dir(source))
        assert source.scene is scene.data and str(Renderer(scene).plan) == kind.default_plan
        assert (source.geometry is None) == (source.fixed is not None) == (source.memory is not None) == (kind is Paged)
        offers = {RayListSource: source.ray_lists, HitSource: source.ray_lists}
        offers |= {Geometry: source.geometry} if source.fixed is None else {FixedTree: source.fixed}
        offers |= {} if source.memory is None else {Memory: source.memory}
        for protocol, offered in offers.items():
            assert names_of(protocol) <= set(dir(offered)), protocol


@pytest.mark.parametrize("plan", ["auto", "lbvh+single", "bsah+multifrusta", "bsah+reinsert+wide", "bsah+chcrt"])
def test_later_frames_build_no_tree(plan, monkeypatch):
    built, build = [], tree_choice.new_tree
    for module in (accelerator, tree_choice):
        monkeypatch.setattr(module, "new_tree", lambda *arguments: built.append(1) or build(*arguments))
    scene = at.procedural("atrium", triangles=2000)
    renderer, camera = Renderer(scene, plan), scene.cameras[0].resized(24, 20)
    frames = [renderer.render(camera, scene.lights, spp=4) for _ in range(3)]
    assert len(built) == 1 and all(np.array_equal(frames[0].visibility, each.visibility) for each in frames)
    scene.update(scene.triangles().vertices * [1.0, 0.8, 1.0])
    moved = renderer.render(camera, scene.lights, spp=4)
    assert len(built) == 2 and not np.array_equal(moved.visibility, frames[0].visibility)


def test_only_stores_count_what_the_camera_sees_and_what_is_read(both):
    camera = both[0].cameras[0].resized(24, 20)
    for scene, looks in zip(both, (0, 1)):
        calls, renderer = [], Renderer(scene, None, 2)
        frame = renderer.render(camera, scene.lights, spp=1, progress=lambda *call, to=calls: to.append(call))
        assert sum(done == total for done, total in calls) == 1 + looks == 1 + renderer.source.looks
        assert (frame.paging is None) == (looks == 0)


@pytest.mark.parametrize("gbuffer", ["raster", "rays"])
def test_a_tracer_that_remembers_takes_trees_that_are_made_for_shown_rays(both, gbuffer):
    """Camera rays and diffuse rays then have a separate tree, which keeps no state."""
    scene = both[0]
    camera, options = scene.cameras[0].resized(24, 20), {"spp": 2, "bounce": 2, "threads": 2, "gbuffer": gbuffer}
    one, other = (at.render(scene, camera, plan=plan, **options) for plan in ("srdh+chcrt", "bsah+single"))
    np.testing.assert_array_equal(one.image, other.image)
    assert one.indirect.any() and one.scheduled and other.scheduled is None


def test_who_has_all_in_memory_does_not_wait_for_stores():
    code = "import sys, antumbra.picture.renderer; print(*(m for m in sys.modules if m.startswith('antumbra.store')))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert set(done.stdout.split()) <= {
        "antumbra.store",
        "antumbra.store.store_format",
    }  # the suffix of stores, for `load`
