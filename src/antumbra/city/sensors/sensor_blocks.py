"""Sensors that are described and made a block at a time, where they are needed, so that memory is that of a block.

A block is a range of the sensors' numbers. It has the same bits as in the sensors made at once.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol, cast

import numpy as np

from ...base.errors import InputError
from ...engine.scene import AnyScene
from ...scene.raster import CellWindow, Raster, window_within
from ...work.scene_records import scene_digest
from .sensors import Sensors, areas_of, face_sensors, raster_cells, sensors_on_faces
from .surface_grid import grid_counts, grid_on_faces, grid_sensors


class SensorBlocks(Protocol):
    """Sensors, made by block. `Sensors` are their own."""

    @property
    def kind(self) -> str: ...

    @property
    def sided(self) -> bool:
        """Whether they have normals."""
        ...

    @property
    def description(self) -> list[Any]:
        """What determines them, for digests: arrays and JSON values."""
        ...

    def __len__(self) -> int:
        """The number of sensors, or more if some are left out of their blocks."""
        ...

    def block(self, first: int, last: int) -> Sensors:
        """The sensors from `first` to `last`, exclusive."""
        ...


class DescribedSensors(ABC):
    """Sensors that are not in memory: `SensorBlocks`."""

    kind: str
    sided: bool

    @property
    @abstractmethod
    def description(self) -> list[Any]: ...

    @property
    def attributes_description(self) -> list[Any]:
        """What determines the other columns of a user's table, for digests; empty: there are none."""
        return []

    @abstractmethod
    def __len__(self) -> int: ...

    @abstractmethod
    def block(self, first: int, last: int) -> Sensors: ...

    @abstractmethod
    def whole(self) -> Sensors:
        """All at once."""


@dataclass(frozen=True)
class RasterBlocks(DescribedSensors):
    """Those of `raster_sensors`.

    own : whether the cells are those of the scene's own raster
    window : of the raster; None: all of it
    """

    scene: AnyScene
    raster: Raster
    height: float
    follow: bool
    own: bool
    threads: int | None = None
    window: CellWindow | None = None
    kind = "raster"
    sided = True

    def __len__(self) -> int:
        return (self.window or self.raster).n_cells

    @property
    def description(self) -> list[Any]:
        of, digest = [*self.raster, *(self.window or ())], scene_digest(self.scene, 0.0, self.threads)
        return ["raster", *of, self.height, self.follow, digest]

    def block(self, first: int, last: int) -> Sensors:
        return replace(self._cells(range(first, last)), on_surfaces=self._on_surfaces)

    def whole(self) -> Sensors:
        return self._cells(None)

    @cached_property
    def _on_surfaces(self) -> bool:
        """Whether any cell lies on a surface that the raster follows; usually, one of the first does."""
        n = len(self) if self.follow else 0
        blocks = (self._cells(range(first, min(first + _CELLS, n))) for first in range(0, n, _CELLS))
        return any((cells.faces >= 0).any() for cells in blocks if cells.faces is not None)

    def _cells(self, cells: range | None) -> Sensors:
        return raster_cells(
            self.scene, self.raster, self.height, self.follow, self.own, cells, threads=self.threads, window=self.window
        )


def cells_within(sensors: SensorBlocks, bounds: Sequence[float]) -> RasterBlocks:
    """The cells of a raster with centres in bounds, (x0, n0, x1, n1). InputError if they are no raster, or none is."""
    if not isinstance(sensors, RasterBlocks):
        raise InputError("bounds are for the sensors raster in a single state and without areas; leave bounds out")
    return replace(sensors, window=window_within(sensors.raster, bounds))


_CELLS = 1 << 14  # looked at together for a surface
_FACES = 1 << 18  # faces whose areas are computed at a time


@dataclass(frozen=True)
class SurfaceBlocks(DescribedSensors):
    """Those of `face_sensors`, or of `grid_sensors` with a spacing."""

    scene: AnyScene
    spacing: float | None
    lift: float
    sided = True

    @property
    def kind(self) -> str:  # type: ignore[override]
        return "face" if self.spacing is None else "grid"

    def __len__(self) -> int:
        return int(self._ends[-1]) if len(self._ends) else 0

    @property
    def description(self) -> list[Any]:
        return [self.kind, self.spacing, self.lift, scene_digest(self.scene, 0.0)]

    @cached_property
    def _ends(self) -> np.ndarray:
        """(faces,) int64: the number of sensors on each face and all before it."""
        if self.spacing is not None:
            return np.cumsum(grid_counts(self.scene, self.spacing))
        counts, n = [np.empty(0, bool)], self.scene.n_triangles
        for first in range(0, n, _FACES):
            faces = np.arange(first, min(first + _FACES, n))
            counts.append(areas_of(self.scene.data.corners(0.0, faces))[1] > 0.0)
        return np.cumsum(np.concatenate(counts))

    def block(self, first: int, last: int) -> Sensors:
        face, end = np.searchsorted(self._ends, [first, max(first, last - 1)], "right").tolist()
        faces = range(face, min(end + 1, len(self._ends)))
        before = int(self._ends[face - 1]) if face else 0
        places = range(first - before, last - before)
        if self.spacing is not None:
            return grid_on_faces(self.scene, self.spacing, self.lift, faces, places)
        on_faces = sensors_on_faces(self.scene, faces, self.lift)
        return on_faces.take(np.arange(places.start, places.stop))

    def whole(self) -> Sensors:
        if self.spacing is not None:
            return grid_sensors(self.scene, self.spacing, lift=self.lift)
        return face_sensors(self.scene, lift=self.lift)


@dataclass(frozen=True)
class ChangedBlocks(DescribedSensors):
    """Sensors that are moved, or some of which are left out, in each block.

    by : what determines the change, for digests
    """

    source: SensorBlocks
    change: Callable[[Sensors], Sensors]
    by: Any

    @property
    def kind(self) -> str:  # type: ignore[override]
        return self.source.kind

    @property
    def sided(self) -> bool:  # type: ignore[override]
        return self.source.sided

    @property
    def description(self) -> list[Any]:
        return [*self.source.description, self.by]

    @property
    def attributes_description(self) -> list[Any]:
        return self.source.attributes_description if isinstance(self.source, DescribedSensors) else []

    def __len__(self) -> int:
        return len(self.source)

    def block(self, first: int, last: int) -> Sensors:
        return self.change(self.source.block(first, last))

    def whole(self) -> Sensors:
        return self.change(self.source if isinstance(self.source, Sensors) else cast(Any, self.source).whole())
