"""Shapes of view factors, and their view factors in closed form [Howell, A Catalog of Radiation Heat Transfer
Configuration Factors, third edition]."""

import numpy as np

import antumbra as at


def rectangle(corner, u, v):
    """(2, 3, 3): two triangles, whose front is the side of u x v."""
    a, u, v = (np.array(each, float) for each in (corner, u, v))
    return np.array([[a, a + u, a + u + v], [a, a + u + v, a + v]])


def disk(height, radius, sign=1.0, sides=256):
    """(sides, 3, 3): a polygon of a disk's area, horizontal, about the z axis; sign -1: its front faces down."""
    radius = radius * np.sqrt(2.0 * np.pi / sides / np.sin(2.0 * np.pi / sides))
    angles = np.arange(sides) * 2.0 * np.pi / sides
    rim = np.stack([radius * np.cos(angles), radius * np.sin(angles), np.full(sides, height)], 1)
    after = np.roll(rim, -1, 0)
    first, second = (rim, after) if sign > 0 else (after, rim)
    return np.stack([np.broadcast_to([0.0, 0.0, height], rim.shape), first, second], 1)


def sphere(center, radius, steps=48):
    """(n, 3, 3): a sphere of latitudes and longitudes, of a true sphere's area; its front is outside."""
    lat = np.linspace(-np.pi / 2, np.pi / 2, steps + 1)
    lon = np.linspace(0.0, 2.0 * np.pi, 2 * steps + 1)
    at_corners = lambda i, j: np.stack(
        [np.cos(lat[i]) * np.cos(lon[j]), np.cos(lat[i]) * np.sin(lon[j]), np.sin(lat[i])], -1
    )
    i, j = (each.ravel() for each in np.meshgrid(np.arange(steps), np.arange(2 * steps), indexing="ij"))
    a, b, c, d = at_corners(i, j), at_corners(i, j + 1), at_corners(i + 1, j + 1), at_corners(i + 1, j)
    soup = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    areas = np.linalg.norm(np.cross(soup[:, 1] - soup[:, 0], soup[:, 2] - soup[:, 0]), axis=1) / 2.0
    soup = soup[areas > 1e-12] * np.sqrt(4.0 * np.pi / areas.sum())
    return soup * radius + center


def scene_of(*parts, up="z"):
    """A scene of soups, and the number of the part of each face."""
    numbers = np.repeat(np.arange(len(parts)), [len(each) for each in parts])
    return at.Scene.from_arrays(np.concatenate(parts), up=up), numbers


def box(size, sign=1.0):
    """Six rectangles, whose front is inside a box from (0, 0, 0); sign -1: outside."""
    x, y, z = np.diag(np.array(size, float))
    o = np.zeros(3)
    sides = [(o, x, y), (o, y, z), (o, z, x), (z, y, x), (x, z, y), (y, x, z)]
    return [rectangle(corner, *((u, v) if sign > 0 else (v, u))) for corner, u, v in sides]


# --- Closed forms -----------------------------------------------------------------------------------------------------


def parallel_rectangles(a, b, c):
    """C-11: equal, opposite rectangles a x b at distance c."""
    x, y = a / c, b / c
    p, q = np.sqrt(1 + x * x), np.sqrt(1 + y * y)
    log = np.log(np.sqrt((1 + x * x) * (1 + y * y) / (1 + x * x + y * y)))
    arcs = x * q * np.arctan(x / q) + y * p * np.arctan(y / p) - x * np.arctan(x) - y * np.arctan(y)
    return 2.0 / (np.pi * x * y) * (log + arcs)


def perpendicular_rectangles(length, width, height):
    """C-14: from a rectangle length x width to one length x height, at a right angle along the common edge."""
    w, h = width / length, height / length
    r = np.hypot(w, h)
    arcs = w * np.arctan(1 / w) + h * np.arctan(1 / h) - r * np.arctan(1 / r)
    w2, h2 = w * w, h * h
    s = 1 + w2 + h2
    log = np.log((1 + w2) * (1 + h2) / s)
    log += w2 * np.log(w2 * s / ((1 + w2) * (w2 + h2))) + h2 * np.log(h2 * s / ((1 + h2) * (w2 + h2)))
    return (arcs + log / 4) / (np.pi * w)


def coaxial_disks(first, second, distance):
    """C-41: from a disk to a parallel coaxial one."""
    a, b = first / distance, second / distance
    s = 1 + (1 + b * b) / (a * a)
    return (s - np.sqrt(s * s - 4 * (b / a) ** 2)) / 2


def sphere_to_disk(radius, distance):
    """C-122: from a sphere to a disk of a radius, whose centre is at a distance from the sphere's, on its axis."""
    return (1 - 1 / np.sqrt(1 + (radius / distance) ** 2)) / 2
