"""Tables of ``antumbra bench chc-rt``, and the results that the paper published for them.

Times are milliseconds at 1920x1080 on an NVIDIA Titan [Mattausch et al. 2015, Tables 1 to 5]. GLSL is plain traversal
in a shader; CUDA is the traversal of Aila, Laine and Karras. Each pixel has 20 AO rays and 20 diffuse rays.

This module imports nothing from the package, which keeps the command's help fast.
"""

from enum import StrEnum


class ChcrtTable(StrEnum):
    """The tables that the benchmark measures."""

    scenes = "scenes"
    times = "times"
    phases = "phases"
    queries = "queries"
    randomisation = "randomisation"
    aggressive = "aggressive"
    ablation = "ablation"
    store = "store"
    mapped = "mapped"
    rival = "rival"
    bounces = "bounces"


WALKED = frozenset({ChcrtTable.times, ChcrtTable.phases, ChcrtTable.queries, ChcrtTable.store})
"""Tables that share walkthroughs."""

IN_CORE = tuple(table for table in ChcrtTable if table.value not in ("store", "mapped", "rival", "bounces"))
PAGED = tuple(table for table in ChcrtTable if table != ChcrtTable.randomisation)
"""Tables for scenes in memory, and for a store."""

# --- Published results ------------------------------------------------------------------------------------------------


KINDS = ("primary", "AO", "diffuse")

MODELS = {
    "City-10": (11.7e6, 677, 140, 537, 100),
    "Powerplant": (12.8e6, 710, 126, 584, 100),
    "777-Section": (21.5e6, 1190, 244, 984, 100),
    "City-200": (139e6, 7890, 1540, 6350, 47),
    "Powerplant x 16": (205e6, 11400, 2020, 9340, 32),
    "777": (350e6, 18900, 2800, 16100, 20),
}
"""Table 1: scene -> (triangles, MB in all, MB of the BVH, MB of geometry, % in the GPU's memory)."""

TIMES = {
    "City-10": {
        "GLSL": ((18.22, 186, 493), (26.3, 277, 586)),
        "CHC+RT": ((11.3, 153, 384), (23.4, 286, 655)),
        "CUDA": ((12.5, 311, 615), (14.9, 278, 422)),
    },
    "Powerplant": {
        "GLSL": ((69.9, 772, 10064), (82.5, 588, 2722)),
        "CHC+RT": ((12.8, 173, 1700), (15.0, 154, 843)),
        "CUDA": ((11.8, 310, 1152), (10.6, 246, 501)),
    },
    "777-Section": {
        "GLSL": ((78.1, 516, 5464), (108, 781, 3752)),
        "CHC+RT": ((24.2, 236, 2729), (29.8, 270, 2382)),
        "CUDA": ((12.5, 277, 1264), (16.4, 316, 809)),
    },
}
"""Table 2, in core: scene -> method -> (near, far), with a time for each of KINDS."""

PAGED_TIMES = {
    "City-200": ((25.9, 325.7, 2720), (87.8, 766.7, 2492)),
    "Powerplant x 16": ((18.7, 232, 1855), (270, 1559, 25975)),
    "777": ((134, 5175, 30134), (333, 1961, 16441)),
}
"""Table 2, out of core: scene -> (near, far) of CHC+RT, with a time for each of KINDS."""

STATISTICS = {
    "City-200": (((80.1, 127, 15.2), (23.6, 54.1, 16.6)), ((822, 13.6e3, 61.2e3), (2460, 42.9e3, 117e3)),
                 ((0, 5.85, 383), (0.61, 0.11, 1.73))),
    "Powerplant x 16": (((111, 179, 22.4), (7.68, 26.6, 1.60)), ((793, 13.2e3, 32.3e3), (3630, 61.7e3, 312e3)),
                        ((0.11, 0.03, 0.55), (170, 43.6, 2310))),
    "777": (((15.4, 8.01, 1.38), (6.23, 21.1, 2.52)), ((1760, 123e3, 501e3), (6310, 85e3, 278e3)),
            ((11.7, 419, 1442), (355, 96.7, 1073))),
}  # fmt: skip
"""Table 3, out of core: scene -> (M rays/s, queries per frame, MB moved per frame), each (near, far) with a number for
each of KINDS. (The paper prints 6.31 for the far primary queries of the 777, without the K of the others.)"""

MOVED = {
    "City-200": (((0, 3.00, 94.9), (1.96, 0.30, 2.04)), ((0, 2.85, 288), (2.58, 0.41, 3.77))),
    "Powerplant x 16": (((0.04, 0.01, 0.13), (85.8, 34.7, 663)), ((0.07, 0.02, 0.42), (83.8, 8.85, 1647))),
    "777": (((2.64, 139, 595), (70.1, 25.0, 253)), ((9.14, 281, 847), (285, 71.7, 820))),
}
"""Table 3, out of core: scene -> (MB of the BVH, MB of geometry) moved per frame, each as in STATISTICS. (In some far
views the parts exceed the sum that the paper prints.)"""

AGGRESSIVE = {
    "City-200": {0: (2720, 2492), 20: (780, 2019), 100: (738, 1751), 200: (715, 1611)},
    "Powerplant x 16": {0: (1855, 25975), 20: (1682, 9651), 100: (1553, 4727), 200: (1489, 3578)},
    "777": {0: (30134, 16441), 20: (11544, 4807), 100: (8081, 2712), 200: (6804, 2028)},
}
"""Table 4, diffuse rays: scene -> threshold -> (near, far)."""

ERROR = 9.04
"""Sec. 7: the mean absolute pixel error with a threshold of 20 pixels, diffuse rays."""

RANDOMISATION = {
    ("City-10", "AO"): (136, 145, 156, 193),
    ("Powerplant", "AO"): (153, 167, 175, 190),
    ("City-10", "diffuse"): (228, 323, 384, 805),
    ("Powerplant", "diffuse"): (664, 1334, 1700, 4125),
}
"""Table 5, near: (scene, kind) -> times for rotations by 0, 18 and 36 degrees, and for full rotations."""

BEST = 5.94
"""Abstract: the largest speedup of CHC+RT over GLSL, of diffuse rays in Powerplant."""


def speedups(kind: int) -> list[float]:
    """Table 2: the speedups of CHC+RT over GLSL for one of KINDS, of each scene near and far."""
    return [glsl[kind] / ours[kind] for each in TIMES.values() for glsl, ours in zip(each["GLSL"], each["CHC+RT"])]


def moved(kind: int) -> list[float]:
    """Tables 1 and 3: the share of the scene moved per frame for one of KINDS, of each scene near and far."""
    return [view[kind] / MODELS[name][1] for name, (_, _, moved) in STATISTICS.items() for view in moved]


SCREEN_HIERARCHY = 3
"""Sec. 6: the speedup from the screen hierarchy, Powerplant at 1920x1080."""
