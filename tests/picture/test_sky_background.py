"""What pictures show where no surface is seen: skies, backdrops, colours, or nothing."""

import numpy as np
import pytest
from PIL import Image

import antumbra as at
from antumbra.picture.sky_background import add_skies, sky_behind

FLOOR = at.Scene.from_arrays(
    [[-2.0, 0, -2], [2, 0, -2], [2, 0, 2], [-2, 0, 2]], [[0, 2, 1], [0, 3, 2]], colours=(0.7, 0.1, 0.1)
)
CAMERA = at.Camera((0, 3, 5), (0, 0.8, 0), width=48, height=40)
LAMP = at.PointLight((0, 2, 0), intensity=1e-4)


def rendered(tmp_path, lights, sky=True, adaptive=None, **saved) -> tuple[at.Frame, np.ndarray]:
    frame = at.render(FLOOR, CAMERA, lights, spp=4, background=sky, adaptive=adaptive, antialias=False)
    frame.save(tmp_path / "a.png", **saved)
    return frame, np.array(Image.open(tmp_path / "a.png"))


def test_without_a_sky_there_is_a_backdrop_that_sheds_no_light(tmp_path):
    frame, shown = rendered(tmp_path, LAMP)
    dark, black = rendered(tmp_path, LAMP, sky=False)
    assert dark.backdrop is None and not black[~frame.mask].any()
    assert frame.mask.any() and shown[~frame.mask].min() > 100
    assert not frame.image[~frame.mask].any()
    np.testing.assert_array_equal(frame.image, dark.image)
    np.testing.assert_array_equal(shown[frame.mask], black[frame.mask])
    y, x = np.argwhere(~frame.mask).T
    assert shown[y[y == y.min()], x[y == y.min()], 2].mean() > shown[y[y == y.min()], x[y == y.min()], 0].mean()


def test_no_exposure_changes_a_backdrop(tmp_path):
    frame, shown = rendered(tmp_path, LAMP, exposure=1.0)
    frame.save(tmp_path / "b.png", exposure=1e4)
    bright = np.array(Image.open(tmp_path / "b.png"))
    np.testing.assert_array_equal(shown[~frame.mask], bright[~frame.mask])
    assert bright[frame.mask].mean() > shown[frame.mask].mean() + 20


def test_a_backdrop_shines_through_the_edges(tmp_path):
    frame, shown = rendered(tmp_path, LAMP, adaptive=16)
    _, black = rendered(tmp_path, LAMP, adaptive=16, sky=False)
    edge = (frame.coverage > 0.3) & (frame.coverage < 0.7)
    assert edge.any() and (shown[edge, 2].astype(int) > black[edge, 2] + 20).all()
    assert shown[edge, 2].max() < shown[frame.coverage == 0, 2].min()


def test_a_sky_and_a_colour_win(tmp_path):
    frame, _ = rendered(tmp_path, [LAMP, at.Sky((0.2, 0.2, 0.2))])
    assert frame.backdrop is None and np.allclose(frame.image[~frame.mask], 0.2)
    frame, shown = rendered(tmp_path, LAMP, background=(0.0, 1.0, 0.0))
    assert (shown[~frame.mask] == (0, 255, 0)).all()
    frame, shown = rendered(tmp_path, LAMP, background="transparent")
    assert (shown[..., 3] == 255 * frame.mask).all()


@pytest.mark.parametrize("up", ["y", "z"])
def test_the_horizon_is_level(up):
    turned = at.Scene.from_arrays([[0.0, 0, 0], [1, 0, 0], [0, 1, 1]], up=up)
    along, above = ((0, 0, -1), (0, 1, 0)) if up == "y" else ((0, 1, 0), (0, 0, 1))
    camera = at.Camera((9, 9, 9), np.add((9, 9, 9), along), above, 90, 32, 32)
    frame = at.render(turned, camera, LAMP)
    assert not frame.mask.any() and np.ptp(frame.backdrop[15:17], axis=1).max() < 0.05
    assert frame.backdrop[15].mean() > 1.1 * max(frame.backdrop[0].mean(), frame.backdrop[-1].mean())


def test_nothing_is_kept_where_surfaces_fill_the_picture():
    down = at.Camera((0, 1, 0), (0, 0, 0), up=(0, 0, -1), width=8, height=8)
    assert at.render(FLOOR, down, LAMP).backdrop is None


@pytest.mark.parametrize("columns", [1, 12])
def test_the_background_is_the_radiance_of_its_skies(columns):
    """A map of one column or of many, turned and coloured, in all directions of a wide camera."""
    rng = np.random.default_rng(columns)
    sky = at.Sky(rng.random((6, columns, 3)), turn=40.0, intensity=2.0, colour=(1, 0.5, 0.25), up="z")
    rays = at.Camera((0, 0, 0), (1, 2, 0.3), (0, 0, 1), 140, 48, 32).rays(np.zeros(3))
    mask = rng.random((32, 48)) < 0.5
    image = np.zeros((32, 48, 3), np.float32)
    add_skies([sky, sky], rays, mask, image, 2)
    np.testing.assert_allclose(image[mask], 2 * sky_behind([sky], rays, *np.nonzero(mask)), rtol=1e-3)
    assert mask.any() and not image[~mask].any()


def model(albedo: float) -> at.Scene:
    """A tetrahedron, which is shown on a ground."""
    corners = [[-1.0, 0, 1], [1, 0, 1], [0, 0, -1], [0, 1.5, 0]]
    return at.Scene.from_arrays(corners, [[0, 1, 3], [1, 2, 3], [2, 0, 3], [0, 2, 1]], colours=(albedo,) * 3)


def on_ground(tmp_path, albedo: float, lights=None, exposure=None) -> tuple[at.Frame, np.ndarray]:
    scene = model(albedo)
    camera = scene.default_camera(48, 48)
    frame = at.render(scene, camera, lights or scene.default_lights(), ground=True, spp=4)
    frame.save(tmp_path / "a.png", exposure=exposure)
    return frame, np.array(Image.open(tmp_path / "a.png")).astype(int)


def test_ground_and_shadow_remain_visible_below_a_dark_model(tmp_path):
    tones = {}
    for albedo in 0.9, 0.3, 0.02:
        frame, shown = on_ground(tmp_path, albedo)
        lit = frame.ground.mask & (frame.ground.lost < 0.02) & (frame.coverage == 0.0)
        dark = frame.ground.mask & (frame.ground.lost > 0.5) & (frame.coverage == 0.0)
        assert shown[lit].max() < 245 and shown[dark].mean() + 40 < shown[lit].mean()
        tones[albedo] = shown[frame.mask].mean() / shown[lit].mean()
    assert tones[0.9] > 1.2 * tones[0.3] > 1.2 * tones[0.02]


def test_a_dimmer_daylight_does_not_depend_on_exposure(tmp_path):
    frame, shown = on_ground(tmp_path, 0.3, exposure=1.2)
    _, brighter = on_ground(tmp_path, 0.3, exposure=1.5)
    free, full = frame.coverage == 0.0, frame.coverage == 1.0
    assert free.any() and (frame.image[free] > 0.0).all()  # the radiance itself is unchanged
    np.testing.assert_array_equal(shown[free], brighter[free])
    assert (brighter[full] >= shown[full]).all() and (brighter[full] > shown[full]).any()


def test_other_skies_have_the_exposure_of_surfaces(tmp_path):
    lights = [model(0.3).default_lights()[0], at.Sky((0.8, 0.8, 0.8))]
    frame, shown = on_ground(tmp_path, 0.3, lights, exposure=20.0)
    assert (shown[(frame.coverage == 0.0) & ~frame.ground.mask] == 255).all()
