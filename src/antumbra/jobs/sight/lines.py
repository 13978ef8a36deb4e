"""Lines of sight as a table, and as a model: green as far as they see, red beyond what blocks them."""

import numpy as np

from ...engine.scene import AnyScene
from ..model import LINES, Part, glb
from ..sensors import corners_of, point_sensors
from ..table import Column, Table
from .pairs import Sightlines
from .readpairs import PairList

_GREEN, _RED, _GREY = (0.05, 0.6, 0.1), (0.7, 0.03, 0.03), (0.35, 0.35, 0.35)  # linear


def sight_table(scene: AnyScene, pairs: PairList, found: Sightlines) -> Table:
    """A row for each pair; its sensor is the observer."""
    names = np.array([each.name for each in scene.objects] + [""])
    columns = {name: Column(values, "", f"{name[0]} of the target") for name, values in
               zip(("x2", "y2", "z2"), pairs.targets.T)}  # fmt: skip
    columns |= {
        "visible": Column(found.visible, "", "the two points see each other"),
        "length": Column(found.length, "m", "distance from the observer to the target"),
        "face": Column(found.face, "", "the blocking face nearest to the observer"),
        "object": Column(found.object, "", "the object of this face"),
        "name": Column(names[found.object], "", "the object's name"),
        **_city_columns(scene, found),
        "distance": Column(found.distance, "m", "distance from the observer to the block"),
    }
    for name, values in zip(("px", "py", "pz"), found.point.T):
        columns[name] = Column(values, "", f"{name[1]} of the point that blocks")
    return Table(point_sensors(pairs.observers), columns, {"job": "los"}, scene)


def _city_columns(scene: AnyScene, found: Sightlines) -> dict[str, Column]:
    """What a city model knows of the blocking face."""
    if scene.city is None:
        return {}
    types, parents = (np.array([*names, ""]) for names in (scene.city.types, scene.city.parents))
    return {
        "type": Column(types[found.object], "", "the object's type"),
        "parent": Column(parents[found.object], "", "the object that it is a part of"),
        "surface": Column(scene.city.surface_types(found.face), "", "type of the face's semantic surface"),
    }


def sight_model(scene: AnyScene, pairs: PairList, found: Sightlines) -> bytes:
    """A GLB file of the scene and the lines."""
    corners = (corners_of(scene) - scene.origin).reshape(-1, 3)
    soup = np.arange(len(corners), dtype=np.uint32).reshape(-1, 3)
    parts = [Part(scene.name, corners, np.broadcast_to(_GREY, corners.shape), soup)]
    hidden = ~found.visible
    stop = np.where(hidden[:, None], found.point, pairs.targets)
    for name, colour, begin, end in (
        ("seen", _GREEN, pairs.observers, stop),
        ("hidden", _RED, found.point[hidden], pairs.targets[hidden]),
    ):
        if len(begin):
            ends = np.stack([begin, end], 1).reshape(-1, 3) - scene.origin
            lines = np.arange(len(ends), dtype=np.uint32).reshape(-1, 2)
            parts.append(Part(name, ends, np.broadcast_to(colour, ends.shape), lines, LINES))
    known = {} if scene.crs is None else {"crs": scene.crs}
    return glb(parts, scene.up, {"origin": scene.origin.tolist(), "job": "los", **known})
