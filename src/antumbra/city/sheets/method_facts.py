"""What a sheet says about how a result was made, from the metadata of the study: method, rule, parameters, sources."""

import hashlib
from collections.abc import Iterator, Sequence
from datetime import date
from pathlib import Path
from typing import Any

from ...base.errors import InputError
from ...base.wording import counted
from ...engine.scene import AnyScene
from ...formats.stated_licence import licence_in
from ...scene.crs import parts_of_crs
from ...scene.units import METRE, UNITS, LengthUnit
from ...sun.location import Place
from ...version import VERSION

METHODS = {
    "sun": "Exact rays from each sensor to the sun in the middle of each interval. A sensor has sun if no surface is "
    "in between and the sun is above the sensor's own surface. Positions of the sun: NREL's Solar Position Algorithm.",
    "sun calendar": "Exact rays from the point to suns a step apart; the times between a hidden and a visible sun are "
    "halved down to a second. Positions of the sun: NREL's Solar Position Algorithm.",
    "shadow": "Exact shadows of all surfaces. Position of the sun: NREL's Solar Position Algorithm.",
    "skyline": "The exact upper edge of everything along each azimuth.",
    "viewshed": "Exact lines of sight from each observer to each sensor.",
    "visible share": "Exact lines of sight from each sensor to sample points of the target.",
    "los": "Exact lines of sight between both points of each pair.",
    "matrix": "Exact lines of sight from each sensor to each target.",
    "sky view": "Exact rays from each sensor to directions that divide the sky evenly.",
}
"""Job -> how it is done."""

OVERCAST = (
    "Light of the sky: exact rays from each sensor to directions that divide the sky evenly, weighted by the luminance "
    "of the CIE's overcast sky and by the cosine."
)
"""How the light of the sky is computed for a rule."""

_LENGTHS = {
    "eye_height", "min_distance", "max_distance", "earth_radius", "height", "cell", "hub_height", "rotor_diameter",
    "spacing",
}  # fmt: skip
_DEGREES = {"sun_azimuth", "sun_elevation", "azimuth", "elevation", "lowest", "facing", "tilt"}
_ELSEWHERE = {
    "job", "rules", "change", "warnings", "crs", "length_unit", "up", "scene", "areas", "latitude",
    "longitude", "timezone", "north", "first", "last", "suns", "hours", "altitude",
}  # fmt: skip
SUNLIT = "sun", "sun calendar", "shadow"  # jobs at a place, whose elevation is in metres
_NAMES = {
    "directions": "directions of the sky",
    "lowest": "lowest altitude of the sun",
    "per": "rows",
    "samples": "samples of the sun's disk",
    "sensors": "sensors from",
    "sunshine": "mean hours of sunshine, January to December",
    "max_distance": "greatest distance",
    "min_distance": "least distance",
}
_SUNS = {"limb": "the refracted upper limb", "centre": "the geometric centre"}
_PIECE = 1 << 22  # bytes read at once
_MOST_NOTES = 12


def unit_of(about: dict[str, Any]) -> LengthUnit:
    """The unit of lengths in the metadata of a study; metres if it names none."""
    return UNITS.get(str(about.get("length_unit", METRE.name)), METRE)


def place_in_about(about: dict[str, Any]) -> Place | None:
    """The place of a study; None: it has none."""
    if about.get("latitude") is None or about.get("longitude") is None:
        return None
    height = about.get("elevation") if about.get("job") in SUNLIT else 0.0  # else a range of angles
    return Place(
        float(about["latitude"]), float(about["longitude"]), float(height or 0.0), timezone=about.get("timezone")
    )


def day_of(about: dict[str, Any]) -> date | None:
    """The single day, or the day of the moment, of a study; None: it has several or none."""
    first, last = (str(about.get(name, ""))[:10] for name in ("first", "last"))
    text = first if first == last and first else str(about.get("time", ""))[:10]
    try:
        return date.fromisoformat(text)
    except ValueError:
        return None


def minutes_text(text: object) -> str:
    """A time without its seconds."""
    return str(text).replace("T", " ")[:16]


def position_text(about: dict[str, Any]) -> str:
    """The place of a study, and the direction of true north unless that is the northing of its coordinates."""
    turned = f"{about['north']:.2f}"
    north = "" if float(turned) == 0.0 else f"; true north at {turned} degrees"
    return f"{about['latitude']:.4f}, {about['longitude']:.4f}{north}"


def above_text(about: dict[str, Any]) -> str:
    """Above which altitude the suns of a study count."""
    return f"above {about['lowest']:g} degrees" if about.get("lowest") else "above the horizon"


def place_facts(about: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield names and texts of the place, the vegetation and the CRS in the metadata of a study."""
    if "latitude" in about:
        zone = about.get("timezone") or "solar zone"
        yield "place", f"{about['latitude']:.5f}, {about['longitude']:.5f} (WGS 84); {zone}"
    if about.get("trees"):
        yield "trees", str(about["trees"])
    if about.get("crs"):
        yield "reference system", crs_text(str(about["crs"]))


# --- The method -------------------------------------------------------------------------------------------------------


def method_facts(about: dict[str, Any], counts: Sequence[tuple[str, str]] = ()) -> Iterator[tuple[str, str]]:
    """Yield names and texts: the method, the rule, the sun, the place, all parameters, counts, version and notes.

    about : metadata of the study
    counts : further facts, such as the number of sensors
    """
    job, unit = str(about.get("job", "")), unit_of(about)
    if job in METHODS and about.get("suns") != 0:
        yield "method", METHODS[job]
    if job == "sun" and "directions" in about:
        yield "method", OVERCAST
    for text in about.get("change", []):
        yield "change", text
    for rule in about.get("rules", []):
        yield f"rule {rule['name']}", rule["text"]
        yield "clause", rule["citation"]
        yield "approximations", rule["notes"]
    if "first" in about and "last" in about:
        yield "period", f"{minutes_text(about['first'])} to {minutes_text(about['last'])}"
    if about.get("suns"):
        hours = f", {about['hours']:,.5g} h" if "hours" in about else ""  # rules of several days have none in common
        yield "sun positions", f"{about['suns']:,} {above_text(about)}{hours}"
    if "latitude" in about:
        zone = about.get("timezone") or "whole hour nearest to the longitude"
        yield (
            "place",
            f"latitude {about['latitude']:.5f}, longitude {about['longitude']:.5f} (WGS 84); time zone {zone}",
        )
    if "north" in about:
        yield "true north", f"{about['north']:.2f} degrees clockwise from that of the coordinates"
    for name, value in about.items():
        if name not in _ELSEWHERE and value is not None and value != [] and not (name == "elevation" and job in SUNLIT):
            yield _NAMES.get(name, name.replace("_", " ")), _value_text(name, value, unit, job)
    yield from counts
    yield "software", f"Antumbra {VERSION}"
    warnings = about.get("warnings") or []
    for text in ([warnings] if isinstance(warnings, str) else list(warnings))[:_MOST_NOTES]:
        yield "note", str(text)


def _value_text(name: str, value: Any, unit: LengthUnit, job: str) -> str:
    """A parameter with its unit."""
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if name == "per":
        return f"one per {value}"
    if name == "sun":
        return _SUNS.get(value, str(value))
    if name == "step" and number:
        return f"{value:g} {'degrees' if job == 'skyline' else 'minutes'}"
    if name in _LENGTHS and number:
        return "no limit" if value == float("inf") else f"{value:,.10g} {unit.name}"
    if isinstance(value, bool):
        return "yes" if value else "no"
    text = f"{value:,.6g}" if number else value if isinstance(value, str) else _list_text(value)
    return f"{text} degrees" if name in _DEGREES else text


def _list_text(value: Any) -> str:
    if isinstance(value, dict):
        return "; ".join(f"{key}: {_list_text(each)}" for key, each in value.items())
    if isinstance(value, (list, tuple)):
        return ", ".join(_list_text(each) for each in value)
    return f"{value:g}" if isinstance(value, float) else str(value)


# --- Sources ----------------------------------------------------------------------------------------------------------


def source_facts(
    about: dict[str, Any], scene: AnyScene | None, files: Sequence[Path], licence: str | None
) -> Iterator[tuple[str, str]]:
    """Yield names and texts: the scene, its CRS and unit, the files with their digests, the licence, and all notes.

    Raises
    ------
    InputError
        If a file cannot be read.
    """
    name = about.get("scene") or (scene.name if scene is not None else None)
    if name:
        file, mark, options = str(name).partition("?")
        yield "scene", f"{Path(file).name}{mark}{options}"  # without the folders of this machine
    if scene is not None:
        yield "contents", f"{counted(scene.n_triangles, 'triangle')}, {counted(len(scene.objects), 'object')}"
    if about.get("crs"):
        yield "reference system", crs_text(str(about["crs"]))
    unit = unit_of(about)
    yield "unit of coordinates", unit.name if unit is METRE else f"{unit.name} ({unit.metres:.9g} m)"
    yield "up axis", str(about.get("up") or (scene.up if scene is not None else "z"))
    for path in files:
        yield "file", f"{path.name}: {file_text(path)}"
    licences = [licence] if licence else [f"{path.name}: {text}" for path in files if (text := licence_in(path))]
    yield "licence of the data", "; ".join(licences) or "not stated in the files"
    notes = () if scene is None else scene.notes
    for text in notes[:_MOST_NOTES]:
        yield "note on the scene", text
    if len(notes) > _MOST_NOTES:
        yield "notes on the scene", f"{len(notes) - _MOST_NOTES} more; see antumbra info"


def crs_text(crs: str) -> str:
    """A CRS with its name, such as "EPSG:28992, Amersfoort / RD New"."""
    name = str(parts_of_crs(crs).plan.name)
    return crs if name in crs else f"{crs}, {name}"


def file_text(path: Path) -> str:
    """The size and the digest of a file; of a folder, the number of its files."""
    try:
        if path.is_dir():
            return f"a folder of {counted(sum(1 for _ in path.iterdir()), 'file')}"
        digest = hashlib.sha256()
        with open(path, "rb") as file:
            while data := file.read(_PIECE):
                digest.update(data)
        return f"{path.stat().st_size:,} bytes, SHA-256 {digest.hexdigest()}"
    except OSError as error:
        raise InputError(f"sources: {path.name} cannot be read: {error.strerror or error}") from None
