"""The choice of rays that ray-guided builders are shown. `Plan.sample` takes it."""

from dataclasses import dataclass

import numpy as np

from ..checks import flag, points, whole_number
from ..errors import InputError
from .bounds import MAX_COORDINATE


@dataclass(frozen=True, eq=False)
class SrdhRays:
    """The choice of shadow rays that the builder `srdh` is shown.

    Parameters
    ----------
    size : int or None
        Size x size pixels, spread evenly over the picture, or size x size points of a query; 1 to 65536. None: all.
    spp : int
        Samples of each light from each pixel, 1 to 1024; at most the number that is traced.
    bounce : bool
        Add as many rays from the surfaces that one diffuse ray from each pixel meets [Feltman et al. 2012, Sec. 4].
        Use it for trees that answer more than the shadows of visible surfaces.
    last_frame : bool
        Show each frame of a `Renderer` after the first the rays of the previous frame, with their intersections.
    origins, ends : (m, 3) float or None
        World coordinates of explicit segments, which replace all other rays.

    Raises
    ------
    InputError
        If a value is out of range, a coordinate is not below the limit for triangles, or `origins` and `ends` differ in
        shape.
    """

    size: int | None = 16
    spp: int = 4
    bounce: bool = False
    last_frame: bool = False
    origins: np.ndarray | None = None
    ends: np.ndarray | None = None

    def __post_init__(self):
        if self.size is not None:
            whole_number(self.size, "size", 1, 1 << 16)
        whole_number(self.spp, "spp", 1, 1024)
        flag(self.bounce, "bounce")
        flag(self.last_frame, "last_frame")
        if (self.origins is None) != (self.ends is None):
            raise InputError("segments have origins and ends; give both, or neither")
        if self.origins is not None:
            origins, ends = points(self.origins, "origins"), points(self.ends, "ends")
            if origins.shape != ends.shape:
                raise InputError(f"origins {origins.shape} and ends {ends.shape} must have the same shape")
            for array, name in ((origins, "origins"), (ends, "ends")):
                if not (np.abs(array) < MAX_COORDINATE).all():
                    raise InputError(f"{name} have a coordinate that is not below {MAX_COORDINATE:.1e}")
            if self.bounce or self.last_frame:
                raise InputError("origins and ends are given, so bounce and last_frame say nothing; leave them out")
            object.__setattr__(self, "origins", origins)
            object.__setattr__(self, "ends", ends)
