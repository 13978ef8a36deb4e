"""Terrain is tinted by height in pictures and pages; its own colours, studies and bits stay as they are."""

from pathlib import Path

import numpy as np
import pytest

import antumbra as at
from antumbra.scene.height_tints import height_tints

PLACE = (2.0, 0.0, 80_000.0, 0.0, -2.0, 450_000.0)
SLOPE = np.linspace(0.0, 20.0, 12)[:, None] + np.zeros(10)  # rises towards the south


def picture_of(scene, **options):
    camera = scene.default_camera(48, 32, "top")
    return at.render(scene, camera, scene.default_lights(), spp=1, layers=True, **options)


def test_the_lowest_and_the_highest_point_have_the_ends_of_the_ramp():
    data = at.from_raster((SLOPE, PLACE)).data
    points = data.triangles().vertices
    tints, heights = height_tints(data, points), points[..., 2] + data.origin[2]
    low, high = tints[heights == heights.min()], tints[heights == heights.max()]
    assert (low == low[0]).all() and (high == high[0]).all()
    assert low[0].argmax() == 1 and high[0].min() > low[0].max()  # green below, near white above


def test_equal_heights_have_equal_colours_and_the_place_on_the_map_does_not_matter():
    data = [at.from_raster((SLOPE, (2.0, 0.0, west, 0.0, -2.0, 450_000.0))).data for west in (0.0, 80_000.0)]
    first, second = (height_tints(each, each.triangles().vertices) for each in data)
    assert np.array_equal(first, second) and len(np.unique(first.reshape(-1, 3), axis=0)) > 8


def test_level_terrain_has_one_colour():
    data = at.from_raster((np.full((4, 5), 7.0), PLACE)).data
    assert len(np.unique(height_tints(data, data.triangles().vertices).reshape(-1, 3), axis=0)) == 1


def test_pictures_show_the_tints_of_the_points_that_they_see_and_scenes_keep_their_colour():
    scene = at.from_raster((SLOPE, PLACE))
    frame = picture_of(scene)
    seen = frame.gbuffer.face >= 0
    assert seen.any() and not seen.all()
    tints = height_tints(scene.data, frame.gbuffer.position)
    assert np.array_equal(frame.layers.albedo[seen], tints[seen])
    assert not frame.layers.albedo[~seen].any()
    assert len(np.unique(scene.colours, axis=0)) == 1


@pytest.mark.parametrize("options", [{"materials": "diffuse"}, {"textures": False}], ids=str)
def test_measured_pictures_have_the_colour_of_the_scene(options):
    scene = at.from_raster((SLOPE, PLACE))
    frame = picture_of(scene, **options)
    assert (frame.layers.albedo[frame.gbuffer.face >= 0] == scene.colours[0]).all()


@pytest.mark.parametrize("name, options", [("hills.antumbra", {}), ("hills.tiles", {"tile": 9_000})])
def test_a_store_or_tiles_of_a_raster_have_its_picture(name, options, tmp_path):
    pytest.importorskip("rasterio", reason="stores of rasters are NOT compared without rasterio")
    scene = at.load(at.examples.file_of("hills"))
    at.build_store([at.examples.file_of("hills")], tmp_path / name, **options)
    assert len(list(Path(tmp_path).glob("*.antumbra"))) > (1 if options else 0)
    stored = at.load(tmp_path / name)
    camera = scene.default_camera(48, 32)
    frames = [at.render(each, camera, scene.default_lights(), spp=1) for each in (scene, stored)]
    assert np.array_equal(frames[0].gbuffer.face >= 0, frames[1].gbuffer.face >= 0)
    assert np.array_equal(frames[0].image, frames[1].image)


def test_terrain_has_the_tints_of_its_heights_after_an_update():
    scene = at.from_raster((SLOPE, PLACE))
    before = picture_of(scene)
    scene.update(transform=np.diag([1.0, 1.0, 2.0, 1.0]))
    after = picture_of(scene)
    seen = after.gbuffer.face >= 0
    tints = after.layers.albedo[seen]
    assert np.array_equal(tints, height_tints(scene.data, after.gbuffer.position)[seen])
    assert len(np.unique(tints, axis=0)) == len(np.unique(before.layers.albedo[seen], axis=0)) > 8


def test_two_surfaces_share_a_ramp():
    ground = at.from_raster((SLOPE, PLACE), ground=(SLOPE - 5.0, PLACE))
    assert ground.data.terrain is None
    frame = picture_of(ground)
    seen = frame.gbuffer.face >= 0
    assert np.array_equal(frame.layers.albedo[seen], height_tints(ground.data, frame.gbuffer.position)[seen])


def test_scenes_with_colours_of_their_own_have_no_tints():
    city = at.procedural("city", triangles=2_000).data
    assert not city.of_heights and height_tints(city, city.triangles().vertices) is None


def test_terrain_below_a_model_keeps_the_plain_colour():
    roofs = at.Scene.from_arrays([[0, 0, 30], [9, 0, 30], [0, 9, 30]], [[0, 1, 2]], up="z")
    scene = at.changed_scene(at.from_raster((SLOPE, PLACE)), add=[(roofs, (80_005.0, 449_990.0, 0.0))])
    frame = picture_of(scene)
    assert len(np.unique(frame.layers.albedo[frame.gbuffer.face >= 0], axis=0)) <= 2
