"""Import Numba without scipy's linear algebra."""

import sys


def import_numba() -> None:
    """Import Numba's array functions, but not scipy's linear algebra behind them, whose import takes 0.2 s.

    It is for processes that only compile, since Numba then refuses np.dot in kernels. No kernel multiplies matrices.
    """
    if "scipy.linalg" in sys.modules or "numba.np.arraymath" in sys.modules:
        return
    sys.modules["scipy.linalg"] = None  # type: ignore[assignment]  # an import of it fails at once
    try:
        import numba.np.arraymath  # noqa: F401
    finally:
        del sys.modules["scipy.linalg"]
