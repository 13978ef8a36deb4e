"""The page of a shadow on a plane: a ground whose triangles are the polygons, and the cells of hours of shadow."""

import numpy as np
import pytest

import antumbra as at
from antumbra.city.shadow import shadow_page
from pages import box_on_floor

pytest.importorskip("shapely", reason="no shapely: shadows are NOT checked")
PLACE = at.Place(52.0, 4.36, timezone="Europe/Amsterdam")


def layers(monkeypatch, module):
    """What pages would show, instead of pages."""
    shown = []
    monkeypatch.setattr(module, "make_page", lambda scene, path, **given: shown.append((scene, given)))
    return shown


@pytest.mark.parametrize("up", ["y", "z"])
def test_the_ground_of_a_page_has_the_polygons_and_their_areas(monkeypatch, up):
    corners = box_on_floor().triangles().vertices + box_on_floor().origin
    if up == "z":
        corners = corners[..., [0, 2, 1]] * [1.0, -1.0, 1.0]
    scene = at.Scene.from_arrays(corners[:10], up=up)
    shown = layers(monkeypatch, shadow_page)
    shadow = at.shadow(scene, at="2026-06-21T10:00", place=PLACE)
    shadow.page()
    ((joined, given),) = shown
    layer, soup = given["layer"], joined.triangles()
    vertices = soup.vertices[len(corners[:10]) :].astype(float)
    rows = layer.faces[len(corners[:10]) :]
    cross = np.cross(vertices[:, 1] - vertices[:, 0], vertices[:, 2] - vertices[:, 0])
    assert (cross[:, "xyz".index(up)] > 0).all()
    areas = np.linalg.norm(cross, axis=1) / 2
    assert areas[rows == 1].sum() == pytest.approx(shadow.area, rel=1e-5)
    assert [stop.text for stop in layer.stops] == ["no shadow", "shadow", "the scene"]
    assert set(layer.faces[: len(corners[:10])]) == {2} and set(rows) == {0, 1}
    assert given["place"] == PLACE and str(given["when"]) == "2026-06-21 10:00:00"


def test_hours_of_shadow_lie_on_the_cells(monkeypatch):
    from antumbra.city.tables import result_table

    shown = layers(monkeypatch, result_table)
    shadow = at.shadow(box_on_floor(), days="2026-06-21", cell=1.0, step=120, place=PLACE)
    shadow.page()
    ((_, given),) = shown
    assert given["when"] == "2026-06-21" and given["layer"].points.shape == (len(shadow.table), 3)
    assert np.array_equal(given["layer"].values, shadow.table["shadow_hours"])
