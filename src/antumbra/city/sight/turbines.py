"""Wind turbines as targets: their feet and rotors, and how much of a rotor each point sees."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...base.checks import listed, number
from ...base.errors import InputError
from ...engine.plan import Plan
from ...engine.scene import AnyScene
from ...kernels.parallel import thread_count
from ...query.light_samples import light_samples
from ...query.receivers import Receivers
from ...query.shadow_query import count_occluded
from ...scene.lights import SphereLight
from ..sensors.curved_earth import Earth
from ..sensors.point_attributes import names_of_rows
from ..sensors.point_checks import depths_below_ground, notes_on_points, on_surface
from ..sensors.sensors import Sensors

HUB, ROTOR = "hub_height", "rotor_diameter"
"""Columns of a table of turbines."""


class _TurbineFields(NamedTuple):
    position: tuple[float, float, float]  # of its foot, world
    hub_height: float  # world units above the foot
    rotor_diameter: float  # world units


class Turbine(_TurbineFields):
    """A wind turbine, whose rotor turns towards each sensor.

    position : (3,) float
        World coordinates of its foot.
    hub_height : float
        World units, above the foot.
    rotor_diameter : float
        World units.
    """

    __slots__ = ()

    def __new__(cls, position: ArrayLike, hub_height: float, rotor_diameter: float) -> "Turbine":
        x, y, z = (
            number(each, "a coordinate of a turbine", -np.inf, np.inf) for each in listed(position, "position", 3)
        )
        height = number(hub_height, "the hub height of a turbine", 0.0, np.inf)
        diameter = number(rotor_diameter, "the rotor diameter of a turbine", 0.0, np.inf)
        return super().__new__(cls, (x, y, z), height, diameter)


class Turbines(NamedTuple):
    """Named turbines of one study."""

    names: list[str]
    each: list[Turbine]

    @property
    def feet(self) -> NDArray[np.float64]:
        """(k, 3) float64, world."""
        return np.array([turbine.position for turbine in self.each])

    @property
    def areas(self) -> NDArray[np.float64]:
        """(k,) float64: of the rotors' disks, square world units."""
        return np.array([np.pi * turbine.rotor_diameter**2 / 4.0 for turbine in self.each])

    def at(self, feet: NDArray[np.float64]) -> "Turbines":
        """The same turbines elsewhere."""
        return Turbines(self.names, [Turbine(foot, *turbine[1:]) for foot, turbine in zip(feet.tolist(), self.each)])


def turbines_of(target: Any) -> Turbines | None:
    """The turbines of a target: one, several, or named ones; None if it is anything else."""
    if isinstance(target, Turbine):
        return Turbines(["1"], [target])
    if isinstance(target, Mapping):
        names, each = [str(name) for name in target], list(target.values())
    elif isinstance(target, Sequence) and target and all(isinstance(item, Turbine) for item in target):
        names, each = [str(k + 1) for k in range(len(target))], list(target)
    else:
        return None
    if not each or not all(isinstance(item, Turbine) for item in each):
        raise InputError("turbines must be antumbra.Turbine, one or more")
    return Turbines(names, each)


def turbines_of_table(path: Path, points: Sensors, hub_height: float | None, rotor: float | None) -> Turbines:
    """The turbines of the rows of a table: their feet, with the columns hub_height, rotor_diameter, and id or name.

    hub_height, rotor : of all rows, if the table has no such column
    """
    sizes = dict[str, NDArray[np.float64]]()
    for column, given, option in ((HUB, hub_height, "--hub-height"), (ROTOR, rotor, "--rotor")):
        values = points.attributes.get(column)
        if values is not None and given is not None:
            raise InputError(f"{path.name}: has the column {column}; leave {option} out")
        if values is None and given is None:
            raise InputError(f"{path.name}: has no column {column}; add it, or give {option}")
        if values is not None and values.dtype.kind not in "fiu":
            raise InputError(f"{path.name}: column {column!r} must hold numbers")
        sizes[column] = np.full(len(points), given) if values is None else values.astype(np.float64)
    if not len(points):
        raise InputError(f"{path.name}: has no turbines; give at least one row")
    names, each = names_of_rows(path.name, points.attributes, len(points)), list[Turbine]()
    for name, *row in zip(names, points.points.tolist(), sizes[HUB].tolist(), sizes[ROTOR].tolist()):
        try:
            each.append(Turbine(*row))
        except InputError as error:
            raise InputError(f"{path.name}: the row {name}: {error}") from None
    return Turbines(names, each)


def on_ground(scene: AnyScene, turbines: Turbines, time: float, threads: int | None) -> Turbines:
    """The turbines with their feet on the highest surface. Raises InputError where there is none."""
    return turbines.at(on_surface(scene, turbines.feet, "turbines", time, threads))


def notes_on_turbines(scene: AnyScene, turbines: Turbines, time: float, threads: int | None) -> list[str]:
    """Notes on the feet of turbines. Raises InputError if a rotor reaches below the ground."""
    feet, up = turbines.feet, np.eye(3)["xyz".index(scene.up)]
    lowest = np.array([turbine.hub_height - turbine.rotor_diameter / 2.0 for turbine in turbines.each])
    notes = notes_on_points(scene, feet, "turbines", time, threads)
    reach = depths_below_ground(scene, feet + lowest[:, None] * up, time, threads)
    if (reach > 0.0).any():
        k = int(reach.argmax())
        (depth,) = depths_below_ground(scene, feet[k : k + 1], time, threads)
        ground, name = feet[k] @ up + depth, f"the turbine{'' if len(turbines.each) == 1 else ' ' + turbines.names[k]}"
        cure = (
            f"the ground there is at {ground:.6g}"
            if depth > 0.0
            else f"its lowest point is {lowest[k]:g} above its foot"
        )
        raise InputError(f"{name}'s rotor reaches {reach[k]:.6g} below the ground; {cure}")
    return notes


def hubs_of(turbines: Turbines, up: str) -> NDArray[np.float64]:
    """(k, 3) float64, world: the middles of the rotors."""
    hubs = turbines.feet
    hubs[:, "xyz".index(up)] += [turbine.hub_height for turbine in turbines.each]
    return hubs


def seen_of_rotors(
    scene: AnyScene, ends: Receivers, turbines: Turbines, earth: Earth | None, samples: int,
    settings: tuple[str | Plan | None, float, int],
) -> NDArray[np.int32]:  # fmt: skip
    """(n, k) int32: the visible samples of the disk of each rotor, which faces each end.

    scene, ends : on a curved earth, the lowered ones
    """
    plan, time, threads = settings
    engine, hubs = scene.engine.with_options(plan, threads, None), hubs_of(turbines, scene.up)
    if earth is not None:
        hubs = earth.lowered(hubs)
    seen = np.empty((ends.n, len(hubs)), np.int32)
    for k, (hub, turbine) in enumerate(zip(hubs.tolist(), turbines.each)):
        rotor = SphereLight(tuple(hub), turbine.rotor_diameter / 2.0)  # sampled as the disk that faces each end
        (traced,) = engine.shadows(ends, [rotor], [light_samples(rotor, samples)], time=time, whole=True)
        seen[:, k] = samples - count_occluded(traced.bits[0], thread_count(threads))
    return seen
