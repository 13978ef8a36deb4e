"""Pictures of results: the colours are those of the numbers, at the places of their sensors."""

import numpy as np
import pytest
from PIL import Image

import antumbra as at
from antumbra.city.sheets.map_frame import Extent
from antumbra.city.sheets.scene_plan import brightness, hillshade
from antumbra.city.tables import false_colours
from antumbra.city.tables.false_colours import column_scale, column_values, project_points
from antumbra.city.tables.interpolated_values import smooth_cells
from antumbra.city.tables.map_scale import map_scale
from antumbra.city.tables.result_table import Column
from antumbra.picture.heat_maps import heat_colours, letter_size
from antumbra.scene.camera import fitted_camera
from result_tables import hill, table

GREY = (200, 200, 200)


def picture(made, folder, column=None):
    made.save(folder / "a.png", column)
    return np.asarray(Image.open(folder / "a.png"))


def test_a_map_has_the_colours_of_its_cells_north_up(tmp_path):
    made = table("raster")
    rows, columns = np.indices((10, 12))
    made.columns["hours"] = Column((rows * 10.0 + columns).ravel(), "h", "hours")
    drawn = picture(made, tmp_path)
    grey = np.argwhere((drawn == GREY).all(-1))
    top, left = grey.min(0)
    bottom, right = grey.max(0) + 1
    cell = (right - left) // 2  # two columns lie beside the hill
    assert (bottom - top, right - left) == (10 * cell, 2 * cell)
    values, known = column_values(made, "hours")
    end = column_scale(made["hours"], known).ticks[-1]
    map_ = drawn[top:bottom, left : left + 12 * cell]
    shade = brightness(hillshade(made.scene, Extent(-2.0, 0.0, 10.0, 10.0), 12 * cell, 10 * cell))
    fine = smooth_cells(np.where(known, values, np.nan).reshape(10, 12), cell)
    for row, column in (0, 2), (9, 2), (0, 11), (5, 6):
        at_cell = row * cell + cell // 2, column * cell + cell // 2
        colour = heat_colours(fine[at_cell], end)
        assert np.array_equal(map_[at_cell], np.minimum(colour * shade[at_cell], 255.0).round())


def test_each_column_has_its_own_title_and_legend(tmp_path, monkeypatch):
    told = []
    monkeypatch.setattr(
        false_colours, "panel_sheet", lambda panels, bar, paper: told.append((panels, bar)) or np.zeros((4, 4, 3), "u1")
    )
    monkeypatch.setattr(false_colours, "brightness", np.ones_like)
    made = table("raster")
    made.columns["hours"] = Column(np.linspace(0.0, 12.0, 120), "h", "hours of direct sun")
    made.columns["passes"] = Column(np.arange(120) % 2 == 0, "", "whether the sensor meets the rule")
    for name, title, caption, texts in (
        ("hours", "Hours of direct sun", "hours [h]", ["0", "2", "4", "6", "8", "10", "12"]),
        ("passes", "Whether the sensor meets the rule", "passes", ["fails", "passes"]),
    ):
        made.save(tmp_path / "a.png", name)
        (panel,), bar = told.pop()
        assert [*panel.lines] == [title] and bar.caption == caption
        assert [text for _, text in bar.ticks] == texts
    shown = {tuple(colour) for colour in panel.picture.reshape(-1, 3).tolist()}
    assert shown - {GREY} == {tuple(colour) for colour in bar.colours[[0, -1]].tolist()}


@pytest.mark.parametrize("kind", ["face", "vertex", "grid", "points"])
def test_views_have_colours_and_marks(tmp_path, kind):
    made = table(kind)
    plain = picture(made, tmp_path, "count")
    made.marks = made.sensors.points[len(made) // 2][None]
    marked = picture(made, tmp_path, "count")
    assert len(np.unique(plain.reshape(-1, 3), axis=0)) > 50
    changed = np.argwhere((plain != marked).any(-1))
    assert 20 < len(changed) < 200 and (np.ptp(changed, axis=0) < 14).all()


@pytest.mark.parametrize("spots", [1, 40_000])
def test_points_are_discs_rings_behind_surfaces_and_colour_nothing_else(tmp_path, spots):
    wall = at.Scene.from_arrays([[-9, 0, 0], [9, 0, 0], [9, 0, 12], [-9, 0, 12]], [[0, 1, 2], [0, 2, 3]], up="z")
    places = np.repeat([[-4.0, -0.01, 6.0], [4.0, 0.01, 6.0]], spots, 0)  # before the wall, and behind it
    made = at.Table(at.point_sensors(places, np.repeat([[0.0, -1, 0], [0, 1, 0]], spots, 0)), {}, {}, wall)
    made.columns["q_passes"] = Column(np.repeat([True, False], spots), "", "verdict by q")
    made.camera = at.Camera((0, -40, 6), (0, 0, 6), (0, 0, 1), 40.0, 400, 300)
    drawn = picture(made, tmp_path)
    fails, passes = (
        each.colour for each in map_scale(made["q_passes"], made["q_passes"] >= 0, name="q_passes").classes
    )
    letters = letter_size(400)
    top, left = letters // 2 + 2 * round(1.4 * letters) + letters // 4, letters  # below two lines
    view = drawn[top : top + 300, left : left + 400]
    discs, rings = (np.argwhere((view == colour).all(-1)) for colour in (passes, fails))
    assert np.abs(discs.mean(0) - project_points(made.camera, places[:1])[0, ::-1]).max() < 1.0
    assert np.abs(rings.mean(0) - project_points(made.camera, places[-1:])[0, ::-1]).max() < 1.0
    assert (np.ptp(discs, axis=0) < 16).all() and (np.ptp(rings, axis=0) < 16).all()
    if spots == 1:
        middle = np.round(rings.mean(0)).astype(int)
        assert len(np.unique(view[tuple(middle)])) == 1 and len(discs) > len(rings) > 20  # the wall within the ring


def test_a_given_camera_is_used(tmp_path):
    made = table()
    made.camera = at.Camera((5, -30, 10), (5, 5, 0), (0, 0, 1), 40.0, 1024, 600)
    first = picture(made, tmp_path)
    made.camera = at.Camera((5, -30, 20), (5, 5, 0), (0, 0, 1), 40.0, 1024, 600)
    assert first.shape == picture(made, tmp_path).shape and (first != picture(made, tmp_path)).any()


@pytest.mark.parametrize("up", ["y", "z"])
@pytest.mark.parametrize("stretch", [(1, 1, 1), (10, 1, 1), (1, 10, 1), (1, 1, 10)])
def test_the_camera_shows_all_and_fills_the_picture(up, stretch):
    corners = hill(up).triangles().vertices * np.array(stretch, np.float32)
    scene = at.Scene.from_arrays(corners + np.array([1e5, 2e5, 0]), up=up)
    points = scene.triangles().vertices.reshape(-1, 3) + scene.origin
    places = project_points(fitted_camera(points, scene.up, 400, 300), points)
    assert (places > 0).all() and (places < (400, 300)).all()
    assert (np.ptp(places, axis=0) / (400, 300)).max() > 0.9


def test_points_behind_the_camera_have_no_place():
    camera = at.Camera((0, 0, 0), (0, 0, -1), (0, 1, 0), 90.0, 100, 100)
    places = project_points(camera, np.array([[0, 0, -2.0], [1, 1, -2.0], [0, 0, 1.0]]))
    assert np.allclose(places[:2], [[50, 50], [75, 25]]) and np.isnan(places[2]).all()


def test_scales():
    scale = column_scale(np.array([0, 1, 3]), np.ones(3, bool))
    assert scale.ticks.tolist() == [0, 1, 2, 3]
    large = column_scale(np.arange(1001), np.ones(1001, bool)).ticks
    assert large[-1] == 1000 and (large == np.floor(large)).all() and len(large) <= 9
    assert column_scale(np.array([np.nan, 1.0]), np.array([False, True])).ticks[-1] >= 1.0
    values, known = column_values(table(), "count")
    assert known.tolist() == [False, True, True, True] and values[1] == 0.0


def test_pictures_of_losses_tell_gains_from_none(tmp_path):
    made = table("raster")
    losses = np.zeros(len(made))
    losses[made.sensors.covered] = np.linspace(-2.0, 6.0, made.sensors.covered.sum())
    made.columns["hours_loss"] = Column(losses, "h", "hours lost")
    scale = column_scale(losses, made.sensors.covered, "hours_loss")
    gain, none, loss = scale.colours(np.array([-2.0, 0.0, 2.0]), np.ones(3, bool)).astype(int)
    assert np.ptp(none) <= 5 and gain[2] > gain[0] + 20 and loss[0] > loss[2] + 20
    bar = scale.bar("loss")
    assert bar.ticks[0] == (0.0, "-2") and bar.ticks[-1] == (1.0, "6") and (0.25, "0") in bar.ticks
    assert bar.colours[0].tolist() == gain.tolist()
    noisy = column_scale(np.array([-7e-6, 5.10007]), np.ones(2, bool), "hours_loss").bar("loss").ticks
    assert [text for _, text in noisy] == ["0", "1", "2", "3", "4", "5.1"]
    drawn = picture(made, tmp_path, "hours_loss")
    assert (drawn == gain).all(-1).any()
    made.save(tmp_path / "a.glb", "hours_loss")


def test_azimuths_counts_and_verdicts_are_not_interpolated():
    """Between 1 and 359 degrees lies north, not south."""
    made = table("grid")
    n = len(made.sensors)
    made.columns["azimuth"] = Column(np.where(np.arange(n) % 2, 1.0, 359.0), "degrees", "faces")
    made.columns["passes"] = Column(np.arange(n) % 2 == 0, "", "meets the rule")
    smooth = {name: false_colours.is_smooth(made, name) for name in ("hours", "azimuth", "passes", "count")}
    assert smooth == {"hours": True, "azimuth": False, "passes": False, "count": False}


@pytest.mark.parametrize("suffix", ["png", "glb"])
@pytest.mark.parametrize("kind", ["face", "raster", "points"])
def test_a_table_without_a_scene_has_no_picture_and_no_model(tmp_path, kind, suffix):
    made = table(kind)
    made.scene = None
    with pytest.raises(at.InputError, match="the table has no scene"):
        made.save(tmp_path / f"a.{suffix}", "count")
    assert not list(tmp_path.iterdir())
