"""Checks of the points given to studies: observers, targets, sensors and cameras.

Points whose results would be meaningless are refused: degrees in a scene on a map, and points to be placed on a surface
where there is none. Other doubtful points are counted in a note, which is a warning in Python and a line of the
command: points beside the scene, below the ground, on a surface without a normal, and behind a surface drawn on theirs.
"""

import re
import sys
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...base.errors import InputError
from ...base.wording import place_text, some_of
from ...engine.measured_scenes import check_degrees
from ...engine.scene import AnyScene
from ...query.receivers import SHIFT, Receivers
from ...scene.scene_bounds import plan_points
from .raster_grid import plan_of
from .sensors import Sensors, face_sensors, point_sensors
from .sensors import on_top as highest_surface

NEAR = 0.005
"""Metres: another surface less than this in front of a sensor is drawn on the sensor's own, as windows are."""

_PARALLEL = 0.9  # cosine between the normals of such surfaces
_BESIDE = 1e-6  # widths of a raster of heights: points closer to its bounds lie on them, up to rounding
_BELOW = "lie below the ground or inside a solid"

# --- Notes ------------------------------------------------------------------------------------------------------------


def tell(notes: Sequence[str]) -> dict[str, list[str]]:
    """Issue notes as warnings at the caller of the library; return them as metadata of the study, if there are any."""
    depth, frame = 1, sys._getframe()
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] == "antumbra":
        depth, frame = depth + 1, frame.f_back
    for note in notes:
        warnings.warn(note, UserWarning, stacklevel=depth)
    return {"warnings": list(notes)} if notes else {}


class Note(str):
    """A note that counts some of many points, so that the notes on blocks of points add up."""

    number: int
    about: tuple[str, str, str]  # the points, what is noted, and the first one

    @classmethod
    def of(cls, number: int, total: int, about: tuple[str, str, str]) -> "Note":
        what, words, first = about
        noun = re.sub(r"s\b", "", what, count=1)  # singular: "points of the target" are regular, as all others
        note = cls(f"{some_of(number, total, noun, words)}; the first is {first}")
        note.number, note.about = number, about
        return note


def joined_notes(blocks: Iterable[Sequence[tuple[int, tuple[str, str, str]]]], total: int) -> list[str]:
    """The notes on `total` points, from the numbers and `Note.about` of each block."""
    found = dict[tuple[str, str], tuple[int, str]]()
    for block in blocks:
        for number, (what, words, first) in block:
            before, earliest = found.get((what, words), (0, first))
            found[what, words] = before + number, earliest
    return [Note.of(number, total, (*key, first)) for key, (number, first) in found.items()]


def _note(what: str, which: NDArray[np.bool_], at: NDArray[np.float64], words: str) -> list[str]:
    """A `Note` on some points; none if there are none."""
    if not which.any():
        return []
    return [Note.of(int(which.sum()), len(at), (what, words, place_text(at[which.argmax()])))]


# --- Points -----------------------------------------------------------------------------------------------------------


def notes_on_sensors(
    scene: AnyScene, sensors: Sensors, what: str, time: float = 0.0, threads: int | None = None
) -> list[str]:
    """Notes on the points of a study; what: their name in messages, in the plural.

    Raises
    ------
    InputError
        If points are in degrees, and the scene is not.
    """
    faces = sensors.faces
    free = np.ones(len(sensors), bool) if faces is None else faces < 0
    if sensors.kind == "raster" and not free.all():
        return _notes_on_offset_raster(scene, sensors.points, ~free, what, time, threads)
    notes = notes_on_points(scene, sensors.points[free], what, time, threads)
    if sensors.kind == "raster":
        return notes
    if sensors.normals is None:
        return notes + notes_on_bare_points(scene, sensors.points[free], what, time, threads)
    behind = _closely_covered(scene, sensors.points, sensors.normals, time, threads)
    near = scene.unit.of_metres(NEAR)
    words = f"lie less than {near:.3g} behind another surface, as windows drawn on a wall do"
    words = f"{words}; lift sensors off their surface, as face+{2.0 * near:.3g} does"
    return notes + _note(what, behind, sensors.points, words)


def _notes_on_offset_raster(
    scene: AnyScene, at: NDArray[np.float64], covered: NDArray[np.bool_], what: str, time: float, threads: int | None
) -> list[str]:
    """Notes on raster cells at one height above the highest surfaces: if the first lies below its surface, all do."""
    first = at[covered.argmax()][None]
    below = depths_below_ground(scene, first, time, threads) > _rounding(scene, first)
    return _note(what, covered & below, at, _BELOW)


def notes_on_points(
    scene: AnyScene, at: NDArray[np.float64], what: str, time: float = 0.0, threads: int | None = None
) -> list[str]:
    """Notes on points, (n, 3) world, that lie beside the scene or below the ground. Raises InputError for degrees.

    Beside a raster of heights, there is no ground. Beside other scenes, points are noted from a distance of its extent.
    """
    if not len(at):
        return []
    check_degrees(scene, at, what)
    (low, high), plan = plan_of(scene), plan_points(at, scene.up)
    margin, words = float(np.ptp(scene.bounds, axis=0).max()), f"lie far beside {scene.name}"
    if scene.raster is not None:
        margin, words = _BESIDE * margin, f"lie beside {scene.name}"
    beside = ((plan < low - margin) | (plan > high + margin)).any(1)
    notes = _note(what, beside, at, words)
    deep = depths_below_ground(scene, at, time, threads) > _rounding(scene, at)
    return notes + _note(what, deep, at, _BELOW)


def notes_on_bare_points(
    scene: AnyScene, at: NDArray[np.float64], what: str, time: float = 0.0, threads: int | None = None
) -> list[str]:
    """Notes on points without normals and faces, (n, 3) world, that lie on a surface, which may hide them."""
    if not len(at):
        return []
    on, reach = np.zeros(len(at), bool), _rounding(scene, at)
    for axis in range(3):  # a surface crosses one of three short segments
        step = np.zeros_like(at)
        step[:, axis] = reach
        on |= np.asarray(scene.occluded(at - step, targets=at + step, time=time, threads=threads))
    words = "lie on a surface without a normal, so it may block the view; give normals, or move points off it"
    return _note(what, on, at, words)


def _rounding(scene: AnyScene, at: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) float64: the distance to a surface that float32 rounding explains, as that by which receivers are moved."""
    x, y, z = np.abs(at - scene.origin).T  # NumPy reduces short rows slowly
    size = np.maximum(np.maximum(x, y), np.maximum(z, np.ptp(scene.bounds, axis=0).max()))
    out: NDArray[np.float64] = np.maximum(SHIFT * size, np.finfo(np.float32).tiny)
    return out


# --- Degrees, and places without a surface ----------------------------------------------------------------------------


def on_surface(
    scene: AnyScene, at: NDArray[np.float64], what: str, time: float = 0.0, threads: int | None = None
) -> NDArray[np.float64]:
    """(n, 3) float64: points moved to the highest surface above or below them.

    Raises
    ------
    InputError
        If points are in degrees, or lie beside the scene or on a hole. The message has their number.
    """
    check_degrees(scene, at, what)
    if (terrain := scene.data.terrain) is not None:
        tops = terrain.at(at[:, :2])
    else:
        tops, faces = highest_surface(scene, at, time, threads)
        tops = np.where(faces >= 0, tops, np.nan)
    words = f"lie beside {scene.name} or on a hole, where no surface is to place points on"
    if missing := _note(what, np.isnan(tops), at, words):
        raise InputError(f"{missing[0]}; move such points, or give heights without on_surface")
    placed = at.copy()
    placed[:, "xyz".index(scene.up)] = tops
    return placed


def raised(
    scene: AnyScene, sensors: Sensors, height: float, on_top: bool, what: str, time: float = 0.0,
    threads: int | None = None,
) -> Sensors:  # fmt: skip
    """The eyes at points: `height` above them, or above the highest surface there if `on_top`, with their attributes.

    Eyes above points lie in free space, and those on the surface itself face up. Without either, points stay as they
    are.
    """
    if height == 0.0 and not on_top:
        return sensors
    up, eyes = np.eye(3)["xyz".index(scene.up)], sensors.points
    if on_top:
        eyes = on_surface(scene, eyes, what, time, threads)
    normals = np.tile(up, (len(eyes), 1)) if height == 0.0 else None
    return replace(point_sensors(eyes + height * up, normals), attributes=sensors.attributes)


# --- Below the ground -------------------------------------------------------------------------------------------------


def depths_below_ground(
    scene: AnyScene, at: NDArray[np.float64], time: float = 0.0, threads: int | None = None
) -> NDArray[np.float64]:
    """(n,) float64: how deep points, (n, 3) world, lie below the ground or in a solid; 0 elsewhere.

    The first surface above is then seen from its back, and so is the first one below, if there is any. Sheets with a
    face on each side are no solids.
    """
    axis = "xyz".index(scene.up)
    if (terrain := scene.data.terrain) is not None:
        tops = terrain.at(at[:, :2])
        return np.nan_to_num(np.maximum(tops - at[:, axis], 0.0))
    upward, out = np.eye(3)[axis], np.zeros(len(at))
    hit = scene.closest_hit(at, upward, time=time, threads=threads)
    if not hit.mask.any():
        return out
    some = np.flatnonzero(np.nan_to_num(hit.normal[:, axis]) > 0.0)

    def first(direction: NDArray[np.float64], others: str) -> NDArray[np.float64]:
        return scene.closest_hit(at[some], direction, cull_faces=others, time=time, threads=threads).t

    above = first(upward, "front")
    in_ground = (above < first(upward, "back")) & (first(-upward, "front") <= first(-upward, "back"))
    out[some] = np.where(in_ground, above, 0.0)
    return out


# --- Behind a surface drawn on their own ------------------------------------------------------------------------------


def notes_on_faces(scene: AnyScene, sign: float, time: float = 0.0, threads: int | None = None) -> list[str]:
    """Notes on faces of a scene whose centre lies closely behind another face; sign: -1 for their backs."""
    centres = face_sensors(scene, time)
    assert centres.normals is not None
    behind = _closely_covered(scene, centres.points, sign * centres.normals, time, threads, sign)
    near = scene.unit.of_metres(NEAR)
    words = f"lie less than {near:.3g} behind another face, as windows drawn on a wall do, and see nothing else"
    return _note("faces", behind, centres.points, f"{words}; cut the wall around windows in the model")


def _closely_covered(
    scene: AnyScene, at: NDArray[np.float64], normals: NDArray[np.float64], time: float, threads: int | None,
    sign: float = 1.0,
) -> NDArray[np.bool_]:  # fmt: skip
    """(n,) bool: whether a surface that faces the same way lies less than `NEAR` in front of each point.

    sign : -1 if surfaces face backwards

    Surfaces that face each other, such as party walls, hide each other rightly.
    """
    near = scene.unit.of_metres(NEAR)
    origins = Receivers.on_surface(at, normals, scene.origin, scene.middle).origins[0] + scene.origin
    covered = np.asarray(scene.occluded(origins, normals, tmax=near, time=time, threads=threads))
    places = np.flatnonzero(covered)
    if len(places):
        hits = scene.closest_hit(origins[places], normals[places], tmax=near, time=time, threads=threads)
        covered[places] = sign * (hits.normal * normals[places]).sum(1) > _PARALLEL
    return covered
