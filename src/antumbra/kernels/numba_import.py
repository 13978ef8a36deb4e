"""Numba without what only other programs need of it."""

import sys


def import_numba() -> None:
    """Import Numba's array functions, but not scipy's linear algebra behind them: no kernel of ours multiplies
    matrices, and it is 0.2 s of every start. For a process that only compiles, since np.dot in kernels is then refused."""
    if "scipy.linalg" in sys.modules or "numba.np.arraymath" in sys.modules:
        return
    sys.modules["scipy.linalg"] = None  # type: ignore[assignment]  # an import of it fails at once
    try:
        import numba.np.arraymath  # noqa: F401
    finally:
        del sys.modules["scipy.linalg"]
