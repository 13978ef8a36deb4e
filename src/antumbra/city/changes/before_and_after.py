"""Tables of two states on the same sensors as one: the values before, the values after, and the loss of each quantity.

A quantity ``Q`` of the study has the columns ``Q_loss``, before minus after, which pictures show unless another column
is named; ``Q_before``; and ``Q``, after. What is no quantity, such as a time, a name or a yes or no, has no loss.
"""

import numpy as np

from ...base.checks import checked_instance
from ...base.errors import InputError
from ..tables.result_table import Column, Table
from ..tables.surface_columns import NAMES

BEFORE, LOSS = "_before", "_loss"
"""Ends of the names of columns."""

_DESCRIPTIVE = (*NAMES, "sensors", "point", "x2", "y2", "z2")  # of sensors and pairs, in both states
_NO_LOSS = "first", "nearest", "face", "object", "distance", "px", "py", "pz"  # which one, and where it is


def before_and_after(before: Table, after: Table) -> Table:
    """Join the tables of two states into one, with the rows, the scene and the picture of the second state.

    Parameters
    ----------
    before, after : Table
        Of the same study on the same sensors, as `SceneChange.compare` makes them.

    Returns
    -------
    Table
        For each quantity Q its loss, before minus after, "Q_loss", "Q_before", and after, "Q"; for times, names, and
        yes and no, "Q_before" and "Q". A loss is NaN where either value is missing. Columns that describe the sensors
        stand once. Verdicts of daylight rules compare the states, and are joined per dwelling or area afterwards.

    Raises
    ------
    InputError
        If the sensors differ.
    """
    checked_instance(before, Table, "before")
    checked_instance(after, Table, "after")
    if before.made_from is not None and after.made_from is not None:  # the joined states are judged and grouped
        return after.made_from.make(before_and_after(before.made_from.table, after.made_from.table))
    if not np.array_equal(before.sensors.points, after.sensors.points):
        raise InputError("before and after have other sensors; give both studies the same Sensors")
    columns = dict[str, Column]()
    names = [*after.columns, *(name for name in before.columns if name not in after.columns)]
    for name in names:
        earlier, later = before.columns.get(name), after.columns.get(name)
        if (name in _DESCRIPTIVE or (name == "length" and before.about.get("job") == "los")) and later is not None:
            columns[name] = later
        elif earlier is None or later is None:  # hours of a month, for example, that one state lacks
            raise InputError(f"the column {name!r} is in one state only; compare two runs of the same study")
        else:
            columns |= _of_states(name, earlier, later)
    return Table(after.sensors, columns, {**after.about}, after.scene, after.camera, after.marks, after.row_of_face)


def _of_states(name: str, before: Column, after: Column) -> dict[str, Column]:
    """The columns of a quantity, or of a time, a name, or a yes or no."""
    columns = {name + BEFORE: before._replace(about=f"{before.about}, before"), name: after}
    if before.values.dtype.kind not in "fiu" or name in _NO_LOSS:
        return columns
    kind = np.float64 if before.values.dtype.kind == "f" else np.int64
    loss = before.values.astype(kind) - after.values.astype(kind)
    return {name + LOSS: Column(loss, after.unit, f"loss of {after.about}, before minus after"), **columns}
