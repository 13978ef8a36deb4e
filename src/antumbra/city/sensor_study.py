"""The base of commands of studies with one row per sensor: checks of sensors and outputs, and the writing of tables."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from ..cli import console
from ..cli.options import outputs_of
from ..cli.study_run import Scenes, StudyCommand, Writers

if TYPE_CHECKING:
    from .tables.result_table import Table

_MANY = 4_000_000  # sensors whose needs are said

_Options = TypeVar("_Options")
_Result = TypeVar("_Result")


@dataclass(frozen=True, kw_only=True)
class SensorStudy(StudyCommand[_Options, _Result]):
    """The command of a study whose result is a table, or has one, with a row for each sensor.

    A subclass has the fields `sensors` and `column`, too.
    """

    def table_of(self, result: _Result) -> "Table":
        """The table of the result."""
        table: Any = result
        return table  # type: ignore[no-any-return]

    def about_of(self, result: _Result) -> dict[str, Any]:
        return self.table_of(result).about

    def compared(self, before: _Result, after: _Result, scenes: Scenes) -> _Result:
        from .changes.before_and_after import before_and_after

        return self.with_table(after, before_and_after(self.table_of(before), self.table_of(after)))

    def with_table(self, result: _Result, table: "Table") -> _Result:
        """The result with another table."""
        new: Any = table
        return new  # type: ignore[no-any-return]

    @property
    def sensor_form(self) -> str:
        """The text of the sensors."""
        given: str | None = getattr(self, "sensors", None)
        return given or ("raster" if self.spec.on_raster else "face")

    def check(self) -> None:
        from .sensors.sensor_files import check_sensors

        check_sensors(self.sensor_form)

    def check_output(self, path: Path) -> None:
        from .sensors.sensor_files import kind_of
        from .tables.result_table import writer_of

        writer_of(path, kind_of(self.sensor_form))

    def close(self, result: _Result) -> None:
        self.table_of(result).close()

    def check_room(self, sensors: Any) -> Any:
        """Say what many described sensors need, and return them. InputError, before the work, if it cannot fit."""
        from ..base.memory import check_reading, readable_size
        from .sensors.sensor_blocks import DescribedSensors
        from .tables.table_blocks import ROW_BYTES, WRITTEN_BY_BLOCK

        if not isinstance(sensors, DescribedSensors) or len(sensors) < _MANY:
            return sensors
        names = [name for name in outputs_of(type(self)) if name != "matrix"]  # whose rows are written one by one
        files = [path for name in names for path in self.paths(name)]
        whole = [path.name for path in files if path.suffix.lower() not in WRITTEN_BY_BLOCK]
        size, n = ROW_BYTES * len(sensors), len(sensors)
        if whole:
            by_block = ", ".join(WRITTEN_BY_BLOCK)
            check_reading(size, f"{whole[0]}: a table of {n:,} sensors in memory, unlike {by_block} files,")
        elif not self.quiet:
            console.say(
                f"note: {n:,} sensors by block; finished parts take about {readable_size(size / 3)} of disk space"
            )
        return sensors

    def check_sheet(self, sheet: Any, scenes: Scenes) -> None:
        from .tables.map_sheet import check_scale

        if sheet.scale is not None and getattr(self, "areas", None) is None:  # else the cells are those of the areas
            grouped = getattr(self.options, "per", "sensor") != "sensor"
            check_scale(scenes.sensors(self.sensor_form, self.threads), scenes.planted, sheet, grouped)

    def writers(self, result: _Result, scenes: Scenes) -> Writers:
        table, column = self.table_of(result), getattr(self, "column", None)
        return {"output": partial(table.save, column=column), "map": partial(table.save_map, column=column)}
