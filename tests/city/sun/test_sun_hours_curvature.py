"""Hours of sun behind far mountains on a curved earth, by the closed form of their elevation."""

from datetime import date

import numpy as np
import pytest

import antumbra as at
from antumbra.sun.sun_positions import suns_of, times_of, zone_of
from city.skyline.test_skyline_curvature import far_walls

RADIUS = 6_371_000.0


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("curved", [False, True])
def test_the_sun_rises_earlier_over_far_mountains_on_a_curved_earth(turned, curved):
    """A wall of 900 m, 25 km to the east, stands at atan(h / d - d / 2R). With the scene, north turns by a quarter."""
    place = at.Place(47.0, 11.0, north=-90.0 if turned else 0.0, timezone="Europe/Vienna")
    scene = far_walls("z")
    if turned:
        corners = scene.triangles(0.0).vertices.astype(float) + scene.origin
        scene = at.Scene.from_arrays(corners[..., [1, 0, 2]] * [-1.0, 1.0, 1.0], up="z")
    point = [[0.0, 0.0, 2.0]]
    bend = {"curvature": True, "refraction": 0.0} if curved else {}
    table = at.sun_hours(scene, point, "2026-03-20", place=place, step=1, **bend)
    suns = suns_of(place, times_of([date(2026, 3, 20)], zone_of(place), 1.0), "z")
    top = 898.0 / 25e3 - (25e3 / (2.0 * RADIUS) if curved else 0.0)
    slope = np.tan(np.radians(suns.altitude)) / np.maximum(
        np.sin(np.radians(suns.azimuth)), 1e-9
    )  # along the wall's normal
    width = np.abs(25e3 / np.tan(np.radians(suns.azimuth)))
    hidden = (suns.azimuth < 180.0) & (slope < top) & (width < 9e3)
    assert table["sun_hours"][0] == pytest.approx((~hidden).sum() / 60.0, abs=1.01 / 60.0)
    assert 0.1 < hidden.sum() / 60.0 < 0.35 and (table.about.get("refraction") == 0.0) is curved
