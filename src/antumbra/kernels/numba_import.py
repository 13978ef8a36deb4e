"""Numba without what only other programs need of it."""

import sys


def import_numba() -> None:
    """Import Numba's array functions, but not scipy's linear algebra behind them, which takes 0.2 s.

    No kernel multiplies matrices. For a process that only compiles: np.dot in kernels is refused then.
    """
    if "scipy.linalg" in sys.modules or "numba.np.arraymath" in sys.modules:
        return
    sys.modules["scipy.linalg"] = None  # type: ignore[assignment]  # an import of it fails at once
    try:
        import numba.np.arraymath  # noqa: F401
    finally:
        del sys.modules["scipy.linalg"]
