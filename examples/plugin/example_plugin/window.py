"""A light: the window of a wall, given as architects do, by its centre, its width and its height."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antumbra.base.checks import number, vector
from antumbra.cli.arguments import parse_number
from antumbra.scene.lights import FIXED, FLAT, Light, LightPatch, check_place


@dataclass(frozen=True, eq=False)
class Window(Light):
    """An upright rectangle that emits light, in a scene with Y up.

    centre : (3,) float
    facing : float
        Degrees from +Z towards +X: the direction of its normal, seen from above.
    width, height : float
    """

    centre: np.ndarray
    facing: float
    width: float
    height: float

    domain = "square"  # samples are points of the unit square

    def __post_init__(self) -> None:
        object.__setattr__(self, "centre", vector(self.centre, "Window centre"))
        check_place(self.centre, "Window centre")
        number(self.facing, "Window facing", -360.0, 360.0, "[]")
        for name in ("width", "height"):
            number(getattr(self, name), f"Window {name}", 0.0, 1e6)
        self._check()

    @property
    def edges(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The horizontal and the upright edge, (3,) each."""
        angle = np.radians(self.facing)
        return self.width * np.array([np.cos(angle), 0.0, -np.sin(angle)]), np.array([0.0, self.height, 0.0])

    def patch(self, origin: NDArray[np.float64], reach: float) -> LightPatch:
        u, v = self.edges
        return LightPatch(FIXED, self.centre - (u + v) / 2.0 - origin, u, v, FLAT, 0.0)

    def area(self) -> float:
        return self.width * self.height


def parse(centre: str, facing: str, width: str, height: str, **options: float) -> Window:
    """The window that ``--light window:...`` describes; `options`: its intensity, if it is given."""
    place = [parse_number(each, "centre") for each in centre.split(",")]
    sizes = parse_number(width, "width"), parse_number(height, "height")
    return Window(np.array(place), parse_number(facing, "facing"), *sizes, **options)
