"""What the panel says about a clicked point."""

import numpy as np
import pytest

import antumbra as at
from antumbra.viewer.control_panel import describe_point
from antumbra.viewer.gizmos import probe
from antumbra.viewer.viewer_model import Model
from pages import CAMERA, SUN, box_on_floor


def triangle_of(size, unit=None):
    corners = size * np.array([[[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]])
    return at.Scene.from_arrays(corners, unit=unit)


@pytest.mark.parametrize(
    "size, unit, place",
    [
        (1.0, None, "0.123, 0.000, 0.300 m"),
        (100.0, "ft", "12.3, 0.0, 30.0 ft"),
        (1e4, "mm", "1235, 0, 3000 mm"),
        (1e6, None, "123457, 0, 300000 m"),
    ],
)
def test_positions_have_the_digits_of_the_scenes_size_and_its_unit(size, unit, place):
    model = Model(triangle_of(size, unit), SUN)
    position = size * np.array([0.123456789, -1e-9, 0.3])
    assert model.text_of(position) == place


def test_a_point_is_described_in_the_unit_of_the_scene():
    model = Model(box_on_floor(), SUN, CAMERA)
    point = probe(model, np.array([0.0, 30.0, 3.0]), np.array([0.0, -1.0, 0.0]))
    text = describe_point(point, model)
    assert text.count(model.text_of(point.position)) == 1 and " m<" in text
    assert "Click or tap" in describe_point(None, model)
