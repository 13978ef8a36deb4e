"""Seams of a baked texture: edges where two charts meet on a smooth surface, whose two sides should look the same."""

import numpy as np
from numpy.typing import NDArray

from .baked_values import sample_bilinear, surface_of
from .texture_atlas import AtlasSheet

_VISIBLE = ((0.02, "invisible"), (0.05, "hardly visible"), (0.15, "visible up close"), (np.inf, "clearly visible"))
"""Upper ends of differences, relative to the mean, and what a person sees. Edges show from 1 to 2 % on."""


def seam_of(differences: NDArray[np.float64], mean: float) -> float | None:
    """The 99th percentile of the differences across seams, relative to the mean value; None: there are no seams."""
    return float(np.percentile(differences, 99) / max(mean, 1e-30)) if len(differences) else None


def seam_words(seam: float) -> str:
    """What a person sees of the seams, from `seam_of`."""
    seen = next(words for end, words in _VISIBLE if seam <= end)
    cure = "; raise texture or spp" if seam > _VISIBLE[1][0] else ""
    return f"{seen}: 99 % differ by less than {100.0 * seam:.2g} % of the mean{cure}"


def seam_differences(sheet: AtlasSheet, image: NDArray[np.float32]) -> NDArray[np.float64]:
    """(n,) float64: the difference of the image between the two sides of a seam, at points along all seams.

    A seam is an edge where two charts meet on a smooth surface. Hard edges, whose sides differ in normal, do not count.
    """
    surface = surface_of(sheet)
    _, corner = np.unique(surface.positions.reshape(-1, 3).astype(np.float32), axis=0, return_inverse=True)
    corner = corner.reshape(-1, 3)
    a, b = (np.concatenate([corner[:, [k, (k + 1) % 3][e]] for k in range(3)]) for e in (0, 1))
    side = {
        name: [np.concatenate([v[:, [k, (k + 1) % 3][e]] for k in range(3)]) for e in (0, 1)]
        for name, v in (("uv", surface.uv), ("normal", surface.normals))
    }
    swap = a > b
    key = np.where(swap, b, a) * (int(corner.max()) + 1) + np.where(swap, a, b)
    for pair in side.values():
        pair[0], pair[1] = (np.where(swap[:, None], pair[1 - e], pair[e]) for e in (0, 1))
    order = np.argsort(key, kind="stable")
    same = np.flatnonzero(key[order][1:] == key[order][:-1])
    one, other = order[same], order[same + 1]
    apart = np.abs(side["uv"][0][one] - side["uv"][0][other]).max(1) + np.abs(
        side["uv"][1][one] - side["uv"][1][other]
    ).max(1)
    aligned = [(side["normal"][e][one] * side["normal"][e][other]).sum(1) > 0.999 for e in (0, 1)]
    seam = (apart > 1e-3) & aligned[0] & aligned[1]
    one, other, differences = one[seam], other[seam], []
    for t in (0.25, 0.5, 0.75):
        along = ((1.0 - t) * side["uv"][0] + t * side["uv"][1]) / sheet.cover.size
        differences.append(np.abs(sample_bilinear(image, along[one]) - sample_bilinear(image, along[other])).max(1))
    return np.concatenate(differences)
