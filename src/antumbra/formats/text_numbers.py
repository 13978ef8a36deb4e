"""Numbers in the text of mesh files."""

import threading
import warnings

import numpy as np

from ..base.forks import hold_during_fork

_parsing = threading.Lock()  # warning filters are shared by all threads
hold_during_fork(_parsing)


def parsed_numbers(text: bytes, dtype: type[np.number]) -> np.ndarray | None:
    """The numbers in a text, separated by white space and correctly rounded; None if there is anything else in it."""
    if not text.strip():
        return np.empty(0, dtype)
    with _parsing, warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            return np.fromstring(text, dtype, sep=" ")
        except (ValueError, DeprecationWarning):  # NumPy announces that the warning will become an error
            return None
