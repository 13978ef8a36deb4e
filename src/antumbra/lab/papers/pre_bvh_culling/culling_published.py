"""Results of the pre-BVH culling paper, in milliseconds on a GPU, and their contradictions [Selgrad et al. 2015].

This module imports nothing from the package, which keeps the command's help fast.
"""

from enum import StrEnum
from math import inf


class CullingTable(StrEnum):
    """The tables that the benchmark measures."""

    steps = "steps"
    times = "times"
    figures = "figures"
    random = "random"
    video = "video"


# --- Published results ------------------------------------------------------------------------------------------------


TIME_TO_IMAGE = {
    "Figure 3": {
        "LBVH": (0.0, 3.520, 26.836, 30.356, 271.880, 2687.120),
        "LBVH culled": (1.399, 2.095, 20.955, 24.449, 213.044, 2098.994),
        "TL-LBVH": (0.0, 23.316, 20.776, 44.092, 231.076, 2100.916),
        "TL-LBVH culled": (1.399, 12.065, 17.653, 31.117, 189.994, 1778.764),
        "BSAH": (0.0, 278.500, 14.279, 292.779, 421.290, 1706.400),
    },
    "Figure 4": {
        "LBVH": (0.0, 3.539, 15.872, 19.411, 162.259, 1590.739),
        "LBVH culled": (1.405, 2.428, 12.636, 16.469, 130.193, 1267.433),
        "TL-LBVH": (0.0, 23.408, 11.862, 35.270, 142.028, 1209.608),
        "TL-LBVH culled": (1.405, 15.185, 9.834, 26.424, 114.930, 999.990),
        "BSAH": (0.0, 278.500, 8.428, 286.928, 362.780, 1121.300),
    },
    "Figure 5": {
        "LBVH": (0.0, 3.525, 12.684, 16.209, 130.365, 1271.925),
        "LBVH culled": (1.228, 2.687, 11.004, 14.919, 113.955, 1104.315),
        "TL-LBVH": (0.0, 23.293, 10.349, 33.642, 126.783, 1058.193),
        "TL-LBVH culled": (1.228, 16.678, 9.741, 27.647, 115.316, 992.006),
        "BSAH": (0.0, 278.500, 8.372, 286.872, 362.220, 1115.700),
    },
    "Figure 6": {
        "LBVH": (0.0, 9.902, 18.408, 28.310, 193.982, 1850.702),
        "LBVH culled": (2.374, 1.121, 14.160, 17.655, 145.095, 1419.495),
        "TL-LBVH": (0.0, 68.993, 10.540, 79.533, 174.393, 1122.993),
        "TL-LBVH culled": (2.374, 4.775, 9.329, 16.478, 100.439, 940.049),
        "BSAH": (0.0, 879.400, 9.041, 888.441, 969.810, 1783.500),
    },
}
"""Table 3: view -> method -> times of culling, building and tracing 1 sample, and totals with 1, 10 and 100 samples."""

DETAILS = {
    "Figure 3": (2.158, 0.734, 0.387, 0.122, 0.638, 0.231, 1.399),
    "Figure 4": (2.897, 0.710, 0.710, 0.128, 0.600, 0.232, 1.405),
    "Figure 5": (3.035, 1.539, 0.344, 0.133, 0.562, 0.220, 1.288),
    "Figure 6": (4.554, 1.623, 0.403, 0.126, 1.570, 0.251, 2.374),
}
"""Tables 1 and 2: view -> times of the G-buffer, the final blit, and the culling steps, and the printed sum of culling.

Building and tracing are the same in these tables as in Table 3."""

REMAINING = {"Figure 3": 0.45, "Figure 4": 0.60, "Figure 5": 0.60, "Figure 6": 0.04}
"""Captions of Figures 3 to 6: share of remaining triangles."""

GRIDS = {
    16: (0.34, 0.319, 0.074, 4.323, 4.716, 15.464, 15.430, 95.601, 11.496),
    32: (0.24, 0.463, 0.133, 4.810, 5.406, 11.450, 13.915, 67.056, 10.660),
    64: (0.19, 0.658, 0.704, 5.884, 7.246, 9.809, 13.307, 56.057, 10.354),
    128: (0.17, 0.904, 11.880, 8.515, 21.299, 8.989, 12.889, 49.942, 10.095),
    256: (0.16, 2.995, 534.021, 16.388, 553.404, 8.458, 12.538, 46.145, 9.874),
}
"""Table 4: grid -> (share of remaining triangles, times of sources, marking, triangles and all culling, of building and
tracing with LBVH, and of building and tracing with TL-LBVH)."""

UNCULLED = (42.161, 17.020, 261.186, 12.167)
"""Table 4, without culling: times of building and tracing with LBVH, and with TL-LBVH."""

CONTRADICTIONS = (
    ("culling in Figure 4", "the four steps of Table 1 sum to 1.670 ms, but it prints 1.405"),
    ("culling in Figures 3, 5 and 6", "the steps sum to 1.378, 1.259 and 2.350 ms; 1.399, 1.288 and 2.374 are printed"),
    ("culling in Figure 5", "Table 2 prints 1.288 ms, Table 3 has 1.228 and computes its totals with it"),
    ("culling in Table 4", "the sums leave out the scan, which those of Tables 1 and 2 include"),
    (
        "totals of Table 3",
        "those with 10 and 100 samples are 10 and 100 times the tracing time of 1; they were not measured",
    ),
    (
        "caption of Table 3",
        "BSAH catches up for almost all at 100 samples, it says; 7 of the 16 totals are still below BSAH's",
    ),
)
"""Where the paper contradicts itself, or claims more than its tables show: place -> explanation."""


def published_total(figure: str, method: str, spp: int) -> float:
    """Milliseconds of a method of Table 3 with any number of samples, computed as there: tracing time is linear."""
    cull, build, trace = TIME_TO_IMAGE[figure][method][:3]
    return cull + build + spp * trace


def published_break_even(figure: str, method: str) -> float:
    """The number of samples from which BSAH is as fast as a method, by Table 3 (Fig. 7); inf if never."""
    slow, fast = TIME_TO_IMAGE[figure]["BSAH"], TIME_TO_IMAGE[figure][method]
    gain = fast[2] - slow[2]
    return (slow[1] - fast[0] - fast[1]) / gain if gain > 0.0 else inf
