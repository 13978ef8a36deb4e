"""The base of commands of studies with one row per sensor: checks of sensors and outputs, and the writing of tables."""

import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from ..base.errors import InputError
from ..base.progress import ignore_progress, progress_listener
from ..base.wording import counted
from ..cli import console
from ..cli.options import outputs_of
from ..cli.study_run import Scenes, StudyCommand, Writers
from ..work.executors import UnitCollector

if TYPE_CHECKING:
    from ..work.executors import Executor
    from .sensors.sensors import Sensors
    from .tables.result_table import Table

_MANY = 4_000_000  # sensors whose needs are said
_SAMPLE = 4096  # of these, by which they are judged

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

    @property
    def partitioned(self) -> bool:
        """Whether an output is a folder of partitions, which are written by whoever computes a block."""
        from .tables.parquet_files import PARTITIONED

        return any(path.suffix.lower() == PARTITIONED for path in self.paths("output"))

    def check(self) -> None:
        from .sensors.sensor_files import check_sensors

        check_sensors(self.sensor_form)

    def check_output(self, path: Path) -> None:
        from .sensors.sensor_files import kind_of
        from .tables.result_table import writer_of

        writer_of(path, kind_of(self.sensor_form))

    def close(self, result: _Result) -> None:
        self.table_of(result).close()

    def check_room(self, sensors: Any, study: "Callable[[Sensors], Table]", executor: "Executor | None") -> Any:
        """Say what many described sensors need, and return them. InputError, before the work, if it cannot fit.

        study : the table of some sensors, which is the sample that output files are judged by
        """
        from ..base.files import check_disk_space
        from ..base.memory import check_reading, readable_size
        from .sensors.sensor_blocks import DescribedSensors
        from .tables.table_blocks import ROW_BYTES, WRITTEN_BY_BLOCK, file_bytes

        is_node = isinstance(executor, UnitCollector)  # which writes no outputs
        if is_node or not isinstance(sensors, DescribedSensors) or len(sensors) < _MANY:
            return sensors
        names = [name for name in outputs_of(type(self)) if name != "matrix"]  # whose rows are written one by one
        files = [path for name in names for path in self.paths(name)]
        whole = [path.name for path in files if path.suffix.lower() not in WRITTEN_BY_BLOCK]
        n = len(sensors)
        if whole:
            by_block = ", ".join(WRITTEN_BY_BLOCK)
            check_reading(
                ROW_BYTES * n, f"{whole[0]}: a table of {counted(n, 'sensor')} in memory, unlike {by_block} files,"
            )
            return sensors
        needs, sizes, total = list[str](), list[float](), 0.0  # executors judge finished parts
        with (
            warnings.catch_warnings(action="ignore", category=UserWarning),  # the study issues them, too
            suppress(InputError),
            progress_listener(ignore_progress),
        ):
            table = study(sensors.block(n // 2, n // 2 + _SAMPLE))
            sizes = [file_bytes(table, n, path) for path in files if len(table)]
        for path, taken in zip(files, sizes):
            needs.append(f"{path.name} up to about {readable_size(taken)}")
            check_disk_space(path, int(total := total + taken))
        if not self.quiet and needs:
            console.say(f"note: {n:,} sensors by block; of disk space, {', '.join(needs)} (judged by {_SAMPLE:,})")
        return sensors

    def check_sheet(self, sheet: Any, scenes: Scenes) -> None:
        from .tables.map_sheet import check_scale

        if sheet.scale is not None and getattr(self, "areas", None) is None:  # else the cells are those of the areas
            grouped = getattr(self.options, "per", "sensor") != "sensor"
            check_scale(scenes.sensors(self.sensor_form, self.threads), scenes.planted, sheet, grouped)

    def writers(self, result: _Result, scenes: Scenes) -> Writers:
        table, column = self.table_of(result), getattr(self, "column", None)
        return {"output": partial(table.save, column=column), "map": partial(table.save_map, column=column)}
