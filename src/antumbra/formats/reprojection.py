"""Commands that reproject files, for messages: to the UTM zone of a place, or to a map around it on another body."""

import shlex

from ..scene.crs import parts_of_crs
from ..scene.map_point import on_earth

WARP = "gdalwarp -r bilinear -ot Float32 -dstnodata -9999"
"""Of rasters of heights. Without a type and a mark for missing data, cells off the source become zeros."""

_POLAR = 84.0, -80.0  # degrees: the ends of UTM, beyond which a polar stereographic projection takes over


def projected_crs(crs: str | None, longitude: float, latitude: float) -> str:
    """A CRS in metres for a place: its UTM zone, or a stereographic map around it for a `crs` of another body."""
    if crs is not None and not on_earth(crs):
        ellipsoid = parts_of_crs(crs).plan.ellipsoid
        size = f"+a={ellipsoid.semi_major_metre:.10g} +b={ellipsoid.semi_minor_metre:.10g}"
        return f"+proj=stere +lat_0={latitude:.6g} +lon_0={longitude:.6g} {size} +units=m"
    north, south = _POLAR
    if not south <= latitude <= north:
        return "EPSG:32661" if latitude > 0.0 else "EPSG:32761"
    zone = min(max(int((longitude + 180.0) // 6.0) + 1, 1), 60)
    return f"EPSG:{(32600 if latitude >= 0.0 else 32700) + zone}"


def warp_command(target: str) -> str:
    """The command that reprojects a raster of heights."""
    return f"{WARP} -t_srs {shlex.quote(target)} FILE OUT.tif"


def vector_command(target: str) -> str:
    """The command that reprojects a layer of footprints or trees."""
    return f"ogr2ogr -t_srs {shlex.quote(target)} OUT.gpkg FILE"


def city_command(target: str, assigned: str = "") -> str:
    """The command that reprojects CityJSON of any version; `assigned`: the code of its CRS, if the file names none.

    Degrees need ten digits: with the three of the default, houses collapse into points.
    """
    assign = f"crs_assign {assigned} " if assigned else ""
    code = target.removeprefix("EPSG:")
    return f"cjio FILE upgrade --digit 10 {assign}crs_reproject --digit 3 {code} save OUT.city.json"
