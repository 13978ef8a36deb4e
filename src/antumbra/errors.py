"""The one exception that bad input raises."""


class InputError(ValueError):
    """Raised for unusable input, with a one-line message that names the problem and its cure.

    The command line prints it without a traceback and exits with code 2.
    """
