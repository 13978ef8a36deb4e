"""Toys: a bear, a ball, building blocks, a pyramid of rings, a train. They stand on y = 0."""

import numpy as np

from ...generate import palette as p
from ...generate.props import SINK
from ...generate.shapes import PaletteMesh, arc, assemble, box, merge, place_copies, raised, revolve, steps
from .furniture import SKETCH

COLOURS = (p.RED, p.YELLOW, p.BLUE, p.LIME, p.TEAL, p.OCHRE)


def _ball(radius, segments: int, colour: int) -> PaletteMesh:
    """An ellipsoid of `radius` (3,) around zero."""
    n = max(3, segments // 2)
    angle = np.linspace(-np.pi / 2, np.pi / 2, n + 1)
    profile = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    profile[[0, -1], 0] = 0.0
    round_ = revolve(profile, segments, colour)
    return round_._replace(vertices=round_.vertices * np.asarray(radius, np.float32))


def bear(height: float, d: float) -> PaletteMesh:
    """A teddy bear that sits and faces +z."""
    k = steps(22, d, 6)
    fur, pale = p.CLAY, p.LIMESTONE
    pieces = [
        ((0.21, 0.25, 0.19), (0, 0.24, 0), fur),
        ((0.14, 0.17, 0.06), (0, 0.24, 0.15), pale),
        ((0.2, 0.18, 0.18), (0, 0.62, 0.01), fur),
        ((0.09, 0.07, 0.08), (0, 0.57, 0.17), pale),
        ((0.03, 0.022, 0.02), (0, 0.6, 0.245), p.SLATE + 6),
    ]
    for s in (-1, 1):
        pieces += [
            ((0.075, 0.075, 0.04), (s * 0.16, 0.79, 0), fur),
            ((0.045, 0.045, 0.03), (s * 0.16, 0.79, 0.025), pale),
            ((0.022, 0.022, 0.016), (s * 0.075, 0.66, 0.172), p.SLATE + 6),
            ((0.07, 0.17, 0.075), (s * 0.235, 0.3, 0.06), fur),
            ((0.095, 0.08, 0.18), (s * 0.15, 0.08, 0.2), fur),
            ((0.07, 0.07, 0.02), (s * 0.155, 0.085, 0.37), pale),
        ]
    made = assemble([place_copies(_ball(r, k if max(r) > 0.1 else max(5, k // 2), c), at) for r, at, c in pieces])
    return made._replace(vertices=(made.vertices * height / 0.87).astype(np.float32))


def beach_ball(radius: float, d: float) -> PaletteMesh:
    """A ball in six colours."""
    k = steps(30, d, 6) // 6 * 6
    made = _ball((radius,) * 3, k, 0)
    middle = made.vertices[made.faces].mean(axis=1)
    wedge = np.floor((np.arctan2(middle[:, 2], middle[:, 0]) + np.pi) / (2.0 * np.pi) * 6.0).astype(int) % 6
    return raised(made._replace(colour=np.array(COLOURS, np.uint8)[wedge]), radius - SINK / 4)


def blocks(d: float) -> PaletteMesh:
    """Seven wooden blocks: a stack of three, and four on the floor."""
    cube = box((0.07, 0.07, 0.07), (0, 0.034, 0), 0, 0.005 if d > SKETCH else 0.0)
    at = [
        (0, 0, 0),
        (0.004, 0.068, 0.003),
        (-0.004, 0.136, 0),
        (0.1, 0, 0.03),
        (0.14, 0, -0.09),
        (-0.13, 0, 0.05),
        (-0.02, 0, 0.17),
    ]
    return assemble(
        [place_copies(cube, at, [0.1, 0.4, -0.2, 0.9, 0.3, 1.3, 0.6], shade=[COLOURS[k % 6] for k in range(7)])]
    )


def rings(d: float) -> PaletteMesh:
    """Rings on a rod, with the largest at the bottom."""
    m, k = steps(8, d, 2), steps(22, d, 6)
    meshes = [revolve([(0.012, -SINK / 4), (0.012, 0.24), (0.02, 0.25), (0.012, 0.28), (0.0, 0.285)], k, p.WHITE)]
    for i in range(5):
        thick, reach = 0.022, 0.065 - 0.009 * i
        profile = [(0.0, 0.0), *arc((reach, thick), thick, -85, 85, m), (0.0, 2 * thick)]
        meshes.append(raised(revolve(profile, k, COLOURS[i]), 0.042 * i))
    return merge(*meshes)


def train(d: float) -> PaletteMesh:
    """A wooden engine with two wagons, along x."""
    bevel = 0.004 if d > SKETCH else 0.0
    wheel = revolve(
        [(0.0, -0.012), (0.026, -0.012), (0.026, 0.012), (0.008, 0.016), (0.0, 0.016)], steps(16, d, 5), p.RED
    )
    boiler = revolve([(0.0, 0.0), (0.03, 0.0), (0.033, 0.01), (0.033, 0.09), (0.0, 0.1)], steps(16, d, 5), p.TEAL)
    funnel = revolve([(0.009, 0.0), (0.009, 0.03), (0.017, 0.05), (0.0, 0.05)], steps(12, d, 5), p.SLATE)
    x = np.array([0.0, -0.19, -0.38])
    axles = [(c + a, 0.025, s * 0.042) for c in x for a in (-0.045, 0.045) for s in (-1, 1)]
    bodies = [box((0.16, 0.02, 0.07), (c, 0.042, 0), p.OAK, bevel) for c in x]
    load = [box((0.14, 0.05, 0.064), (c, 0.075, 0), colour, bevel) for c, colour in zip(x[1:], (p.YELLOW, p.BLUE))]
    cab = [
        box((0.055, 0.08, 0.066), (-0.045, 0.09, 0), p.RED, bevel),
        box((0.07, 0.012, 0.08), (-0.045, 0.134, 0), p.BLUE, bevel),
    ]
    return merge(
        *bodies,
        *load,
        *cab,
        assemble(
            [
                place_copies(wheel, axles, tilt=np.pi / 2),
                place_copies(boiler, (-0.02, 0.085, 0), np.pi / 2, tilt=np.pi / 2),
                place_copies(funnel, (0.05, 0.112, 0)),
            ]
        ),
    )
