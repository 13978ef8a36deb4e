"""The appearance that a picture sees has the same rows for a store as for the scene in memory."""

import numpy as np
import pytest

import antumbra as at
from antumbra.picture.frame import FrameState
from antumbra.picture.frame_passes import evaluate, find_and_trace
from antumbra.picture.seen_appearance import seen_appearance
from looks_scenes import CAMERA, FILES, LIGHTS


def seen(scene):
    renderer = at.Renderer(scene)
    state = FrameState(renderer.engine, renderer.request(CAMERA, LIGHTS[:1], at.RenderOptions(spp=1)))
    evaluate(state)
    surfaces, tracer = find_and_trace(state)[0], state.tracer
    found = seen_appearance(tracer.scene, tracer.memory, surfaces.triangles, state.request.options, 2)
    return found, surfaces


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("name", FILES)
def test_pixels_and_triangles_have_the_rows_of_their_faces(tmp_path, name):
    FILES[name](tmp_path, name)
    scene = at.load(tmp_path / name)
    at.build_store(scene, tmp_path / "a.antumbra")
    (a, in_memory), (b, in_store) = seen(scene), seen(at.load(tmp_path / "a.antumbra"))
    hit = in_memory.ids >= 0
    assert (in_memory.ids == in_store.ids).all() and hit.mean() > 0.2 and a.is_varied and b.is_varied
    pixels_a, pixels_b = a.of_pixels(in_memory), b.of_pixels(in_store)
    assert (pixels_b[~hit] == -1).all() and len(b.appearance.uv) < len(a.appearance.uv)
    rows, faces = b.rows(in_store.triangles), a.rows(in_memory.triangles)
    assert len(rows) == len(in_store.triangles.face_id) and (faces == in_memory.triangles.face_id).all()
    for of in ("uv", "normals", "bends", "textured"):
        assert np.array_equal(getattr(a.appearance, of)[pixels_a[hit]], getattr(b.appearance, of)[pixels_b[hit]]), of


def test_plain_scenes_have_none(tmp_path):
    scene = at.procedural("cellar", triangles=2000)
    triangles, options = scene.triangles(), at.RenderOptions()
    assert seen_appearance(scene.data, None, triangles, options, 1) is None
