"""Edits of a glTF file for a bake: meshes of its own for each node, attributes, materials."""

import copy
from collections.abc import Callable, Hashable, Sequence
from typing import Any

import numpy as np

from ...formats.gltf.accessors import Accessors
from .asset import Asset
from .parts import Part

UNLIT = "KHR_materials_unlit"


def own_primitives(asset: Asset, parts: Sequence[Part]) -> list[dict]:
    """The JSON of each part's primitive, in a mesh that no other node shows.

    Baked values differ from node to node. A mesh that several nodes show is divided: the first of these nodes keeps
    it, the others get copies. The copies share all accessors.
    """
    nodes, meshes = asset.json["nodes"], asset.json["meshes"]
    baked = list(dict.fromkeys(part.node for part in parts))
    others = {node.get("mesh") for i, node in enumerate(nodes) if i not in set(baked)}
    kept: set[int] = set()
    for i in baked:
        mesh = nodes[i]["mesh"]
        if mesh in kept or mesh in others:
            nodes[i]["mesh"] = asset.add("meshes", copy.deepcopy(meshes[mesh]))
        kept.add(mesh)
    return [meshes[nodes[part.node]["mesh"]]["primitives"][part.index] for part in parts]


def change_materials(
    asset: Asset, primitives: Sequence[dict], keys: Sequence[Hashable], change: Callable[[dict, Any], None]
) -> None:
    """Call ``change(material, key)`` for the material of each primitive.

    A material is changed once for each key. It is copied if other primitives, or those of another key, have it too.
    """
    changed, mine = {}, {id(primitive) for primitive in primitives}
    everything = [primitive for mesh in asset.json["meshes"] for primitive in mesh["primitives"]]
    taken = {primitive.get("material") for primitive in everything if id(primitive) not in mine}
    for primitive, key in zip(primitives, keys):
        index = primitive.get("material")
        if (index, key) not in changed:
            if index is None:
                own = asset.add("materials", {})
            elif index in taken:
                own = asset.add("materials", copy.deepcopy(asset.json["materials"][index]))
            else:
                own = index
            changed[index, key] = own
            taken.add(index)
        primitive["material"] = changed[index, key]
    for (_, key), own in changed.items():
        change(asset.json["materials"][own], key)


def make_unlit(asset: Asset, material: dict) -> None:
    """Tell viewers to show the base colour as it is: the light is in it already."""
    material.setdefault("extensions", {})[UNLIT] = {}
    asset.uses(UNLIT)


def all_rows(part: Part, values: np.ndarray) -> np.ndarray:
    """(count, c): values of the part's vertices at the rows of its accessors; 1 where no face uses a row."""
    out = np.ones((part.count, values.shape[1]), np.float32)
    out[part.rows] = values
    return out


def write_colours(asset: Asset, accessors: Accessors, primitive: dict, colours: np.ndarray, multiply: bool) -> None:
    """Write COLOR_0 of a primitive: linear RGB in 16 bits. The alpha of an earlier COLOR_0 stays.

    colours : (rows, 1 or 3) float32 in [0, 1]
    multiply : multiply the earlier colours, instead of replacing them
    """
    rgba = np.ones((len(colours), 4))
    earlier = primitive["attributes"].get("COLOR_0")
    if earlier is not None:
        before = accessors.floats(earlier, "VEC3", "VEC4")
        rgba[:, 3 if not multiply else 0 : before.shape[1]] = before[:, 3 if not multiply else 0 :]
    rgba[:, :3] *= colours
    whole = np.round(65535.0 * np.clip(rgba, 0.0, 1.0)).astype("<u2")
    primitive["attributes"]["COLOR_0"] = asset.accessor(whole, normalized=True)


class Remapper:
    """Rewrites the attributes of primitives for other vertices; equal ones are written once."""

    def __init__(self, asset: Asset, accessors: Accessors):
        self._asset, self._accessors = asset, accessors
        self._made: dict[tuple[int, bytes], int] = {}
        self._indices: dict[bytes, int] = {}

    def remap(self, primitive: dict, rows: np.ndarray, faces: np.ndarray) -> None:
        """Make `rows` ((v,) of the accessors) the vertices of a primitive, and `faces` ((f, 3) into them) its faces."""
        key = rows.astype(np.int64).tobytes()
        for attributes in (primitive["attributes"], *primitive.get("targets", [])):
            for name, index in attributes.items():
                attributes[name] = self._taken(index, rows, key, name == "POSITION")
        kind = "<u2" if len(rows) < 65535 else "<u4"
        indices = faces.reshape(-1).astype(kind)
        if indices.tobytes() not in self._indices:
            self._indices[indices.tobytes()] = self._asset.accessor(indices, indices=True)
        primitive["indices"] = self._indices[indices.tobytes()]
        primitive.pop("mode", None)

    def _taken(self, index: int, rows: np.ndarray, key: bytes, bounds: bool) -> int:
        if (index, key) not in self._made:
            normalized = bool(self._asset.json["accessors"][index].get("normalized"))
            values = self._accessors.stored(index)[rows]
            made = self._asset.accessor(
                values[:, 0] if values.shape[1] == 1 else values, normalized=normalized, bounds=bounds
            )
            self._made[index, key] = made
        return self._made[index, key]
