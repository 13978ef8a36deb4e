"""Votes through caps: the verdicts are those of fourteen rays through the surfaces themselves."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import antumbra as at
from antumbra.query.ray_list import rays_of
from antumbra.scene.triangles import HitFilter
from antumbra.trace.rays import cell_verdicts
from antumbra.trace.rays.inside_votes import ALL, AXES, MOST, ON_CAP, OUTSIDE, WITHIN, Election
from support.strength import examples

DIRECTIONS = np.array([*np.eye(3), *-np.eye(3), *product((-1.0, 1.0), repeat=3)])
UNIT_BOX = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
BOX = UNIT_BOX[
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
     [1, 5, 7], [1, 7, 3]]
]  # fmt: skip


@pytest.fixture(autouse=True, scope="module", params=[1, 1 << 60], ids=["cells", "no cells"])
def grid_pays(request):
    """From how many points on there are a grid of cells and columns of caps."""
    before, cell_verdicts._GRID_PAYS = cell_verdicts._GRID_PAYS, request.param
    yield
    cell_verdicts._GRID_PAYS = before


def most_of_fourteen(scene, points):
    """`contains` by definition: rays through the surfaces, each counted alone."""
    lower, upper = scene.bounds
    within = ((points >= lower) & (points <= upper)).all(1)
    odd = np.stack([scene.count_hits(points, along, merge="surface") % 2 == 1 for along in DIRECTIONS], 1)
    votes, axes = odd.sum(1), odd[:, :AXES].sum(1)
    on_surface = scene.closest_points(points).distance == 0.0
    return on_surface | within & np.where((axes == 0) | (axes == AXES), axes > 0, votes >= MOST)


def test_directions_are_those_of_the_definition():
    assert len(DIRECTIONS) == ALL and MOST == 8


@examples(120)
@given(
    st.lists(st.integers(0, 35), min_size=1, max_size=12, unique=True),
    st.sampled_from(["y", "z"]),
    st.integers(1, 130),
    st.integers(0, 1000),
)
def test_points_of_open_boxes_are_those_of_fourteen_rays(missing, up, n, seed):
    """The coordinates are halves, so many points are on faces, edges and caps, and rays pass through corners."""
    boxes = np.concatenate([BOX * 4, BOX * 2 + 1, BOX * 2 + (5, 0, 1)])
    scene = at.Scene.from_arrays(np.delete(boxes, missing, axis=0), up=up)
    rng = np.random.default_rng(seed)
    points = rng.integers(-2, 16, (n, 3)) / 2.0
    np.testing.assert_array_equal(scene.contains(points), most_of_fourteen(scene, points))


@pytest.mark.parametrize("threads", [1, 3])
def test_many_points_are_those_of_fourteen_rays_and_all_outcomes_occur(threads):
    """A ball without a third of its lower half, in a room without a ceiling."""
    ball = at.Scene.from_arrays(np.concatenate([BOX * 4, BOX * 2 + (1, 1, 0)])[2:-1], up="z")
    points = np.random.default_rng(1).uniform(-1, 5, (5000, 3)).astype(np.float32)
    inside = ball.contains(points, threads=threads)
    assert 0.02 < inside.mean() < 0.9
    np.testing.assert_array_equal(inside, most_of_fourteen(ball, points))


def test_points_on_caps_are_marked():
    scene = at.Scene.from_arrays(BOX[2:], up="z")  # without the side at x = 0
    bodies, points = (
        scene.engine.source.ray_lists.bodies(0.0),
        np.float32([[0, 0.5, 0.25], [0.5, 0.5, 0.25], [9, 9, 9]]),
    )
    rays = rays_up(scene, points)
    election = Election(bodies.crossings(rays, 1), bodies.box)
    assert bodies.caps.verdicts(rays, election).tolist() == [ON_CAP, WITHIN, OUTSIDE]
    np.testing.assert_array_equal(scene.contains(points), most_of_fourteen(scene, points.astype(float)))


def directions_up():
    order = np.argsort(-(DIRECTIONS[AXES:] @ (0, 0, 1)), kind="stable")
    return np.concatenate([DIRECTIONS[[2, 0, 1, 3, 4, 5]], DIRECTIONS[AXES:][order]]).astype(np.float32)


def rays_up(scene, points):
    return rays_of(points, np.array([0, 0, 1.0]), HitFilter(0.0, np.inf), tuple(scene.origin), scene.n_triangles)
