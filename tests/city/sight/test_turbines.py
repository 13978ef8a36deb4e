"""Several turbines: which and how much of each is seen, over a curved earth, on a surface, and from tables."""

import numpy as np
import pytest

import antumbra as at
from city.sight.test_targets import walled

RADIUS = 6_371_000.0


def sea(turned, length=40_000.0):
    """A strip of flat sea along X, or along Y if it is turned by a quarter."""
    x = np.linspace(-1_000.0, length, 42)
    shore = [np.c_[x, np.full(42, side), 0.0 * x] for side in (-500.0, 500.0)]
    strip = np.concatenate(shore)
    faces = np.concatenate([[[k, k + 1, 43 + k], [k, 43 + k, 42 + k]] for k in range(41)])
    return at.Scene.from_arrays(quarter(strip) if turned else strip, faces, up="z")


def quarter(points):
    """Points turned by a quarter to the left, about the up axis."""
    return np.asarray(points, float)[..., [1, 0, 2]] * [-1.0, 1.0, 1.0]


def segment(line, hub, radius):
    """The share of a disk above a level line."""
    s = np.clip((line - hub) / radius, -1.0, 1.0)
    return (np.arccos(s) - s * np.sqrt(1.0 - s * s)) / np.pi


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("k", [0.0, 0.13])
def test_the_earth_hides_the_lower_part_of_a_far_rotor(turned, k):
    """The ground hides what is lower than its drop beyond the horizon, (1 - k) (d - d0)^2 / 2R."""
    distance, hub, radius, drop = np.array([10e3, 20e3, 25e3, 30e3, 35e3]), 60.0, 50.0, (1.0 - k) / (2.0 * RADIUS)
    eye = np.array([[0.0, 0.0, 2.0]])
    feet = np.c_[distance, np.zeros(5), np.zeros(5)]
    if turned:
        eye, feet = quarter(eye), quarter(feet)
    farm = {f"T{n}": at.Turbine(foot, hub, 2.0 * radius) for n, foot in enumerate(feet)}
    table = at.visible_share(sea(turned), eye, farm, curvature=True, refraction=k, samples=1024)
    hidden = drop * (distance - np.sqrt(2.0 / drop)) ** 2
    shares = np.array([table[f"share_T{n}"][0] for n in range(5)])
    assert np.abs(shares - segment(hidden, hub, radius)).max() < 0.006 and shares[0] > 0.99 and 0.0 < shares[-1] < 0.9
    assert table["turbines"][0] == 5 and table["share"][0] == pytest.approx(shares.mean(), abs=1e-6)
    flat = at.visible_share(sea(turned), eye, farm)
    assert flat["share"][0] == 1.0 and (table.about["refraction"], flat.about.get("refraction")) == (k, None)


def test_shares_of_several_are_those_of_each():
    scene = walled()
    feet = [(84100.0, 445980.0, 0.0), (84090.0, 445990.0, 0.0), (84050.0, 445975.0, 0.0)]
    farm = [at.Turbine(foot, 14.0, 2.0 * r) for foot, r in zip(feet, (6.0, 10.0, 3.0))]
    several = at.visible_share(scene, "raster+1.6", farm)
    each = [at.visible_share(scene, "raster+1.6", turbine) for turbine in farm]
    assert list(several.columns) == ["turbines", "share", "visible", "share_1", "share_2", "share_3"]
    for k, one in enumerate(each, 1):
        assert (several[f"share_{k}"] == one["share"]).all()
    assert (several["visible"] == sum(one["visible"] for one in each)).all()
    assert (several["turbines"] == sum((one["visible"] > 0).astype(int) for one in each)).all()
    area = np.array([36.0, 100.0, 9.0]) / 145.0
    assert np.allclose(several["share"], sum(a * one["share"] for a, one in zip(area, each)), atol=1e-6)
    assert len(np.unique(several["turbines"])) == 4 and len(several.marks) == 3


def test_feet_are_placed_on_the_surface():
    heights = np.add.outer(np.arange(40.0), np.zeros(40))  # a plane that rises by 1 to 2 towards the south
    scene = at.from_raster((heights, (2.0, 0.0, 84000.0, 0.0, -2.0, 446000.0)))
    foot = (84041.0, 445961.0, -500.0)  # its surface is at 19
    placed = at.visible_share(scene, "raster+1.6", {"a": at.Turbine(foot, 30.0, 20.0)}, on_surface=True)
    given = at.visible_share(scene, "raster+1.6", {"a": at.Turbine((*foot[:2], 19.0), 30.0, 20.0)})
    assert (placed["visible"] == given["visible"]).all() and np.allclose(placed.marks, [[84041.0, 445961.0, 49.0]])
    with pytest.raises(at.InputError, match=r"rotor reaches .* below the ground"):
        at.visible_share(scene, "raster+1.6", at.Turbine(foot, 30.0, 20.0))
    with pytest.raises(at.InputError, match=r"turbines? lies? beside .* where no surface is"):
        at.visible_share(scene, "raster+1.6", at.Turbine((0.0, 0.0, 0.0), 30.0, 20.0), on_surface=True)
    with pytest.raises(at.InputError, match="on_surface places the feet of turbines"):
        at.visible_share(scene, "raster+1.6", [[84041.0, 445961.0, 60.0]], on_surface=True)


def test_a_foot_and_an_eye_below_the_ground_are_noted():
    scene = walled()
    with pytest.warns(UserWarning, match="below the ground") as notes:
        at.visible_share(scene, [[84010.0, 445985.0, -3.0]], [at.Turbine((84090.0, 445985.0, -2.0), 30.0, 20.0)])
    texts = [str(note.message) for note in notes]
    assert any("1 of 1 turbine lies below the ground" in text for text in texts)
    assert any("1 of 1 sensor lies below the ground" in text for text in texts)


@pytest.mark.parametrize("target", [[], {}, {"a": 3}])
def test_no_turbines_are_refused(target):
    with pytest.raises(at.InputError):
        at.visible_share(walled(), "raster+1.6", target)
