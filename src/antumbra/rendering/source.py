"""The source of frames: it finds what a camera sees and what rays meet first, and knows what can be traced."""

from typing import ClassVar, Protocol

import numpy as np

from ..query.picture import Surfaces
from ..scene.any_scene import AnyScene
from ..scene.triangles import Triangles
from ..trace.rays.bounce import Nearest
from .accelerate import Accelerated


class RenderSource(Protocol):
    """A scene, as one `Renderer` sees it: `InMemory` or `Paged`.

    default_plan : str
        The plan of a `Renderer` that is given none.
    keeps_read : bool
        Does it hold what it read for one question of points? Then its `Renderer` waits for the next question.
    looks : int
        How often `look` counts `progress` to its end.
    gbuffer : "raster" or "rays"
        How `look` finds what a camera sees.
    """

    default_plan: ClassVar[str]
    keeps_read: ClassVar[bool]
    looks: ClassVar[int]

    @property
    def scene(self) -> AnyScene: ...

    @property
    def gbuffer(self) -> str: ...

    def warm_up(self) -> None:
        """Have the kernels ready that it calls besides those of every plan."""

    def check_adaptive(self) -> None:
        """InputError if edges cannot be divided into sub-pixels."""

    def begin(self, pixels: int, words: int) -> None:
        """A frame begins, of so many pixels or points, each with so many words of bits.

        Raises
        ------
        InputError
            If memory is too small for it.
        """

    def moment(self, time: float) -> tuple[Triangles, Accelerated | None]:
        """The triangles at a time; and a tree of them all, if the frames before left one."""
        ...

    def for_points(self, time: float) -> tuple[Triangles, Accelerated | None]:
        """The same for points that ask; None: the tree depends on the question."""
        ...

    def keep(self, accelerated: Accelerated) -> None:
        """A frame's shadow rays went through this tree; the next frames may use it again."""

    def look(self, camera, triangles: Triangles, whole: Accelerated | None, progress=None) -> Surfaces:
        """The surfaces that a camera sees.

        whole : a tree of all triangles; None only where `gbuffer` is "raster"
        """
        ...

    def nearest_in(self, whole: Accelerated) -> Nearest:
        """A function that finds the surfaces that a pass of diffuse rays meets first."""
        ...

    def box(self, triangles: Triangles) -> np.ndarray:
        """(2, 3) float32: bounds of the scene at a moment, in the recentred frame."""
        ...

    def paging(self) -> dict[str, int] | None:
        """Counts of chunks that came and went since `begin`; None where all is in memory."""
        ...
