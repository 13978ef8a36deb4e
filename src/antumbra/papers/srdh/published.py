"""Figures that the SRDH paper published for its five scenes [Feltman et al. 2012, Sec. 4, Table 1]."""

REDUCTION = (0.22, 0.56)
"""Sec. 1, 5: the least and the largest share of box tests that SRDH saves compared with random order. All rays are
representative rays."""

WITHIN = 0.06
"""Sec. 4.2: the largest extra cost of trees for the rays of 16 x 16 pixels, relative to trees for all rays."""

UNOCCLUDED = {"SPONZA": 0.19, "ARCADE": 0.24}
"""Sec. 4.1: the share of the box tests of unoccluded rays that SRDH saves."""

BEDROOM = {"random": 0.56, "back-to-front": 0.41, "rtsah": 0.44}
"""Sec. 4.1: the share of box tests that SRDH saves compared with orders of the SAH tree, for light through blinds."""

BUILDS = {
    "MADSCI": (80_149, 1.7, {16: (5_505, 3.0), 32: (22_477, 6.2)}),
    "BEDROOM": (361_754, 7.7, {16: (4_864, 10.1), 32: (19_198, 12.2)}),
    "FAIRY": (174_117, 3.6, {16: (366, 4.6), 32: (1_451, 4.7)}),
    "SPONZA": (66_444, 1.2, {16: (416, 1.6), 32: (1_648, 1.8)}),
    "ARCADE": (66_444, 1.2, {16: (774, 1.7), 32: (3_110, 2.1)}),
}
"""Table 1: scene -> (triangles, seconds of SAH, width of the pre-render -> (rays, seconds of SRDH)); one thread."""


def both_over_sah(pixels: int) -> float:
    """The time to build both trees, relative to SAH alone; the mean over the scenes."""
    ratios = [(sah + shown[pixels][1]) / sah for _, sah, shown in BUILDS.values()]
    return sum(ratios) / len(ratios)
