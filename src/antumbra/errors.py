"""The one exception that bad input raises."""


class InputError(ValueError):
    """Input that cannot be used: one line that names the thing and the cure.

    The command line prints it without a traceback and exits with code 2.
    """
