"""The length unit of a scene: the one place that knows what a number of its coordinates means.

Lengths in results are in the unit of the scene and say so; areas are in square metres, and energies in kWh. Rules in
metres, such as the height of a kerb, are converted to the scene's unit.
"""

from typing import NamedTuple

from ..base.checks import quoted, spelling_hint
from ..base.errors import InputError


class LengthUnit(NamedTuple):
    """A unit of length, such as the metre or the foot."""

    name: str  # its symbol, such as "m" or "us-ft", in columns and messages
    metres: float  # its length

    @property
    def square_metres(self) -> float:
        """The area of a square of this side."""
        return self.metres * self.metres

    def of_metres(self, length: float) -> float:
        """A length in metres, in this unit."""
        return length / self.metres

    def same_as(self, other: "LengthUnit") -> bool:
        """Whether lengths in both units mean the same; the survey foot and the international foot count as equal."""
        return abs(self.metres - other.metres) <= _SAME * self.metres


_SAME = 1e-4

METRE = LengthUnit("m", 1.0)

UNITS = {
    unit.name: unit
    for unit in (
        METRE,
        LengthUnit("mm", 0.001),
        LengthUnit("cm", 0.01),
        LengthUnit("dm", 0.1),
        LengthUnit("km", 1000.0),
        LengthUnit("in", 0.0254),
        LengthUnit("ft", 0.3048),
        LengthUnit("us-ft", 1200.0 / 3937.0),
    )
}
"""Symbol -> unit, of all units that a user can name."""

_NAMES = {
    "mm": ("millimetre", "millimeter", "millimetres", "millimeters"),
    "cm": ("centimetre", "centimeter", "centimetres", "centimeters"),
    "dm": ("decimetre", "decimeter", "decimetres", "decimeters"),
    "m": ("metre", "meter", "metres", "meters"),
    "km": ("kilometre", "kilometer", "kilometres", "kilometers"),
    "in": ("inch", "inches"),
    "ft": ("foot", "feet", "international foot", "international feet"),
    "us-ft": (
        "ftus", "us-foot", "us foot", "us survey foot", "us survey feet", "survey foot", "foot us", "foot_us",
        "u.s. foot", "us_survey_foot",
    ),
}  # fmt: skip

_OF_NAME = {name: UNITS[symbol] for symbol, names in _NAMES.items() for name in (symbol, *names)}


class Metres(float):
    """A length in metres, as the default of an option whose other values are in the unit of the scene."""


def unit_named(name: str) -> LengthUnit | None:
    """The unit of a name as files write it, such as "metre", "Foot_US" or "dm"; None if it is unknown."""
    return _OF_NAME.get(name.strip().lower())


def unit_of_factor(name: str, metres: float) -> LengthUnit:
    """The unit of a length in metres, with the symbol of `UNITS` if it is one of these, else with its own name."""
    known = (unit for unit in UNITS.values() if abs(unit.metres - metres) <= 1e-9 * metres)
    return next(known, LengthUnit(name, metres))


def checked_unit(unit: "str | LengthUnit") -> LengthUnit:
    """A unit from its name or symbol.

    Raises
    ------
    InputError
        If the name is unknown; the message lists the symbols.
    """
    if isinstance(unit, LengthUnit):
        return unit
    known = unit_named(unit) if isinstance(unit, str) else None
    if known is None:
        hint = spelling_hint(unit, UNITS) if isinstance(unit, str) else ""
        raise InputError(f"unit is {quoted(unit)}; {hint}it must be one of {', '.join(UNITS)}")
    return known
