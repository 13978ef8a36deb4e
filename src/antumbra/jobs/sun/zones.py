"""Time zones from text."""

import re
from datetime import UTC, timedelta, timezone, tzinfo
from zoneinfo import ZoneInfo

from ...checks import quoted
from ...errors import InputError

_OFFSET = re.compile(r"([+-])(\d{1,2})(?::?(\d{2}))?")
_CURE = "write a name such as Europe/Amsterdam, or +01:00"


def parse_zone(text: str) -> tzinfo:
    """A time zone from an IANA name (Europe/Amsterdam), UTC, or a fixed offset (+01:00).

    Raises
    ------
    InputError
        If the zone is unknown.
    """
    if not isinstance(text, str):
        raise InputError(f"timezone is {quoted(text)}; {_CURE}")
    match = _OFFSET.fullmatch(text.strip())
    if match:
        minutes = 60 * int(match[2]) + int(match[3] or 0)
        if minutes <= 14 * 60 and int(match[3] or 0) < 60:
            return timezone((-1 if match[1] == "-" else 1) * timedelta(minutes=minutes))
    else:
        try:
            return UTC if text.strip() == "UTC" else ZoneInfo(text.strip())
        except (OSError, ValueError, KeyError):  # ZoneInfoNotFoundError is a KeyError
            pass
    raise InputError(f"timezone {quoted(text)} is unknown; {_CURE}")
