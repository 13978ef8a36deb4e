"""Results of sensors as resumable parts, each of a block of sensors that is made where it is computed."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...work.work_parts import Arrays, Parts
from .point_checks import Note, joined_notes, tell
from .sensor_blocks import SensorBlocks
from .sensors import Sensors

NOTES = "notes"
"""Array of a part: `Note.number` and `Note.about` of each note, as JSON."""

ROWS = "rows"
"""Array of a part: its number of sensors."""


class BlockParts:
    """Arrays with a row for each sensor.

    what : name of the work, for users
    size : sensors of a block
    work : computes the arrays of a block
    folder, about : as for `Parts`
    notes : finds notes on a block, which become part of it
    """

    def __init__(
        self, what: str, source: SensorBlocks, size: int, work: Callable[[Sensors], Arrays], folder: Path | None,
        about: dict[str, str] | None, notes: Callable[[Sensors], Sequence[str]] | None = None,
    ):  # fmt: skip
        self.source, self._work, self._notes = source, work, notes
        self.parts = Parts(what, len(source), size, self._part, folder, about)

    def _part(self, first: int, last: int) -> Arrays:
        sensors = self.source.block(first, last)
        arrays = {**self._work(sensors), ROWS: np.array(len(sensors))}
        if self._notes is not None:
            found = [note for note in self._notes(sensors) if isinstance(note, Note)]
            arrays[NOTES] = np.array(json.dumps([(note.number, note.about) for note in found]))
        return arrays

    def whole(self) -> Arrays:
        """The arrays of all sensors, once all parts are done; only once for parts in memory."""
        if not len(self.parts):
            return self._work(self.source.block(0, 0))
        return self.parts.taken([name for name in self.parts[0] if name not in (NOTES, ROWS)])

    def counts(self) -> list[int]:
        """The number of sensors of each part, once all are done."""
        return [int(self.parts[k][ROWS]) for k in range(len(self.parts))]

    def notes(self) -> list[str]:
        """The notes on all sensors, once all parts are done."""
        blocks: list[Any] = [json.loads(str(self.parts[k][NOTES])) for k in range(len(self.parts))]
        return joined_notes(blocks, sum(self.counts()))


def warned_by_block(earlier: list[str], blocks: BlockParts) -> dict[str, list[str]]:
    """Issue the notes of all parts, as `tell`; return them after `earlier` ones as metadata of the study."""
    found = blocks.notes()
    tell(found)
    return {"warnings": [*earlier, *found]} if earlier or found else {}
