"""What the tests of the viewer share: a box on a floor under a sun, and pages in a headless browser."""

import shutil
from contextlib import contextmanager

import numpy as np
import pytest

import antumbra as at

RED, WHITE = (0.8, 0.1, 0.1), (0.8, 0.8, 0.8)
SUN = at.DirectionalLight((0.0, -1.0, -1.0), 0.0, intensity=3.0)
"""From the south, 45 degrees high: the shadow of the box lies north of it, towards -z."""

CAMERA = at.Camera((0.0, 12.0, 0.01), (0.0, 0.0, 0.0), (0.0, 0.0, -1.0), vfov=60.0)
"""From above: +x is to the right, -z is up."""


def box_on_floor():
    """A red cube of side 2 on a white floor of side 12, at y = 0."""
    c = np.array([[x, y, z] for x in (-1, 1) for y in (0, 2) for z in (-1, 1)], np.float64)
    quads = [(2, 3, 7, 6), (0, 1, 3, 2), (4, 6, 7, 5), (1, 5, 7, 3), (0, 2, 6, 4)]
    corners = [c[list(three)] for a, b, d, e in quads for three in ((a, b, d), (a, d, e))]
    f = np.array([[-6, 0, -6], [-6, 0, 6], [6, 0, 6], [6, 0, -6]], np.float64)
    corners += [f[[0, 1, 2]], f[[0, 2, 3]]]
    colours = np.array([RED] * 10 + [WHITE] * 2)
    return at.Scene.from_arrays(np.array(corners), colours=colours, name="box & floor")


@contextmanager
def headless():
    """Chromium without a window, whose WebGL is drawn by software; skips the test where something is missing."""
    module = pytest.importorskip("playwright.sync_api", reason="no playwright: the viewer is NOT tested in a browser")
    pytest.importorskip("viser", reason="no viser: the viewer is NOT tested in a browser")
    path = shutil.which("chromium") or shutil.which("google-chrome")
    if path is None:
        pytest.skip("no chromium: the viewer is NOT tested in a browser")
    options = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"]
    with module.sync_playwright() as started:
        chromium = started.chromium.launch(executable_path=path, args=options)
        yield chromium
        chromium.close()
