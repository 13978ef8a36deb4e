"""Figures 5 and 7 of the multi-frusta paper: 16 filtered samples beside 256, and edges that are traced again.

Figure 5 compares visibility: 16 interleaved samples, smoothed by the discontinuity filter, and 256 samples a pixel.
Figure 7 marks silhouettes. The paper finds them by adjacency during traversal; here they are discontinuities of the
G-buffer. Marked pixels are traced again by 16 sub-pixels.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ...picture.image_files import automatic_exposure, to_srgb8
from ...query.gbuffer import seen_by
from ...query.pixel_refinement import edges
from ...rendering.frame import Frame
from ...rendering.renderer import Renderer
from .measure import SPP, Case

MANY = 256
FRAMES = {
    "16 samples": {"spp": SPP},
    "16 samples, filtered": {"spp": SPP, "filter": True},
    "256 samples": {"spp": MANY},
    "edges retraced": {"spp": SPP, "filter": True, "adaptive": 4 * SPP},
}
_PARTS = 3  # a crop's side is the picture's divided by this


class Quality(NamedTuple):
    """What Figures 5 and 7 show of a case."""

    rows: dict[str, dict[str, float]]  # name in FRAMES -> rays, seconds, and errors of the visibility against MANY
    edges: float  # share of the pixels that see something
    pictures: dict[str, np.ndarray]  # name -> (h, w, 3) uint8, in the order of the figures


def measure(case: Case, say: Callable[[str], None]) -> Quality:
    """Render the frames of both figures by the default plan, once each."""
    renderer, frames = Renderer(case.view.scene), {}
    for name, asked in FRAMES.items():
        say(f"{case.name}, Figures 5 and 7, {name}")
        frames[name] = renderer.render(
            case.view.camera, case.view.lights, cull_faces=case.cull_faces, antialias=False, **asked
        )
    seen, many = case.gbuffer.face >= 0, frames["256 samples"]
    colours = case.view.scene.colours
    edge = edges(seen_by(case.gbuffer, case.rays), colours) & seen
    rows = {name: _row(frame, many, seen) for name, frame in frames.items()}
    return Quality(rows, float(edge.sum() / max(seen.sum(), 1)), _pictures(frames, edge, seen))


def _row(frame: Frame, many: Frame, seen: np.ndarray) -> dict[str, float]:
    wrong = (frame.visibility[0] - many.visibility[0])[seen].astype(float)
    rms, mean = (float(np.sqrt(np.mean(wrong**2))), float(np.mean(np.abs(wrong)))) if wrong.size else (0.0, 0.0)
    return {"rays": frame.rays, "seconds": frame.timings["trace"] + frame.timings["filter"], "rms": rms, "mean": mean}


def _pictures(frames: dict[str, Frame], edge: np.ndarray, seen: np.ndarray) -> dict[str, np.ndarray]:
    exposure = automatic_exposure(frames["256 samples"].image, seen)
    whole = {name: to_srgb8(frame.image, exposure) for name, frame in frames.items()}
    marked = whole["16 samples, filtered"] // 2
    marked[edge] = 255, 64, 64
    crop = _liveliest(frames["256 samples"].visibility[0], seen)
    left, right = (f"{name} (Fig. 5)" for name in ("16 samples, filtered", "256 samples"))
    return {
        left: whole["16 samples, filtered"][crop],
        right: whole["256 samples"][crop],
        "edges (Fig. 7)": marked,
        "edges retraced (Fig. 7)": whole["edges retraced"],
    }


def _liveliest(visibility: np.ndarray, seen: np.ndarray) -> tuple[slice, slice]:
    """The part of the picture whose visibility varies the most."""
    h, w = (max(n // _PARTS, 1) for n in seen.shape)
    parts = [(slice(y * h, y * h + h), slice(x * w, x * w + w)) for y in range(_PARTS) for x in range(_PARTS)]
    return max(parts, key=lambda part: float((visibility[part] * seen[part]).var()))
