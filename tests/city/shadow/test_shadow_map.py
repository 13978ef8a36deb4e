"""Map sheets of shadows: polygons with their holes, areas, classes and facts; the same bytes each time."""

import numpy as np
import pytest

import antumbra as at
from antumbra.city.shadow.shadow_map import shadow_facts, shadow_report
from sheet_pages import map_of, texts

pytest.importorskip("matplotlib")
shapely = pytest.importorskip("shapely", reason="shadows need antumbra[gis]: NOT checked")

DELFT = at.Place(52.0, 4.36, north=20.0, timezone="Europe/Amsterdam")
NOON = "2026-06-21T13:40"


def ring(up="z"):
    """A horizontal frame 5 above the ground, 10 x 10 with a hole of 4 x 4, and the ground."""
    outer, inner = (np.array([[-r, -r, 5.0], [r, -r, 5], [r, r, 5], [-r, r, 5]]) for r in (5.0, 2.0))
    quads = [[outer[k], outer[k - 3], inner[k - 3], inner[k]] for k in range(4)]
    quads.append(np.array([[-30.0, -30, 0], [30, -30, 0], [30, 30, 0], [-30, 30, 0]]))
    faces = np.array([[[q[0], q[1], q[2]], [q[0], q[2], q[3]]] for q in quads]).reshape(-1, 3, 3)
    return at.Scene.from_arrays(faces if up == "z" else faces[..., [0, 2, 1]] * [1, 1, -1], up=up, name="frame")


def drawn_area(figure):
    """The area of the polygons of a map, with the signs of their rings."""
    area = 0.0
    for collection in figure.axes[0].collections:
        if type(collection).__name__ != "PathCollection":
            continue
        for path in collection.get_paths():
            for part in path.to_polygons():
                area += abs_area(part) * (1 if clockwise(part) else -1)
    return area


def abs_area(part):
    x, y = part.T
    return abs(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1])) / 2


def clockwise(part):
    x, y = part.T
    return np.sum(x[:-1] * y[1:] - x[1:] * y[:-1]) < 0


@pytest.mark.parametrize("up", ["y", "z"])
def test_the_shadow_of_a_frame_has_its_hole(up):
    shadow = at.shadow(ring(up), at=NOON, place=DELFT, plane=0.0)
    assert shadow.area == pytest.approx(100 - 16) and len(shadow.polygons[0].interiors) == 1
    figure = map_of(shadow_report(shadow))
    assert drawn_area(figure) == pytest.approx(shadow.area)
    assert {"Shadow", "shadow: 84 m²", "casts it"} <= set(texts(figure))
    assert shadow.casters.shape == (8, 3, 2)
    west, east = figure.axes[0].get_xlim()
    low, _, high, _ = shapely.total_bounds(shadow.polygons)
    assert west < min(low, -5) and east > max(high, 5)
    facts = dict(shadow_facts(shadow))
    assert facts["time"].startswith("2026-06-21 13:40") and facts["scene"] == "frame" and "52.00000" in facts["place"]
    assert (
        facts["sun"]
        == f"azimuth {shadow.about['sun_azimuth']:.1f}, elevation {shadow.about['sun_elevation']:.1f} degrees"
    )


def test_classes_of_hours_and_their_areas():
    shadow = at.shadow(ring(), days="2026-06-21", cell=2.0, step=60, place=DELFT, classes=[0, 1, 3])
    figure = map_of(shadow_report(shadow), title="Hours below a frame")
    assert shadow.casters is None and len(shadow.polygons) >= 2
    found = set(texts(figure))
    for low, area in zip(shadow.columns["hours_from"], shadow.columns["area"]):
        assert any(word.startswith(f"{low:g} to ") and word.endswith(f": {area:,.4g} m²") for word in found)
    assert {"Hours below a frame", "days", "falls on", "cells of 2 m"} <= found
    west, east = figure.axes[0].get_xlim()
    assert west < -30 and east > 30 and west + east == pytest.approx(0.0)


def test_a_map_without_a_shadow():
    shadow = at.shadow(ring(), at=NOON, place=DELFT, plane=6.0)
    assert "shadow: 0 m²" in texts(map_of(shadow_report(shadow)))


@pytest.mark.parametrize("suffix", [".pdf", ".svg", ".png"])
def test_the_same_shadow_gives_the_same_bytes(tmp_path, suffix):
    first, second = tmp_path / f"a{suffix}", tmp_path / f"b{suffix}"
    at.shadow(ring(), at=NOON, place=DELFT).save_map(first)
    at.shadow(ring(), at=NOON, place=DELFT).save_map(second)
    assert first.read_bytes() == second.read_bytes() and len(first.read_bytes()) > 5000
    at.shadow(ring(), at=NOON, place=DELFT).save_map(second, title="Another")
    assert first.read_bytes() != second.read_bytes()
