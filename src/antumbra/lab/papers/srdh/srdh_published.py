"""The lightings of the SRDH paper's benchmark, and the published results [Feltman et al. 2012, Sec. 4, Table 1].

This module imports nothing from the package, which keeps the command's help fast.
"""

from enum import StrEnum
from statistics import fmean
from typing import NamedTuple


class Lighting(StrEnum):
    """The lights of a scene, one of which the option --lighting names."""

    own = "own"
    opposed = "opposed"
    lamps = "lamps"
    ambient = "ambient"
    sky = "sky"


class SrdhTable(StrEnum):
    """The tables that the benchmark measures."""

    boxes = "boxes"
    builds = "builds"
    rtsah = "rtsah"
    renders = "renders"


# --- Published results for the paper's five scenes --------------------------------------------------------------------


REDUCTION = (0.22, 0.56)
"""Sec. 1, 5: minimum and maximum share of box tests that SRDH saves relative to random order, with all rays as
representative rays."""

WITHIN = 0.06
"""Sec. 4.2: largest extra cost of trees for the rays of 16 x 16 pixels, relative to trees for all rays."""

PUBLISHED_UNOCCLUDED = {"SPONZA": 0.19, "ARCADE": 0.24}
"""Sec. 4.1: share of box tests of unoccluded rays that SRDH saves."""

BEDROOM = {"random": 0.56, "back-to-front": 0.41, "rtsah": 0.44}
"""Sec. 4.1: share of box tests that SRDH saves relative to orders of the SAH tree, for light through blinds."""


BLINDS_DEPTHS = {"SAH": (7, 8), "SRDH": (3,)}
"""Sec. 4.1, Fig. 3: depths of the subtrees that hold the blinds of BEDROOM."""

GROWTH = 2.0
"""Sec. 5: largest size of both trees, relative to the SAH tree alone."""


class PublishedBuild(NamedTuple):
    """A row of Table 1, in seconds on one thread."""

    scene: str
    triangles: int
    sah: float
    pixels: int  # width of the pre-render
    rays: int
    srdh: float

    @property
    def both(self) -> float:
        """Time to build both trees, relative to the SAH tree alone."""
        return (self.sah + self.srdh) / self.sah


PUBLISHED_BUILDS = (
    PublishedBuild("MADSCI", 80_149, 1.7, 16, 5_505, 3.0),
    PublishedBuild("MADSCI", 80_149, 1.7, 32, 22_477, 6.2),
    PublishedBuild("BEDROOM", 361_754, 7.7, 16, 4_864, 10.1),
    PublishedBuild("BEDROOM", 361_754, 7.7, 32, 19_198, 12.2),
    PublishedBuild("FAIRY", 174_117, 3.6, 16, 366, 4.6),
    PublishedBuild("FAIRY", 174_117, 3.6, 32, 1_451, 4.7),
    PublishedBuild("SPONZA", 66_444, 1.2, 16, 416, 1.6),
    PublishedBuild("SPONZA", 66_444, 1.2, 32, 1_648, 1.8),
    PublishedBuild("ARCADE", 66_444, 1.2, 16, 774, 1.7),
    PublishedBuild("ARCADE", 66_444, 1.2, 32, 3_110, 2.1),
)


def both_over_sah(pixels: int) -> float:
    """The time to build both trees relative to SAH alone, as mean over the paper's scenes."""
    return fmean(row.both for row in PUBLISHED_BUILDS if row.pixels == pixels)
