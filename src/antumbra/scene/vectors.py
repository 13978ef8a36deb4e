"""Checked three-vectors for the public face."""

import numpy as np

from ..errors import InputError


def vector(value, what: str) -> np.ndarray:
    """`value` as (3,) float64; InputError naming `what` unless it is three finite numbers."""
    try:
        v = np.asarray(value, np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{what} must be three numbers, not {value!r}") from None
    if v.shape != (3,) or not np.isfinite(v).all():
        raise InputError(f"{what} must be three finite numbers, not {value!r}")
    return v
