"""Optional packages: each is imported when it is needed, and a missing one gets an error that names its extra."""

import importlib
from types import ModuleType

from .errors import InputError


def needed(package: str, what: str, extra: str) -> ModuleType:
    """Import an optional package.

    Parameters
    ----------
    package : str
        Name of the module.
    what : str
        The option or function that needs it, for the error.
    extra : str
        The extra of this package that installs it.

    Raises
    ------
    InputError
        If it is not installed.
    """
    try:
        return importlib.import_module(package)
    except ImportError:
        name = package.partition(".")[0]
        raise InputError(f"{what} needs {name}: pip install 'antumbra[{extra}]'") from None
