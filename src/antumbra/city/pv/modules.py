"""Photovoltaic modules as rectangles, fixed or turning with the sun, and tables of modules."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...base.checks import as_array, listed, number, quoted, text, whole_number
from ...base.errors import InputError
from ...base.extras import import_extra
from ...base.wording import counted
from ...sun.sun_positions import directions_of
from ..sensors.point_attributes import Attributes, names_of_rows
from ..sensors.sensors import Sensors

_LATTICE = 4, 4
_MOST_POINTS = 64  # of a module, along a side
_NUMBERS = "tilt", "azimuth", "width", "height", "axis_azimuth", "axis_tilt", "max_angle", "gcr"
COLUMNS = (*_NUMBERS, "string")
"""Columns of a table of modules, besides their positions and id or name."""


class _ModuleFields(NamedTuple):
    position: tuple[float, float, float]  # world coordinates of its middle
    width: float  # world units
    height: float  # world units, along its slope
    tilt: NDArray[np.float64]  # () or (n,) degrees
    azimuth: NDArray[np.float64]  # () or (n,) degrees
    string: str  # empty: none
    lattice: tuple[int, int]  # sample points along the width and the height


class PvModule(_ModuleFields):
    """A photovoltaic module: a flat rectangle, which is fixed or turns about its middle.

    position : (3,) float
        World coordinates of its middle.
    width, height : float
        World units: its level side, and the one along its slope. 0 and 0: a point, which shades nothing.
    tilt, azimuth : float or (n,) float
        Degrees: of its plane, as pvlib's ``surface_tilt``, from 0 to 90, and ``surface_azimuth``, clockwise from true
        north. One value per time for a tracker; NaN at night is taken as level.
    string : str
        The string that it belongs to. Empty: none.
    lattice : (int, int)
        Sample points along the width and the height, 1 to 64 each. A point has one.

    Examples
    --------
    >>> module = at.PvModule((0, 0, 1), width=1.0, height=2.0, tilt=30)
    >>> module.area, module.turns
    (2.0, False)
    """

    __slots__ = ()

    def __new__(
        cls, position: ArrayLike, width: float = 0.0, height: float = 0.0, tilt: ArrayLike = 0.0,
        azimuth: ArrayLike = 180.0, string: str = "", lattice: tuple[int, int] = _LATTICE,
    ) -> "PvModule":  # fmt: skip
        x, y, z = (
            number(each, "a coordinate of a module", -np.inf, np.inf) for each in listed(position, "position", 3)
        )
        size = [
            number(each, f"the {name} of a module", 0.0, np.inf, "[)")
            for each, name in ((width, "width"), (height, "height"))
        ]
        if (size[0] == 0.0) != (size[1] == 0.0):
            raise InputError("a module has a width and a height, or neither; give both")
        planes = _angles(tilt, "tilt", 0.0, 90.0), _angles(azimuth, "azimuth", -360.0, 360.0)
        across, along = (whole_number(each, "lattice", 1, _MOST_POINTS) for each in listed(lattice, "lattice", 2))
        points = (across, along) if size[0] else (1, 1)
        return super().__new__(cls, (x, y, z), size[0], size[1], *planes, text(string, "string"), points)

    @property
    def turns(self) -> bool:
        """Whether it is on a tracker."""
        return self.tilt.ndim > 0 or self.azimuth.ndim > 0

    @property
    def area(self) -> float:
        """Square world units."""
        return self.width * self.height


def _angles(value: ArrayLike, name: str, low: float, high: float) -> NDArray[np.float64]:
    """() or (n,) float64: angles of a plane."""
    angles = np.asarray(as_array(value, f"the {name} of a module"), np.float64)
    if angles.ndim > 1:
        raise InputError(f"the {name} of a module must be a number, or one per time, not {angles.shape}")
    if angles.ndim == 0 and np.isnan(angles):
        raise InputError(f"the {name} of a module is NaN; give degrees")
    angles = np.where(np.isnan(angles), 0.0, angles)
    if (angles < low).any() or (angles > high).any():
        wrong = float(angles[(angles < low) | (angles > high)].flat[0]) if angles.ndim else float(angles)
        raise InputError(f"the {name} of a module (degrees) is {wrong:g}; it must be from {low:g} to {high:g}")
    return angles


class Planes(NamedTuple):
    """The sample points and the corners of modules at one time."""

    points: NDArray[np.float64]  # (p, 3) world, those of each module together
    normals: NDArray[np.float64] | None  # (p, 3); None: free points
    corners: NDArray[np.float64]  # (f, 3, 3): two triangles for each module with an area


class Modules(NamedTuple):
    """Named modules of one study."""

    names: list[str]
    each: list[PvModule]
    times: int

    @property
    def starts(self) -> NDArray[np.int64]:
        """(m + 1,): the first sample point of each module, and the number of all."""
        return np.append(0, np.cumsum([module.lattice[0] * module.lattice[1] for module in self.each]))

    def part(self, first: int, last: int) -> "Modules":
        """Some of the modules."""
        return Modules(self.names[first:last], self.each[first:last], self.times)

    @property
    def turn(self) -> bool:
        """Whether any is on a tracker."""
        return any(module.turns for module in self.each)

    def tilts(self, time: int) -> NDArray[np.float64]:
        """(m, 2) float64: tilt and azimuth at a time."""
        return np.array([[_at(module.tilt, time), _at(module.azimuth, time)] for module in self.each])

    def planes(self, time: int, north: float, up: str) -> Planes:
        """The modules at a time; north: degrees, of true north from the scene's own."""
        angles = self.tilts(time)
        tilt, bearing = angles[:, 0], angles[:, 1] + north
        normals = directions_of(90.0 - tilt, bearing, up)
        across = directions_of(np.zeros(len(tilt)), bearing + 90.0, up)
        along = directions_of(tilt, bearing + 180.0, up)
        points, corners = list[np.ndarray](), list[np.ndarray]()
        for module, u, v in zip(self.each, across, along):
            columns, rows = module.lattice
            x = ((np.arange(columns) + 0.5) / columns - 0.5) * module.width
            y = ((np.arange(rows) + 0.5) / rows - 0.5) * module.height
            points.append((np.array(module.position) + y[:, None, None] * v + x[:, None] * u).reshape(-1, 3))
            if module.area > 0.0:
                a, b = 0.5 * module.width * u, 0.5 * module.height * v
                ring = np.array(module.position) + np.array([-a - b, a - b, a + b, b - a])
                corners.append(ring[[[0, 1, 2], [0, 2, 3]]])
        counts = np.diff(self.starts)
        every = np.concatenate(corners) if corners else np.empty((0, 3, 3))
        return Planes(np.concatenate(points), np.repeat(normals, counts, axis=0), every)


def _at(angles: NDArray[np.float64], time: int) -> float:
    return float(angles if angles.ndim == 0 else angles[time])


def checked_modules(modules: Any, times: int) -> Modules:
    """The modules of a study: one `PvModule`, or a dict of them.

    Raises
    ------
    InputError
        If there are none, or a tracker has not one plane per time.
    """
    named = {"1": modules} if isinstance(modules, PvModule) else modules
    if not isinstance(named, Mapping) or not named or not all(isinstance(each, PvModule) for each in named.values()):
        raise InputError(
            f"modules are {quoted(modules)}; they must be an antumbra.PvModule, or a dict of names to them"
        )
    for name, module in named.items():
        for angles, what in ((module.tilt, "tilts"), (module.azimuth, "azimuths")):
            if angles.ndim and len(angles) != times:
                raise InputError(
                    f"the module {name} has {len(angles)} {what} at {counted(times, 'time')}; give one for each"
                )
    return Modules([str(name) for name in named], list(named.values()), times)


# --- Tables -----------------------------------------------------------------------------------------------------------


def modules_of_table(
    file: str, points: Sensors, elevation: NDArray[np.float64], azimuth: NDArray[np.float64]
) -> dict[str, PvModule]:
    """The modules of the rows of a table, at times with these positions of the sun, (n,) degrees.

    The columns are those of positions, id or name, tilt, azimuth, width, height and string. A row with an axis_azimuth
    is a tracker, whose plane is that of ``pvlib.tracking.singleaxis``, with axis_tilt, max_angle and gcr; with a gcr,
    it backtracks.
    """
    n = len(points)
    columns = {name: _column(file, points.attributes, name, n) for name in _NUMBERS}
    strings = points.attributes.get("string", np.full(n, "", object))
    modules = dict[str, PvModule]()
    for k, name in enumerate(names_of_rows(file, points.attributes, n)):
        row = {column: float(values[k]) for column, values in columns.items() if np.isfinite(values[k])}
        plane: tuple[Any, Any] = row.get("tilt", 0.0), row.get("azimuth", 180.0)
        if "axis_azimuth" in row:
            if "tilt" in row or "azimuth" in row:
                raise InputError(f"{file}: the row {name} has an axis_azimuth and a plane; leave one of them out")
            plane = _tracked(row, elevation, azimuth)
        try:
            size = row.get("width", 0.0), row.get("height", 0.0)
            modules[name] = PvModule(points.points[k].tolist(), *size, *plane, str(strings[k]))
        except InputError as error:
            raise InputError(f"{file}: the row {name}: {error}") from None
    if not modules:
        raise InputError(f"{file}: has no modules; give at least one row")
    return modules


def _column(file: str, attributes: Attributes, name: str, n: int) -> NDArray[np.float64]:
    values = attributes.get(name)
    if values is None:
        return np.full(n, np.nan)
    if values.dtype.kind not in "fiu":
        raise InputError(f"{file}: column {name!r} must hold numbers")
    return values.astype(np.float64)


def _tracked(row: Mapping[str, float], elevation: NDArray[np.float64], azimuth: NDArray[np.float64]) -> tuple[Any, Any]:
    """Tilt and azimuth of a tracker by time; level at night."""
    tracking = import_extra("pvlib.tracking", "trackers", "sun")
    found = tracking.singleaxis(
        90.0 - elevation, azimuth, axis_tilt=row.get("axis_tilt", 0.0), axis_azimuth=row["axis_azimuth"],
        max_angle=row.get("max_angle", 60.0), backtrack="gcr" in row, gcr=row.get("gcr", 1.0),
    )  # fmt: skip
    tilt = np.nan_to_num(np.asarray(found["surface_tilt"], np.float64))
    return np.clip(tilt, 0.0, 90.0), np.nan_to_num(
        np.asarray(found["surface_azimuth"], np.float64), nan=row["axis_azimuth"]
    )
