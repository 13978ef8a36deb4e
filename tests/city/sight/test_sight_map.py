"""The sheet of lines of sight: each line between its ends, solid or dashed, with the labels of both tables."""

import re

import numpy as np
import pytest

import antumbra as at
from antumbra.city.sight.sight_map import save_sight_map
from antumbra.city.sight.sightlines import pairs_of
from sheet_cases import site

pytest.importorskip("matplotlib")


def ends(points, names):
    return at.Sensors(np.array(points, float), None, None, None, "points", attributes={"id": np.array(names, object)})


def sheet_of(tmp_path, unit="m", **fields):
    scene = site(unit)
    scale = 1.0 / scene.unit.metres
    observers = ends(np.array([[0.0, -40, 1.6], [40, -10, 5]]) * scale, ["north", "east"])
    targets = ends(np.array([[-20.0, 5, 2], [50, -10, 5]]) * scale, ["T1", "T2"])
    pairs = pairs_of("all", observers, targets)
    found = at.line_of_sight(scene, pairs.observers, pairs.targets)
    save_sight_map(scene, pairs, found, tmp_path / "a.svg", at.Sheet(**fields))
    return found, (tmp_path / "a.svg").read_text()


@pytest.mark.parametrize("unit", ["m", "ft"])
def test_lines_and_their_ends_are_there(tmp_path, unit):
    found, text = sheet_of(tmp_path, unit)
    seen = int(found.visible.sum())
    assert 0 < seen < 4
    assert f"visible: {seen} of 4 lines" in text and f"not visible: {4 - seen} of 4 lines" in text
    assert all(f">{name}<" in text for name in ("north", "east", "T1", "T2", "observer", "target"))
    dashed = re.findall(r"stroke: #b03a1a; [^\"]*stroke-dasharray|stroke-dasharray: [^\"]*stroke: #b03a1a", text)
    assert len(dashed) == 4 - seen + 1  # and the key


def test_lines_that_do_not_fit_are_refused(tmp_path):
    with pytest.raises(at.InputError, match="1:100 does not fit on A4; the extent of 70 x 45 m needs"):
        sheet_of(tmp_path, scale=100)
    assert not list(tmp_path.iterdir())
