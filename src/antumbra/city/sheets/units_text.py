"""Units as sheets write them, and areas in the unit of a scene's coordinates."""

import re

from ...scene.units import METRE, LengthUnit

_SQUARE = re.compile(r"(?<=[mt])2\b")  # of metres and feet
FOOT_UNITS = "ft", "us-ft"
"""Names of the units that are feet."""

_LARGE = 1e6  # square metres: larger areas are in square kilometres


def unit_text(unit: str) -> str:
    """A unit of a table, such as "kWh/m2", with its exponent raised."""
    return _SQUARE.sub("²", unit)


def area_unit(unit: LengthUnit) -> LengthUnit:
    """The unit whose square is that of areas: feet if coordinates are in feet, otherwise metres."""
    return unit if unit.name in FOOT_UNITS else METRE


def area_text(square_metres: float, unit: LengthUnit) -> str:
    """An area, in the unit of the coordinates if that is a foot, otherwise in square metres or kilometres."""
    own = area_unit(unit)
    if own is METRE and square_metres >= _LARGE:
        return f"{square_metres / _LARGE:,.4g} km²"
    area = square_metres / own.square_metres
    return f"{area:,.0f} {own.name}²" if area >= 1000.0 else f"{area:,.4g} {own.name}²"
