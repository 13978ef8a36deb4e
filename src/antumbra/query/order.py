"""Points along a space-filling curve, so that neighbours in a list are near each other."""

import numpy as np


def morton_codes(points: np.ndarray) -> np.ndarray:
    """(n,) int64: Morton codes of 10 bits an axis of (n, 3) points, over their box."""
    axes = np.ascontiguousarray(points.T)  # minima along rows are several times as fast
    low = axes.min(1, initial=np.inf, keepdims=True)
    size = max(float((axes.max(1, initial=-np.inf, keepdims=True) - low).max()), 1e-30)
    cells = np.clip((axes - low) * (1023.0 / size), 0, 1023).astype(np.int64)
    for shift, mask in ((16, 0x030000FF), (8, 0x0300F00F), (4, 0x030C30C3), (2, 0x09249249)):
        cells = (cells | cells << shift) & mask
    return cells[0] << 2 | cells[1] << 1 | cells[2]
