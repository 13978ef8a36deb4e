"""Results whose sheets are drawn: a site with windows, a hill with an observer, a garden, and lines of sight."""

import numpy as np

import antumbra as at
import city_files
from antumbra.city.shadow.shadow_map import shadow_report
from antumbra.city.skyline.horizon_diagram import horizon_report
from antumbra.city.tables.map_sheet import table_report
from antumbra.city.tables.result_table import Column, Table
from antumbra.scene.units import UNITS

PLACE = at.Place(52.0, 4.36, north=12.0, timezone="Europe/Amsterdam")


def slab(west, south, east, north, low, high):
    """(12, 3, 3): the faces of an upright box."""
    corners = np.array([[x, y, z] for z in (low, high) for x, y in
                        ((west, south), (east, south), (east, north), (west, north))], float)  # fmt: skip
    return [corners[[quad[0], *pair]] for quad in city_files.CUBE_FACES for pair in (quad[1:3], quad[2:4])]


def site(unit="m"):
    """Three blocks on a square, in a unit of length."""
    blocks = (-30, 10, -5, 22, 0, 12), (5, 8, 30, 20, 0, 15), (-25, -30, 20, -15, 0, 22)
    faces = np.array([face for each in ((-60, -60, 60, 60, -1, 0), *blocks) for face in slab(*each)])
    return at.Scene.from_arrays(faces / UNITS[unit].metres, up="z", unit=unit, name="River Street")


def windows(unit="m"):
    """Twelve windows of two facades on two storeys, with ids and dwellings; two of them fail."""
    scene, names = site(unit), [f"{house}{storey}.{k}" for house in "AB" for storey in (1, 2) for k in (1, 2, 3)]
    places = [(west + (k + 0.5) * 25 / 3, south - 0.02, 1.5 + 3 * storey)
              for west, south in ((-30, 10), (5, 8)) for storey in (0, 1) for k in range(3)]  # fmt: skip
    points, ids = np.array(places) / UNITS[unit].metres, np.array(names, object)
    sensors = at.Sensors(
        points, np.tile([0.0, -1.0, 0.0], (12, 1)), None, None, "points", attributes={"id": ids, "dwelling": ids.copy()}
    )
    hours = np.linspace(0.5, 6.0, 12)
    columns = {
        "sun_hours": Column(hours, "h", "hours of direct sun"),
        "en17037_passes": Column(hours > 1.5, "", "whether the window meets EN 17037"),
        "sun_hours_loss": Column(hours - 2.0, "h", "hours of sun lost"),
        "energy": Column(hours * 100, "kWh/m2", "energy of direct light"),
    }
    about = {
        "job": "sun", **PLACE._asdict(), "first": "2026-03-21T07:15:00", "last": "2026-03-21T18:45:00", "suns": 24,
        "hours": 12.0, "step": 30.0, "samples": 1, "warnings": ["the time zone is unusual"],
        "rules": [
            {"name": "en17037-minimum", "citation": "EN 17037:2018, level minimum", "text": "At least 1.5 hours.",
             "notes": "The sky is clear."},
        ],
    }  # fmt: skip
    return Table(sensors, columns, about, scene)


def hills():
    """A viewshed of one observer on a raster of heights."""
    north, east = np.mgrid[0:30, 0:40] * 25.0
    heights = 30.0 * np.sin(east / 160.0) * np.cos(north / 130.0)
    scene = at.from_raster((heights, (25.0, 0.0, 85000.0, 0.0, -25.0, 450000.0), "EPSG:28992"))
    return at.viewshed(scene, "raster+1.6", [[85500.0, 449600.0, 0.0]], on_surface=True, eye_height=1.7).table


def roofs(unit="m"):
    """Hours of sun on each cell of a raster."""
    made = at.sun_hours(site(unit), f"raster:{6 / UNITS[unit].metres:.6f}", "2026-03-21", place=PLACE, step=120)
    made.about["areas"] = [
        {"name": "garden", "cells": 9, "left_out": 1, "sun_hours": 2.5, "share": 0.75, "passes": True}
    ]
    return made


def reports():
    """Name -> function that makes a report with the options of a sheet."""

    def of_table(table, column):
        return lambda sheet: table_report(table, column, sheet)

    cases = {
        "verdicts": of_table(windows(), "en17037_passes"),
        "losses in feet": of_table(windows("us-ft"), "sun_hours_loss"),
    }
    cases |= {"viewshed": of_table(hills(), "seen"), "raster in feet": of_table(roofs("us-ft"), "sun_hours")}
    faces = at.sun_hours(site(), "face", "2026-03-21", place=PLACE, step=240)
    cases["faces"] = of_table(faces, "sun_hours")
    sky = at.skyline(site(), [[0.0, 0.0, 1.6]], azimuth_step=5.0)
    cases["skyline"] = lambda sheet: horizon_report(sky, 0, PLACE)
    return cases


def shadows():
    """Name -> function that makes the report of a shadow; they need shapely."""
    moment = at.shadow(site("ft"), at="2026-03-21T15:00", place=PLACE)
    days = at.shadow(site(), days="2026-03-21", cell=4.0, step=120, place=PLACE)
    return {"shadow in feet": lambda sheet: shadow_report(moment), "hours of shadow": lambda sheet: shadow_report(days)}
