"""Scenes from above: walls as lines, each once, and hillshades that agree with closed forms."""

import numpy as np
import pytest

import antumbra as at
import city_files
from antumbra.city.sheets.map_frame import Extent
from antumbra.city.sheets.scene_plan import brightness, hillshade, outlines_of, shaded
from sheet_cases import slab

FLAT = 0.5**0.5  # shade of a horizontal surface


def block(up="z", unit="m", turned=False, extra=()):
    """A block of 10 x 6, 4 m high, whose walls are two triangles each, and a kerb of 0.2 m beside it."""
    corners = np.array([slab(0, 0, 10, 6, 0, 4), slab(20, 0, 30, 6, 0, 0.2)]).reshape(-1, 3)
    scale = 1.0 / at.Scene.from_arrays(np.eye(3)[None], unit=unit).unit.metres
    if turned:
        corners = corners[:, [1, 0, 2]] * [-1.0, 1.0, 1.0]
    if up == "y":
        corners = np.stack([corners[:, 0], corners[:, 2], -corners[:, 1]], 1)
    return at.Scene.from_arrays(corners.reshape(-1, 3, 3) * scale, up=up, unit=unit), scale


def sides(lines):
    return {tuple(sorted(map(tuple, np.round(line, 6).tolist()))) for line in lines}


@pytest.mark.parametrize("up", ["y", "z"])
@pytest.mark.parametrize("unit", ["m", "us-ft", "mm"])
def test_the_outline_of_a_block_is_its_four_walls(up, unit):
    scene, scale = block(up, unit)
    lines = outlines_of(scene) / scale
    ring = [(0, 0), (10, 0), (10, 6), (0, 6)]
    assert len(lines) == 4 and np.abs(lines - np.round(lines)).max() < 1e-3
    assert sides(np.round(lines)) == {tuple(sorted((ring[k], ring[k - 1]))) for k in range(4)}


def test_outlines_turn_with_the_scene():
    plain, turned = outlines_of(block()[0]), outlines_of(block(turned=True)[0])
    assert sides(plain[..., ::-1] * [-1.0, 1.0]) == sides(turned) and len(turned) == 4


def test_only_walls_in_the_extent_are_outlines():
    assert len(outlines_of(block()[0], Extent(-1, -1, 1, 1))) == 2
    assert len(outlines_of(block()[0], Extent(40, 40, 50, 50))) == 0


def test_outlines_of_a_city_are_those_of_its_buildings(tmp_path):
    text = city_files.city(
        {
            "house": city_files.building(city_files.solid()),
            "tree": {**city_files.building(city_files.solid()), "type": "SolitaryVegetationObject"},
        },
        vertices=city_files.CUBE * 4,
    )
    both = at.load(city_files.put(tmp_path, text, "a.city.json"))
    del text["CityObjects"]["tree"]
    one = at.load(city_files.put(tmp_path, text, "b.city.json"))
    assert len(outlines_of(both)) == len(outlines_of(one)) == 4 and both.n_triangles > one.n_triangles


def test_a_raster_of_heights_has_no_outlines():
    dem = at.from_raster((np.add.outer(np.arange(5.0), 50 * np.arange(5.0)), (1.0, 0, 0, 0, -1.0, 5.0), "EPSG:28992"))
    assert len(outlines_of(dem)) == 0


def test_shades_of_planes_agree_with_their_normals():
    x, y = np.meshgrid(np.arange(8.0), np.arange(6.0)[::-1])
    light = np.array([-0.5, 0.5, FLAT])
    for slope_x, slope_y in ((0.0, 0.0), (0.5, 0.0), (0.0, -0.8), (-1.0, 1.0)):
        normal = np.array([-slope_x, -slope_y, 1.0]) / np.sqrt(1.0 + slope_x**2 + slope_y**2)
        shade = shaded(slope_x * 2.0 * x + slope_y * 3.0 * y, 2.0, 3.0)
        assert shade == pytest.approx(np.full(x.shape, max(normal @ light, 0.0)))


def test_hillshades_of_a_quarter_turn_have_the_light_of_the_map():
    dem = np.add.outer(np.zeros(20), 0.8 * np.arange(20.0))  # rises to the east
    shades = []
    for heights in (dem, np.rot90(dem)):  # to the east, and to the north: away from the light, and towards it
        scene = at.from_raster((heights, (1.0, 0.0, 0.0, 0.0, -1.0, 20.0), "EPSG:28992"))
        shade = hillshade(scene, Extent(2, 2, 18, 18), 16, 16)
        assert np.ptp(shade) < 1e-3
        shades.append(shade.mean())
    east, north = np.array([-0.8, 0, 1]) / np.sqrt(1.64), np.array([0, -0.8, 1]) / np.sqrt(1.64)
    light = np.array([-0.5, 0.5, FLAT])
    assert shades == pytest.approx([east @ light, north @ light], abs=1e-4)


def test_the_outer_half_of_cells_has_the_shade_of_its_surface():
    dem = np.add.outer(np.zeros(9), 0.8 * np.arange(9.0))
    scene = at.from_raster((dem, (1.0, 0.0, 0.0, 0.0, -1.0, 9.0), "EPSG:28992"))
    shade = hillshade(scene, Extent(-3, 0, 9, 9), 120, 90)
    assert np.isnan(shade[:, :30]).all() and np.isfinite(shade[:, 30:]).all()
    assert shade[:, 40:110] == pytest.approx(np.full((90, 70), shade[45, 70]), abs=1e-6)


def test_gentle_hills_are_raised_and_level_ground_keeps_its_colour():
    gentle = 0.01 * np.add.outer(np.zeros(8), np.sin(np.arange(8.0)))
    assert np.ptp(shaded(gentle, 1.0, 1.0)) > 0.02
    assert brightness(np.full((2, 2), FLAT)) == pytest.approx(np.ones((2, 2)))
    assert brightness(np.array([np.nan]))[0] == 1.0 and brightness(np.array([0.0]))[0] < 0.5


def test_beside_the_scene_there_is_no_shade():
    scene, _ = block()
    shade = hillshade(scene, Extent(-10, 0, 10, 6), 20, 6)
    assert np.isnan(shade[:, :10]).all() and np.isfinite(shade[:, 10:]).all()
