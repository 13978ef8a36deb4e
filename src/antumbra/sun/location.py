"""The location of a scene on Earth: latitude, longitude, time zone, and true north in the scene's frame."""

import re
from datetime import UTC, timedelta, timezone, tzinfo
from typing import Any, NamedTuple
from zoneinfo import ZoneInfo

import numpy as np
from numpy.typing import NDArray

from ..base.checks import number, quoted, text
from ..base.errors import InputError
from ..base.extras import import_extra
from ..engine.scene import AnyScene
from ..engine.scene_loading import SceneLike, scene_of
from ..scene.crs import CrsParts, checked_crs, parts_of_crs, unit_of_crs
from ..scene.map_point import map_point, on_earth

# --- Time zones from text ---------------------------------------------------------------------------------------------


_OFFSET = re.compile(r"([+-])(\d{1,2})(?::?(\d{2}))?")
_CURE = "write a name such as Europe/Amsterdam, or +01:00"

UNKNOWN_PLACE = "the place is unknown; give place=antumbra.Place(latitude, longitude)"
"""The beginning of a message that goes on with other sources of a place; commands name their options instead."""


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


# --- Places -----------------------------------------------------------------------------------------------------------


class _PlaceFields(NamedTuple):
    """The fields of a `Place`."""

    latitude: float  # degrees, WGS 84
    longitude: float  # degrees, WGS 84, from -180 to 180
    elevation: float = 0.0  # metres above the sea
    north: float = 0.0  # degrees: direction of true north, clockwise from the scene's own north axis
    timezone: str | None = None  # IANA name, or a fixed offset such as "+01:00"; None: the whole hour of the longitude


class Place(_PlaceFields):
    """A position on Earth, and the orientation of the scene there.

    The scene's own north axis is +Y if +Z is up, and -Z if +Y is up. Its east axis is +X in both.

    Raises
    ------
    InputError
        If the time zone is unknown, or a number is out of range: latitudes lie between -90 and 90 degrees, longitudes
        between -360 and 360.

    Examples
    --------
    >>> delft = at.Place(52.0, 4.36, timezone="Europe/Amsterdam")
    >>> delft.latitude, delft.north
    (52.0, 0.0)
    """

    def __new__(
        cls, latitude: float, longitude: float, elevation: float = 0.0, north: float = 0.0, timezone: str | None = None
    ) -> "Place":
        return checked_place(super().__new__(cls, latitude, longitude, elevation, north, timezone))


def place_of(
    scene: SceneLike, *, crs: str | None = None, latitude: float | None = None, longitude: float | None = None,
    north: float | None = None, elevation: float | None = None, timezone: str | None = None,
) -> Place | None:  # fmt: skip
    """The place of a scene.

    An explicit position overrides that of a coordinate reference system (CRS). Grid north is then taken to be true
    north unless `north` is given.

    Parameters
    ----------
    scene : Scene, PagedScene, or anything that `antumbra.load` takes
        Its bounds, up axis and CRS are used.
    crs : str, optional
        Such as "EPSG:7415"; overrides the scene's CRS.
    latitude, longitude : float, optional
        Degrees, WGS 84; both or none.
    north : float, optional
        Degrees: direction of true north, clockwise from the scene's own north axis.
    elevation : float, optional
        Metres above the sea.
    timezone : str, optional
        IANA name, or a fixed offset such as "+01:00".

    Returns
    -------
    Place or None
        None if neither the arguments nor the scene define the position.

    Raises
    ------
    InputError
        If only one of latitude and longitude is given, a number is out of range, the time zone is unknown,
        `place_of_crs` refuses the CRS, or `crs` has another unit than the scene.

    Examples
    --------
    >>> place = at.place_of(at.examples.village(), timezone="Europe/Amsterdam")
    >>> round(place.latitude, 1), round(place.longitude, 1)
    (52.0, 4.4)
    """
    position = position_fields(
        latitude=latitude, longitude=longitude, north=north, elevation=elevation, timezone=timezone
    )
    if crs is not None:
        checked_crs(text(crs, "crs"))
    scene = scene_of(scene)
    if crs is not None and not (unit := unit_of_crs(crs)).same_as(scene.unit):
        raise InputError(f"crs {crs} is in {unit.name}, and {scene.name} in {scene.unit.name}; load it with this crs")
    crs = crs or scene.crs
    check_on_earth(crs)
    if latitude is not None:
        return Place(**position)
    return None if crs is None else checked_place(place_of_crs(crs, scene.bounds, scene.up)._replace(**position))


def position_fields(**fields: Any) -> dict[str, Any]:
    """The fields of a `Place` that are not None, checked. It needs no scene, so mistakes surface before one is read.

    Raises
    ------
    InputError
        If only one of latitude and longitude is given, or a value is invalid.
    """
    values = {name: value for name, value in fields.items() if value is not None}
    if ("latitude" in values) != ("longitude" in values):
        one, other = sorted(("latitude", "longitude"), key=lambda name: name not in values)
        raise InputError(f"{one} needs its {other}; give both")
    Place(**({"latitude": 0.0, "longitude": 0.0} | values))
    return values


def checked_place(place: Place) -> Place:
    """`place` with float fields and its longitude in [-180, 180]. Raises InputError if a value is invalid."""
    limits = {"latitude": 90.0, "longitude": 360.0, "elevation": 9000.0, "north": 360.0}
    values: dict[str, Any] = {
        name: number(getattr(place, name), name, -limit, limit, "[]") for name, limit in limits.items()
    }
    if place.timezone is not None:
        parse_zone(place.timezone)
    if not -180.0 <= values["longitude"] <= 180.0:
        values["longitude"] = (values["longitude"] + 180.0) % 360.0 - 180.0
    return place._replace(**values)


def place_of_crs(crs: str, bounds: NDArray[np.floating], up: str = "z", timezone: str | None = None) -> Place:
    """The place of a scene in the coordinates of a projected coordinate reference system (CRS).

    Coordinates are easting and northing along the scene's own east and north axes, regardless of the CRS's axis order.

    Parameters
    ----------
    crs : str
        Anything that pyproj accepts, such as "EPSG:7415". Of a compound CRS, the projected part is used.
    bounds : (2, 3) float, world
        In the unit of the CRS. The position is that of the centre, the elevation that of the lower end.
    up : "y" or "z"
    timezone : str, optional
        Time zone of the place.

    Raises
    ------
    InputError
        If pyproj is missing, the CRS is unknown, not projected or not of the earth, its axes do not point east and
        north, or the scene lies outside its area of use.

    Notes
    -----
    Grid north lies clockwise from true north by the meridian convergence, which pyproj computes at the position.
    """
    pyproj = import_extra("pyproj", "the position of a CRS", "sun")
    parts = _projected(crs)
    east, north, height = _middle(bounds, up)
    point = map_point(crs, east, north)
    if not point.inside:
        place = "" if parts.plan.area_of_use is None else f" ({parts.plan.area_of_use.name[:60]})"
        raise InputError(
            f"crs {crs}: the middle of the scene, {east:.6g}, {north:.6g}, is outside its area{place}; "
            "if coordinates were shifted, give latitude, longitude and north instead"
        )
    to_wgs84 = pyproj.Transformer.from_crs(parts.plan.geodetic_crs, "EPSG:4326", always_xy=True)
    longitude, latitude = to_wgs84.transform(point.longitude, point.latitude)
    elevation = height * (parts.height_unit or unit_of_crs(crs)).metres
    return checked_place(Place(latitude, longitude, elevation, -point.convergence, timezone))


def place_in(scene: AnyScene, place: Place | None) -> Place | None:
    """The place of a study: that given, or that of the scene's CRS. InputError if the scene is not on the earth."""
    check_on_earth(scene.crs)
    return place_of(scene) if place is None else place


def checked_place_of(scene: AnyScene, place: Place | None) -> Place:
    """`place_in`, or an InputError if the place is unknown."""
    found = place_in(scene, place)
    if found is None:
        raise InputError(f"{UNKNOWN_PLACE}, or a CRS")
    return found


def check_on_earth(crs: str | None) -> None:
    """Raise an InputError if a CRS is that of another body."""
    if crs is not None and not on_earth(crs):
        body = parts_of_crs(crs).plan.ellipsoid.name
        raise InputError(f"crs {crs[:60]} is not on the earth ({body}); positions of the sun are known only there")


def _projected(text: str) -> CrsParts:
    """The parts of a projected CRS of the earth, with axes to the east and the north."""
    parts = parts_of_crs(checked_crs(text))
    check_on_earth(text)
    cure = "reproject the scene to a projected CRS, such as the UTM zone of the place"
    if not parts.plan.is_projected:
        raise InputError(f"crs {text} has no plan in metres (it is a {parts.plan.type_name}); {cure}")
    if [axis.direction for axis in parts.plan.axis_info[:2]] not in (["east", "north"], ["north", "east"]):
        raise InputError(f"crs {text} has axes that do not point east and north; {cure}")
    return parts


def _middle(bounds: NDArray[np.floating], up: str) -> tuple[float, float, float]:
    """(easting of the centre, northing of the centre, lowest height) of bounds, in units of the scene."""
    (x0, y0, z0), (x1, y1, z1) = ((float(c) for c in corner) for corner in bounds)
    if up == "z":
        return (x0 + x1) / 2.0, (y0 + y1) / 2.0, z0
    return (x0 + x1) / 2.0, -(z0 + z1) / 2.0, y0
