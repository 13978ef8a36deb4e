"""The still of a page: the render of its first view, at the sun that it opens with."""

import io
from datetime import datetime

import numpy as np
import pytest
from PIL import Image

import antumbra as at
from antumbra.web.page_still import SIZE, still_of

PLACE = at.Place(52.0, 4.36, timezone="Europe/Amsterdam")
NOON = datetime(2026, 3, 21, 12)


@pytest.fixture(scope="module")
def temple():
    return at.examples.temple()


def pixels(file):
    return np.asarray(Image.open(io.BytesIO(file)).convert("RGB"), np.float64)


def test_it_is_the_render_of_the_view(temple, tmp_path):
    view = temple.default_camera(*SIZE)
    at.render(temple, view, spp=16).save(tmp_path / "temple.png")
    rendered = np.asarray(Image.open(tmp_path / "temple.png").convert("RGB"), np.float64)
    made = pixels(still_of(temple, view, NOON, None, 0.0))
    assert made.shape == (*SIZE[::-1], 3) and rendered.std() > 10.0
    assert np.abs(made - rendered).mean() < 4.0  # what WebP loses


def test_its_sun_stands_where_the_page_has_it(temple):
    pytest.importorskip("pvlib", reason="stills at places are NOT checked without pvlib")
    view = temple.default_camera(320, 160)
    morning, evening = (pixels(still_of(temple, view, NOON.replace(hour=hour), PLACE, 0.0)) for hour in (9, 17))
    assert np.abs(morning - evening).mean() > 4.0
    assert still_of(temple, view, NOON.replace(hour=23), PLACE, 0.0) == b""
    skipped = datetime(2026, 3, 29, 2, 30)  # clocks go from 2 to 3
    assert still_of(temple, view, skipped, PLACE, 0.0) == b""
