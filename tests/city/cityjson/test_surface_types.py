"""Types of surfaces without semantics."""

import numpy as np
import pytest

from antumbra.city.cityjson.surface_types import BUILT, GROUND, ROOF, WALL, surface_type, types_of_normals


def test_walls_are_steeper_than_60_degrees():
    tilts = np.array([0.0, 45.0, 59.9, 60.1, 90.0, 119.9, 120.1, 180.0])
    expected = [ROOF, ROOF, ROOF, WALL, WALL, WALL, GROUND, GROUND]
    assert types_of_normals(np.cos(np.radians(tilts))).tolist() == expected


@pytest.mark.parametrize("owner", [f"{name}Part" for name in BUILT])
def test_constructions_have_walls_roofs_and_ground(owner):
    assert [surface_type(owner, height) for height in (0.0, 1.0, -1.0)] == [WALL, ROOF, GROUND]


def test_other_objects_have_neither():
    assert surface_type("Road", 1.0) == "TrafficArea" and surface_type("WaterBody", 1.0) == "WaterSurface"
    assert surface_type("PlantCover", 0.0) == "+Surface"
