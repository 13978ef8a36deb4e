"""What a clicked point sees."""

import re

import numpy as np
import pytest

import antumbra as at
from antumbra.viewer.control_panel import describe_point
from antumbra.viewer.gizmos import probe, sight_lines
from antumbra.viewer.viewer_model import Model
from pages import CAMERA, SUN, box_on_floor

DOWN = np.array([0.0, -1.0, 0.0])


@pytest.fixture
def model():
    return Model(box_on_floor(), [SUN, at.Sky(), at.PointLight((0, 9, 0)).named("lamp")], CAMERA)


def test_a_point_in_the_shadow_says_what_blocks_it(model):
    found = probe(model, np.array([0.0, 9.0, -1.2]), DOWN)
    np.testing.assert_allclose(found.position, (0, 0, -1.2), atol=1e-6)
    np.testing.assert_allclose(found.normal, (0, 1, 0), atol=1e-6)
    sun, sky, lamp = found.sights
    assert (sun.name, sun.share) == ("sun", 0.0) and sun.blocker is not None
    box = sun.blocker.corners
    assert np.abs(box).max() <= 2.0 and box[:, 1].max() == 2.0  # a face of the box, and not the floor
    np.testing.assert_allclose(sun.at, (0, 0.2, -1), atol=1e-5)  # 45 degrees up from z = -1.2 to the side z = -1
    assert sky.end is None and 0.3 < sky.share < 1.0 and sky.samples == 256
    assert lamp.share == 0.0 and lamp.blocker is not None


def test_a_point_in_the_light_sees_it(model):
    found = probe(model, np.array([0.0, 9.0, 4.0]), DOWN)
    sun, _, lamp = found.sights
    assert sun.share == lamp.share == 1.0 and sun.blocker is None and lamp.at is None
    np.testing.assert_allclose(lamp.end, (0, 9, 0), atol=1e-5)
    away = sun.end - found.position
    np.testing.assert_allclose(away / np.linalg.norm(away), -SUN.direction, atol=1e-6)


def test_a_surface_that_faces_away_blocks_itself(model):
    found = probe(model, np.array([0.0, 1.0, -9.0]), np.array([0.0, 0.0, 1.0]))
    assert found.sights[0].share == 0.0 and found.sights[0].blocker == found.face


def test_the_other_side_of_a_surface_is_asked_if_one_looks_at_it(model):
    found = probe(model, np.array([4.0, -5.0, 4.0]), -DOWN)
    assert found.normal[1] == pytest.approx(-1.0) and not any(sight.share for sight in found.sights[::2])


def test_beside_the_scene_there_is_nothing(model):
    assert probe(model, np.array([0.0, 9.0, 0.0]), -DOWN) is None
    assert "Click or tap a surface" in describe_point(None, model)


def test_the_panel_names_lights_and_blockers(model):
    found = probe(model, np.array([0.0, 9.0, -1.2]), DOWN)
    text = describe_point(found, model)
    for word in "sun", "Sky", "lamp", "0 % of 256", f"behind face {found.sights[0].blocker.index}", "box &amp; floor":
        assert word in text, word
    assert "<td>visible</td>" in describe_point(probe(model, np.array([0.0, 9.0, 4.0]), DOWN), model)


def test_the_panel_gives_the_sky_the_share_of_its_sentence(model):
    found = probe(model, np.array([0.0, 9.0, 4.0]), DOWN)
    (sky,) = (sight for sight in found.sights if sight.name == "Sky")
    text, share = describe_point(found, model), 100.0 * found.sky
    assert sky.share == found.sky and f"Sees {share:.0f} % of the sky" in text and f"{share:.3g} % of 256" in text


def test_lines_end_at_lights_and_blockers(model):
    found = probe(model, np.array([0.0, 9.0, -1.2]), DOWN)
    lines, colours = sight_lines(found)
    assert lines.shape == (4, 2, 3) and colours.shape == (4, 2, 3)  # two for the sun, two for the lamp
    np.testing.assert_allclose(lines[0], [found.position, found.sights[0].at])
    np.testing.assert_allclose(lines[1], [found.sights[0].at, found.sights[0].end])
    lit, yellow = sight_lines(probe(model, np.array([0.0, 9.0, 4.0]), DOWN))
    assert len(lit) == 2 and (yellow == yellow[0, 0]).all() and (yellow[0, 0] != colours[0, 0]).any()


def test_the_answer_begins_with_a_sentence(model):
    shaded = probe(model, np.array([0.0, 9.0, -1.2]), DOWN)
    assert re.search(r"In the shade of box &amp; floor\. Sees \d+ % of the sky\.", describe_point(shaded, model))
    lit = probe(model, np.array([0.0, 9.0, 4.0]), DOWN)
    assert "In the sun. Sees " in describe_point(lit, model) and 0.9 < lit.sky < 1.0
    away = probe(model, np.array([0.0, 1.0, -9.0]), np.array([0.0, 0.0, 1.0]))
    assert (
        "Faces away from the sun. " in describe_point(away, model) and 0.3 < away.sky < 0.55
    )  # a wall sees half of the sky
    roof = probe(model, np.array([0.0, 9.0, 0.0]), DOWN)
    assert roof is None or roof.sky == 1.0
    model.switch("sun", False)
    assert describe_point(probe(model, np.array([0.0, 9.0, 4.0]), DOWN), model).count("sun") == 0


def test_points_on_a_free_floor_see_the_whole_sky():
    for up, down in ("y", DOWN), ("z", np.array([0.0, 0.0, -1.0])):
        corners = np.array([[-5, 0, 5], [5, 0, 5], [5, 0, -5], [-5, 0, -5]], float)
        corners = corners if up == "y" else corners[:, [0, 2, 1]] * [1, -1, 1]
        floor = at.Scene.from_arrays(corners, [[0, 1, 2], [0, 2, 3]], up=up)
        assert probe(Model(floor), -4.0 * down, down).sky == 1.0
