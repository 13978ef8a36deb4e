"""Texture coordinates for a bake: a UV set of the file, or an atlas by xatlas; and the sheets, one for each image."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...errors import InputError
from ...extras import import_extra
from ...formats.gltf.accessors import Accessors
from ...progress import report_progress
from .parts import Part
from .texels import Cover, cover

PADDING = 4
"""Texels between the charts of an atlas: more than the radius of the filter, and than bilinear lookups reach."""

_OUTSIDE = 1e-4
_OVERLAP = 0.005  # of a sheet's texels: exporters let charts touch, and rounding makes them overlap


class Unwrapped(NamedTuple):
    """A part on a sheet."""

    part: Part
    uv: np.ndarray  # (v, 2) float64 in [0, 1], from the top left
    faces: np.ndarray  # (f, 3) into `uv`, in the order of the part's faces
    source: np.ndarray  # (v,) the part's vertex of each row of `uv`


class Sheet(NamedTuple):
    """Parts that share an image."""

    members: list[int]  # indices of parts
    unwrapped: list[Unwrapped]  # of each of them
    cover: Cover


def atlas(parts: Sequence[Part], size: int) -> list[Sheet]:
    """One sheet with all parts; xatlas divides them into charts. Texels have about the same size everywhere."""
    xatlas = import_extra("xatlas", "an atlas (--texture without --uv)", "bake")
    made, middle = xatlas.Atlas(), np.mean([p.positions.mean(0) for p in parts], 0)
    for part in parts:
        made.add_mesh((part.positions - middle).astype(np.float32), part.faces.astype(np.uint32))
    options = xatlas.PackOptions()
    options.resolution, options.padding, options.bilinear, options.create_image = size, PADDING, True, False
    with report_progress("unwrapping"):
        made.generate(pack_options=options)
    scale = np.array([made.width, made.height], np.float64) / max(made.width, made.height, 1)
    unwrapped = []
    for i, part in enumerate(parts):
        source, faces, uv = made[i]
        unwrapped.append(
            Unwrapped(part, uv.astype(np.float64) * scale, faces.astype(np.int64), source.astype(np.int64))
        )
    return [Sheet(list(range(len(parts))), unwrapped, _covered(unwrapped, size))]


def existing(parts: Sequence[Part], accessors: Accessors, uv_set: int, size: int) -> list[Sheet]:
    """Sheets by a UV set of the file: one for all parts if these do not overlap, else one for each part.

    Raises
    ------
    InputError
        If a part has no such set, leaves [0, 1] or overlaps itself.
    """
    unwrapped = [_set_of(part, accessors, uv_set) for part in parts]
    together = _covered(unwrapped, size)
    if together.overlap <= _OVERLAP:
        return [Sheet(list(range(len(parts))), unwrapped, together)]
    sheets = []
    for i, one in enumerate(unwrapped):
        alone = _covered([one], size)
        if alone.overlap > _OVERLAP:
            raise InputError(
                f"{one.part.where}: TEXCOORD_{uv_set} overlaps itself in {100 * alone.overlap:.1f} % of its texels; "
                "choose another --uv, or leave it out for an atlas"
            )
        sheets.append(Sheet([i], [one], alone))
    return sheets


def corners_of(unwrapped: Sequence[Unwrapped], values: Sequence[np.ndarray]) -> np.ndarray:
    """(f, 3, k): values at the vertices of parts, at the corners of all their faces."""
    return np.concatenate([rows[one.source][one.faces] for one, rows in zip(unwrapped, values)])


def chart_of_faces(unwrapped: Sequence[Unwrapped]) -> np.ndarray:
    """(f,) int64: the chart of each face; faces of a chart share vertices in the sheet."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    charts, start = [], 0
    for one in unwrapped:
        _, same = np.unique(one.uv, axis=0, return_inverse=True)
        faces, n = same.reshape(-1)[one.faces], int(same.max()) + 1
        edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]]])
        count, labels = connected_components(coo_array((np.ones(len(edges), bool), edges.T), (n, n)), directed=False)
        charts.append(labels[faces[:, 0]].astype(np.int64) + start)
        start += count
    return np.concatenate(charts)


def _covered(unwrapped: Sequence[Unwrapped], size: int) -> Cover:
    return cover(np.concatenate([one.uv[one.faces] for one in unwrapped]) * size, size)


def _set_of(part: Part, accessors: Accessors, uv_set: int) -> Unwrapped:
    name, attributes = f"TEXCOORD_{uv_set}", part.json["attributes"]
    if name not in attributes:
        held = ", ".join(k[9:] for k in sorted(attributes) if k.startswith("TEXCOORD_"))
        there = f"it has the UV sets {held}; " if held else "it has none; "
        raise InputError(f"{part.where} has no {name}; {there}leave --uv out for an atlas")
    uv = accessors.finite(attributes[name], "VEC2")[part.rows]
    if uv.min() < -_OUTSIDE or uv.max() > 1.0 + _OUTSIDE:
        low, high = uv.min(), uv.max()
        raise InputError(
            f"{part.where}: {name} reaches from {low:.3g} to {high:.3g}, beyond 0 to 1, so texels repeat; choose "
            "another --uv, or leave it out for an atlas"
        )
    return Unwrapped(part, np.clip(uv, 0.0, 1.0), part.faces.astype(np.int64), np.arange(len(uv)))
