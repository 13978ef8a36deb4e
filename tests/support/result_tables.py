"""Tables of results to write: a hill with sensors of each kind."""

import numpy as np

import antumbra as at
from antumbra.city.tables.result_table import Column, Table


def hill(up="z", offset=(0.0, 0.0, 0.0)):
    """A pyramid of four faces, 10 x 10 wide and 5 high; the ground is open."""
    corners = np.array([[0, 0, 0], [10, 0, 0], [10, 10, 0], [0, 10, 0], [5, 5, 5]], float)
    if up == "y":
        corners = np.stack([corners[:, 0], corners[:, 2], -corners[:, 1]], 1)
    return at.Scene.from_arrays(corners + offset, [[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]], up=up, name="hill")


def table(kind="face", **about):
    """A table of numbers, whole numbers and times; the first number is NaN, the first whole number is -1."""
    scene = hill()
    if kind == "face":
        sensors = at.face_sensors(scene)
    elif kind == "vertex":
        sensors = at.vertex_sensors(scene)
    elif kind == "grid":
        sensors = at.grid_sensors(scene, 1.0)
    elif kind == "raster":
        sensors = at.raster_sensors(scene, 1.0, bounds=[(-2, 0), (10, 10)])
    else:
        sensors = at.point_sensors(np.random.default_rng(0).uniform(0, 10, (20, 3)))
    n = len(sensors)
    hours, times = np.linspace(0, 8, n), np.datetime64("2025-06-21T04:00") + np.arange(n)
    hours[0], times[0] = np.nan, np.datetime64("NaT")
    columns = {
        "hours": Column(hours, "h", "hours of sun"),
        "first": Column(times, "", "first sun"),
        "count": Column(np.arange(n) - 1, "", "whole numbers"),
    }
    return Table(sensors, columns, {"job": "test", **about}, scene)
