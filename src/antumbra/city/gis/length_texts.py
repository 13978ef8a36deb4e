"""Lengths in columns of text, as OpenStreetMap writes them: 12, 12 m, 40 ft, 5'3"."""

import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...scene.units import UNITS

_NUMBER = r"(\d+(?:\.\d*)?|\.\d+)"
_PLAIN = re.compile(rf"[+-]?{_NUMBER}(?:[eE][+-]?\d+)?|[+-]?(?:inf|infinity|nan)", re.IGNORECASE)
_WITH_UNIT = re.compile(rf"([+-]?){_NUMBER}\s*(m|cm|km|ft|in)")
_FEET = re.compile(rf"([+-]?){_NUMBER}\s*'(?:\s*{_NUMBER}\s*(?:\"|''))?")

LENGTH_FORMS = "12.5, 12.5 m, 40 ft or 5'3\""
"""What `lengths_in` reads."""

STOREY = 3.0
"""Metres per storey, as renderers of OpenStreetMap assume."""


def counts_storeys(column: str) -> bool:
    """Whether a column counts storeys, such as building:levels."""
    return re.search(r"(?:^|[:_])levels$", column.lower()) is not None


def lengths_in(column: Any, metres: float) -> tuple[NDArray[np.float64], NDArray[np.object_]]:
    """The lengths in a column of texts or numbers, and the texts that are none.

    Parameters
    ----------
    column : (n,) array of numbers, texts and missing values
    metres : float
        Per unit of the coordinates. Numbers without a unit are in that of the coordinates.

    Returns
    -------
    lengths : (n,) float64
        NaN where a value is missing, or is no length.
    unread : (n,) object
        None, or the text that is no length.

    Notes
    -----
    The units are those that OpenStreetMap documents for the key ``height``. Decimal commas and lists such as "3;4" are
    not among them.
    """
    values = np.asarray(column)
    lengths, unread = np.full(len(values), np.nan), np.full(len(values), None, object)
    if values.dtype.kind in "fiu":
        return values.astype(np.float64), unread
    for k, value in enumerate(values.tolist()):
        text = "" if value is None or value != value else str(value).strip()
        length = _length(text, metres)
        if length is not None:
            lengths[k] = length
        elif text:
            unread[k] = text
    return lengths, unread


def _length(text: str, metres: float) -> float | None:
    """A length in units of the coordinates; None if the text is none."""
    if _PLAIN.fullmatch(text):
        return float(text)
    if match := _WITH_UNIT.fullmatch(text):
        sign, number, unit = match.groups()
        length = float(number) * UNITS[unit].metres
    elif match := _FEET.fullmatch(text):
        sign, feet, inches = match.groups()
        length = float(feet) * UNITS["ft"].metres + float(inches or 0.0) * UNITS["in"].metres
    else:
        return None
    return (-length if sign == "-" else length) / metres
