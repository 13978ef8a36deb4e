"""A picture whose rays are traced in bands of rows equals the picture that is traced whole."""

import numpy as np
import pytest

import antumbra as at
from antumbra.picture.renderer import Renderer
from antumbra.picture.row_bands import BAND, band_array_names, bits_of_bands

SCENE = at.procedural("atrium", triangles=2000)
H, W = 50, 44


def whole_and_bands(scene, plan, band=12, **asked):
    camera = SCENE.cameras[0].resized(W, H)
    lights = [at.SphereLight((0, 4, 0), 0.4, intensity=30.0), at.DirectionalLight((0.4, -1, 0.3), 3.0), at.Sky()]
    renderer = Renderer(scene, plan)
    whole = Renderer(scene, plan).render(camera, lights, spp=4, **asked)
    request = renderer.request(camera, lights, at.RenderOptions(spp=4, **asked))
    rows = renderer.rows(request)
    firsts = range(0, H, band)
    bands = {first: rows.band(first, min(first + band, H)) for first in reversed(firsts)}
    found = {name: np.concatenate([bands[first][name] for first in firsts]) for name in band_array_names(request)}
    return whole, renderer.from_rows(request, bits_of_bands(found))


def same(a, b) -> bool:
    if isinstance(a, (list, tuple)):
        return len(a) == len(b) and all(same(x, y) for x, y in zip(a, b))
    return np.array_equal(a, b)


@pytest.mark.parametrize(
    "plan", ["auto", "bsah+single", "srdh+single", "bsah+chcrt", "cones", "grid32+tl-lbvh+multifrusta"]
)
@pytest.mark.parametrize("asked", [{}, {"filter": True, "adaptive": 32}], ids=["plain", "adaptive"])
def test_bands_have_the_bits_of_the_whole(plan, asked):
    whole, made = whole_and_bands(SCENE, plan, **asked)
    for name in "image", "visibility", "bits", "coverage", "refined", "rays", "names":
        assert same(getattr(made, name), getattr(whole, name)), name
    assert 0.05 < np.mean([v.mean() for v in whole.visibility]) < 0.95


def test_bounced_light_and_layers():
    asked = {"bounce": 2, "filter": True, "adaptive": 16, "layers": True}
    camera, lights = SCENE.cameras[0].resized(W, H), [at.SphereLight((0, 4, 0), 0.4, intensity=30.0)]
    whole = at.render(SCENE, camera, lights, spp=4, **asked)
    renderer = Renderer(SCENE)
    request = renderer.request(camera, lights, at.RenderOptions(spp=4, **asked))
    rows = renderer.rows(request)
    bands = [rows.band(first, min(first + 20, H)) for first in range(0, H, 20)]
    made = renderer.from_rows(
        request, bits_of_bands({n: np.concatenate([b[n] for b in bands]) for n in band_array_names(request)})
    )
    for name in "image", "indirect", "visibility", "coverage":
        assert same(getattr(made, name), getattr(whole, name)), name
    assert same(tuple(made.layers), tuple(whole.layers)) and whole.indirect.any()


@pytest.mark.parametrize("step", [4, 8])
def test_bounced_light_at_sparse_pixels(step):
    camera, lights = SCENE.cameras[0].resized(50, 75), [at.SphereLight((0, 4, 0), 0.4, intensity=30.0)]
    options = at.RenderOptions(spp=4, bounce=3, bounce_step=step, filter=True, adaptive=8)
    renderer = Renderer(SCENE)
    whole = renderer.render(camera, lights, options=options)
    request = renderer.request(camera, lights, options)
    rows = renderer.rows(request)
    bands = [rows.band(first, min(first + BAND, 75)) for first in range(0, 75, BAND)]
    arrays = {n: np.concatenate([b[n] for b in bands]) for n in band_array_names(request)}
    assert arrays["indirect"].shape == (-(-75 // step), -(-50 // step), 3) and len(bands) == 3
    made = renderer.from_rows(request, bits_of_bands(arrays))
    assert same(made.indirect, whole.indirect) and same(made.image, whole.image) and whole.indirect.any()


def test_bands_of_a_store(tmp_path):
    at.build_store(SCENE, tmp_path / "a.antumbra")
    whole, made = whole_and_bands(at.load(tmp_path / "a.antumbra"), None, filter=True, adaptive=16)
    for name in "image", "visibility", "bits", "coverage":
        assert same(getattr(made, name), getattr(whole, name)), name
