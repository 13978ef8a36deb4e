"""The glTF node hierarchy: transforms, keyframe animation, and the cameras and lights at nodes."""

import math
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...base.checks import quoted, spelling_hint
from ...base.errors import InputError
from ...base.wording import counted
from ...kernels.elementary import acos, sin
from ...kernels.small_matrices import dot, product
from ...kernels.small_matrices import length as length_of
from ...scene.camera import Camera
from ...scene.instances import singular
from ...scene.lights import DirectionalLight, Light, PointLight
from ..json_fields import Fields
from .accessors import Accessors

# --- Nodes: local transforms and world matrices -----------------------------------------------------------------------


class Nodes(NamedTuple):
    """All nodes of a file, in the rest pose."""

    fields: list[Fields]
    translation: NDArray[np.float64]  # (n, 3) float64
    rotation: NDArray[np.float64]  # (n, 4) float64, quaternion x y z w, unit
    scale: NDArray[np.float64]  # (n, 3) float64
    matrix: NDArray[np.float64]  # (n, 4, 4) float64, used instead of the three above where `fixed`
    fixed: NDArray[np.bool_]  # (n,) bool
    parent: NDArray[np.int64]  # (n,) int64, -1 for a root
    levels: list[np.ndarray]  # node indices by depth, roots first
    visible: NDArray[np.bool_]  # (n,) bool, whether the node is in the default scene


def read_nodes(root: Fields) -> Nodes:
    """The nodes of a file; those in its default scene are visible."""
    fields = root.objects("nodes")
    n = len(fields)
    children = [f.indices("children", n) for f in fields]
    parent = _parents(fields, children)
    levels = _levels(fields, parent)
    translation = np.array([f.numbers("translation", 3, (0.0, 0.0, 0.0)) for f in fields]).reshape(n, 3)
    rotation = np.array([f.numbers("rotation", 4, (0.0, 0.0, 0.0, 1.0)) for f in fields]).reshape(n, 4)
    scale = np.array([f.numbers("scale", 3, (1.0, 1.0, 1.0)) for f in fields]).reshape(n, 3)
    fixed = np.array(["matrix" in f for f in fields], bool)
    matrix = np.array([_matrix(f) for f in fields]).reshape(n, 4, 4)
    length = np.linalg.norm(rotation, axis=1)
    if not (length > 0.0).all():
        raise fields[int(np.argmin(length))].bad("rotation", "a unit quaternion; zero has no inverse")
    visible = _reachable(root, fields, children, parent)
    return Nodes(fields, translation, rotation / length[:, None], scale, matrix, fixed, parent, levels, visible)


def local_matrices(translation: ArrayLike, rotation: ArrayLike, scale: ArrayLike) -> NDArray[np.float64]:
    """Translation times rotation times scale ((..., 4, 4) float64). Quaternions are unit x, y, z, w."""
    x, y, z, w = np.moveaxis(np.asarray(rotation, np.float64), -1, 0)
    matrices = np.zeros((*x.shape, 4, 4))
    matrices[..., 0, 0], matrices[..., 1, 1] = 1 - 2 * (y * y + z * z), 1 - 2 * (x * x + z * z)
    matrices[..., 2, 2], matrices[..., 3, 3] = 1 - 2 * (x * x + y * y), 1.0
    matrices[..., 0, 1], matrices[..., 1, 0] = 2 * (x * y - z * w), 2 * (x * y + z * w)
    matrices[..., 0, 2], matrices[..., 2, 0] = 2 * (x * z + y * w), 2 * (x * z - y * w)
    matrices[..., 1, 2], matrices[..., 2, 1] = 2 * (y * z - x * w), 2 * (y * z + x * w)
    matrices[..., :3, :3] *= np.asarray(scale)[..., None, :]
    matrices[..., :3, 3] = translation
    return matrices


def posed_matrices(
    nodes: Nodes, translation: np.ndarray, rotation: np.ndarray, scale: np.ndarray
) -> NDArray[np.float64]:
    """(n, 4, 4) float64: local matrices of all nodes, from these values, or from the node's matrix where `fixed`."""
    local = local_matrices(translation, rotation, scale)
    local[nodes.fixed] = nodes.matrix[nodes.fixed]
    return local


def world_matrices(nodes: Nodes, local: np.ndarray) -> NDArray[np.float64]:
    """(n, 4, 4) float64: each node's transform to world space, computed level by level from the roots."""
    world = local.copy()
    for level in nodes.levels[1:]:
        world[level] = product(world[nodes.parent[level]], local[level])
    return world


def with_ancestors(nodes: Nodes, selection: np.ndarray) -> NDArray[np.bool_]:
    """(n,) bool: the nodes in `selection` ((n,) bool) and all their ancestors."""
    ancestors = selection.copy()
    for level in reversed(nodes.levels[1:]):
        np.logical_or.at(ancestors, nodes.parent[level], ancestors[level])
    return ancestors


def check_invertible(nodes: Nodes, needed: np.ndarray) -> None:
    """Raise InputError with the first node in `needed` ((n,) bool) whose transform at rest has no inverse."""
    local = posed_matrices(nodes, nodes.translation, nodes.rotation, nodes.scale)
    bad = np.flatnonzero(needed & singular(local))
    if len(bad):
        where = nodes.fields[int(bad[0])].where
        raise InputError(f"{where} has a transform without inverse; give it a scale or matrix that is not flat")


def _matrix(fields: Fields) -> NDArray[np.float64]:
    values = fields.numbers("matrix", 16, None)
    if values is None:
        return np.eye(4)
    matrix: NDArray[np.float64] = values.reshape(4, 4).T  # glTF stores columns
    if not np.allclose(matrix[3], (0.0, 0.0, 0.0, 1.0), atol=1e-6):
        raise fields.bad("matrix", "affine: every fourth number 0, the last 1")
    matrix[3] = 0.0, 0.0, 0.0, 1.0
    return matrix


def _parents(fields: list[Fields], children: list[list[int]]) -> np.ndarray:
    parent = np.full(len(fields), -1, np.int64)
    for i, child_list in enumerate(children):
        for child in child_list:
            if parent[child] >= 0 and parent[child] != i:
                parents = f"nodes {parent[child]} and {i}"
                raise InputError(f"{fields[child].where} has two parents, {parents}; glTF nodes form a tree")
            parent[child] = i
    return parent


def _levels(fields: list[Fields], parent: np.ndarray) -> list[np.ndarray]:
    """Node indices by depth. Raises InputError on a cycle of parents."""
    depth = np.full(len(parent), -1, np.int64)
    for i in range(len(parent)):
        path = []
        while i >= 0 and depth[i] == -1:
            depth[i] = -2  # on the current path
            path.append(i)
            i = int(parent[i])
        if i >= 0 and depth[i] == -2:
            raise InputError(f"{fields[i].where} is its own ancestor; glTF nodes form a tree, export the file again")
        base = depth[i] if i >= 0 else -1
        for step, j in enumerate(reversed(path), 1):
            depth[j] = base + step
    order = np.argsort(depth, kind="stable")
    ends = np.searchsorted(depth[order], np.arange(depth.max(initial=-1) + 2))
    return [order[a:b] for a, b in pairwise(ends)]


def _reachable(root: Fields, fields: list[Fields], children: list[list[int]], parent: np.ndarray) -> np.ndarray:
    scenes = root.objects("scenes")
    if scenes:
        roots = scenes[root.whole("scene", 0, high=len(scenes))].indices("nodes", len(fields))
    else:
        roots = np.flatnonzero(parent < 0).tolist()
    visible = np.zeros(len(fields), bool)
    while roots:
        node = roots.pop()
        if not visible[node]:
            visible[node] = True
            roots.extend(children[node])
    return visible


# --- Keyframe animation -----------------------------------------------------------------------------------------------


WIDTH = {"translation": 3, "rotation": 4, "scale": 3}
STEP, LINEAR, CUBICSPLINE = "STEP", "LINEAR", "CUBICSPLINE"


class Track(NamedTuple):
    """One animated property of one node."""

    node: int
    path: str  # "translation", "rotation", "scale" or "weights"
    interpolation: str
    times: NDArray[np.float64]  # (k,) float64, seconds, non-decreasing
    values: NDArray[np.float64]  # (k, c) float64; CUBICSPLINE: (k, 3, c) of in-tangent, value, out-tangent


def read_tracks(
    root: Fields, accessors: Accessors, nodes: Nodes, n_weights: list[int], chosen: str | None = None
) -> tuple[list[Track], list[str]]:
    """The (tracks, notes) of all animations, or of the one that is chosen by its name, or its number if it has none.

    All animations play at once. If several animate the same property of a node, as the clips of a character do, the
    first one in the file wins, as in viewers that play the first clip.
    """
    tracks: dict[tuple[int, str], Track] = {}
    unit_keys = _UnitKeys()
    left_out: list[str] = []
    for number, animation in _chosen_animations(root, chosen):
        samplers, conflict = animation.objects("samplers"), False
        for channel in animation.objects("channels"):
            track = _track(channel, samplers, accessors, nodes, n_weights, unit_keys)
            if track is not None:
                conflict |= tracks.setdefault((track.node, track.path), track) is not track
        if conflict:
            left_out.append(animation.text("name", None) or str(number))
    notes = []
    if left_out:
        names = ", ".join(name[:40] for name in left_out[:8]) + (", ..." if len(left_out) > 8 else "")
        notes.append(
            f"{root.where} these animations conflict with an earlier one, which takes precedence: {names}; choose one "
            "with animation=NAME"
        )
    return list(tracks.values()), notes


def _chosen_animations(root: Fields, chosen: str | None) -> list[tuple[int, Fields]]:
    """The numbered animations that play. Raises InputError if none has the chosen name."""
    animations = list(enumerate(root.objects("animations")))
    if chosen is None:
        return animations
    names = [each.text("name", None) or str(number) for number, each in animations]
    if chosen not in names:
        known = f"{spelling_hint(chosen, names)}use {', '.join(names[:20])}" if names else "the file has none"
        raise InputError(f"{root.where} animation {quoted(chosen)} is unknown; {known}")
    return [animations[names.index(chosen)]]


def sample_track(track: Track, time: float) -> NDArray[np.float64]:
    """The value ((c,) float64) of a track at `time`, clamped to the first and last key."""
    times, values = track.times, track.values
    keys = values[:, 1] if track.interpolation == CUBICSPLINE else values
    k = int(np.searchsorted(times, time, side="right")) - 1
    before: NDArray[np.float64] = keys[max(k, 0)]
    if k < 0 or k >= len(times) - 1 or track.interpolation == STEP:
        return before
    step = times[k + 1] - times[k]
    t = (time - times[k]) / step
    if track.interpolation == CUBICSPLINE:
        return _hermite(values[k], values[k + 1], t, step, track.path == "rotation")
    if track.path == "rotation":
        return _slerp(before, keys[k + 1], t)
    value: NDArray[np.float64] = (1.0 - t) * before + t * keys[k + 1]
    return value


def _slerp(a: np.ndarray, b: np.ndarray, t: float) -> NDArray[np.float64]:
    """Spherical linear interpolation of unit quaternions along the shorter arc."""
    cosine = float(dot(a, b))
    sign = -1.0 if cosine < 0.0 else 1.0
    angle = acos(min(abs(cosine), 1.0))
    if angle < 1e-6:
        q = (1.0 - t) * a + sign * t * b
    else:
        q = (sin((1.0 - t) * angle) * a + sign * sin(t * angle) * b) / sin(angle)
    out: NDArray[np.float64] = q / length_of(q)
    return out


def _hermite(
    before: NDArray[np.float64], after: NDArray[np.float64], t: float, step: float, rotation: bool
) -> NDArray[np.float64]:
    """A cubic Hermite spline. Tangents are per second, so they are scaled by the key interval."""
    t2, t3 = t * t, t * t * t
    value: NDArray[np.float64] = (
        (2 * t3 - 3 * t2 + 1) * before[1]
        + step * (t3 - 2 * t2 + t) * before[2]
        + (3 * t2 - 2 * t3) * after[1]
        + step * (t3 - t2) * after[0]
    )
    if not rotation:
        return value
    length = length_of(value)
    unit: NDArray[np.float64] = value / length if length > 1e-12 else before[1]
    return unit


def _track(
    channel: Fields,
    samplers: list[Fields],
    accessors: Accessors,
    nodes: Nodes,
    n_weights: list[int],
    unit_keys: "_UnitKeys",
) -> Track | None:
    target = channel.object("target")
    path = None if target is None else target.text("path", None)
    if target is None or path not in (*WIDTH, "weights") or "node" not in target:
        return None  # a target defined by an extension
    node = target.whole("node", high=len(nodes.fields))
    if path != "weights" and nodes.fixed[node]:
        node_name = nodes.fields[node].where
        raise InputError(f"{channel.where} moves {node_name}, which has a matrix; export it with TRS instead")
    sampler = samplers[channel.whole("sampler", high=len(samplers))]
    interpolation = sampler.text("interpolation", LINEAR)
    if interpolation not in (STEP, LINEAR, CUBICSPLINE):
        raise sampler.bad("interpolation", "STEP, LINEAR or CUBICSPLINE")
    times = accessors.finite(sampler.whole("input", high=len(accessors)), "SCALAR")[:, 0]
    if len(times) == 0:
        return None
    if (times[1:] < times[:-1]).any():
        raise InputError(f"{sampler.where}: times of the keys go backwards; export the animation again")
    width = n_weights[node] if path == "weights" else WIDTH[path]
    if width == 0:
        return None  # weights of a mesh without morph targets
    kind = "SCALAR" if path == "weights" else f"VEC{width}"
    output = accessors.finite(sampler.whole("output", high=len(accessors)), kind)
    shape = (len(times), 3, width) if interpolation == CUBICSPLINE else (len(times), width)
    if output.size != math.prod(shape):
        raise InputError(
            f"{sampler.where} has {counted(output.size, 'number')} for {counted(len(times), 'key')}; "
            f"{math.prod(shape)} are needed"
        )
    values = output.reshape(shape)
    if path == "rotation":
        values = unit_keys.of(values, sampler)
    return Track(node, path, interpolation, times, values)


class _UnitKeys:
    """Normalised rotation keys. Nodes that turn alike share them."""

    def __init__(self) -> None:
        self._known = dict[tuple[int, tuple[int, ...]], np.ndarray]()  # address and shape of the keys in the file

    def of(self, values: np.ndarray, sampler: Fields) -> np.ndarray:
        key = values.__array_interface__["data"][0], values.shape
        if key not in self._known:
            self._known[key] = _unit_keys(values, sampler)
        return self._known[key]


def _unit_keys(values: np.ndarray, sampler: Fields) -> np.ndarray:
    """Rotation keys of length 1. Spline tangents are not changed."""
    values = values.copy()
    keys = values[:, 1] if values.ndim == 3 else values
    lengths = np.linalg.norm(keys, axis=1, keepdims=True)
    if not (lengths > 0.0).all():
        raise InputError(f"{sampler.where} has a rotation key that is zero; quaternions must be of unit length")
    keys /= lengths
    return values


# --- Cameras and KHR_lights_punctual lights ---------------------------------------------------------------------------


HEIGHT = 1024  # picture height in pixels; glTF specifies only the aspect ratio
LIGHTS_EXTENSION = "KHR_lights_punctual"


class GltfViews:
    """The cameras and lights of a file's default scene, in the order of their nodes."""

    def __init__(self, root: Fields, nodes: Nodes):
        self.notes: list[str] = []
        self._nodes = nodes
        self._cameras = self._placed_cameras(root)
        self._lights = self._placed_lights(root)

    def holders(self) -> list[int]:
        """The nodes with a camera or light."""
        return [node for node, _ in self._cameras] + [node for node, *_ in self._lights]

    def cameras(self, world: np.ndarray) -> list[Camera]:
        """The cameras, which look along -Z of their nodes; `world` holds the nodes' world matrices."""
        cameras = []
        for node, lens in self._cameras:
            position, up, backward = world[node][:3, 3], self._axis(world, node, 1), self._axis(world, node, 2)
            cameras.append(Camera(position, position - backward, up, height=HEIGHT, **lens))
        return cameras

    def lights(self, world: np.ndarray) -> list[Light]:
        """The lights. Directional lights shine along -Z of their nodes."""
        lights: list[Light] = []
        for node, kind, intensity, colour, name in self._lights:
            light: Light
            if kind == "directional":
                direction = -self._axis(world, node, 2)
                light = DirectionalLight(direction=direction, intensity=intensity, colour=colour)
            else:
                light = PointLight(position=world[node][:3, 3], intensity=intensity, colour=colour)
            lights.append(light.named(name))
        return lights

    def _axis(self, world: np.ndarray, node: int, column: int) -> NDArray[np.float64]:
        axis = world[node][:3, column]
        length = length_of(axis)
        if not 0.0 < length < np.inf:
            raise InputError(f"{self._nodes.fields[node].where} holds a camera or light but its transform is flat")
        unit: NDArray[np.float64] = axis / length
        return unit

    def _placed_cameras(self, root: Fields) -> list[tuple[int, dict[str, Any]]]:
        cameras, entries = root.objects("cameras"), []
        for node in np.flatnonzero(self._nodes.visible).tolist():
            index = self._nodes.fields[node].whole("camera", None, high=len(cameras))
            if index is None:
                continue
            perspective, flat = cameras[index].object("perspective"), cameras[index].object("orthographic")
            if perspective is not None:
                entries.append((node, _perspective(perspective)))
            elif flat is not None:
                entries.append((node, _orthographic(flat)))
            else:
                self.notes.append(f"{cameras[index].where} is neither perspective nor orthographic; left out")
        return entries

    def _placed_lights(self, root: Fields) -> list[tuple[int, str, float, tuple[float, ...], str]]:
        extension = root.extension(LIGHTS_EXTENSION)
        lights, entries = [] if extension is None else extension.objects("lights"), []
        for node in np.flatnonzero(self._nodes.visible).tolist():
            reference = self._nodes.fields[node].extension(LIGHTS_EXTENSION)
            if reference is None:
                continue
            light = lights[reference.whole("light", high=len(lights))]
            kind, intensity = light.text("type"), light.number("intensity", 1.0)
            if kind not in ("point", "directional", "spot"):
                raise light.bad("type", "point, directional or spot")
            if intensity < 0.0:
                raise light.bad("intensity", "0 or more")
            if kind == "spot":
                self.notes.append(f"{light.where} is a spot light; taken as a point light that shines all around")
            colour = tuple(np.maximum(light.numbers("color", 3, np.ones(3)), 0.0).tolist())
            name = light.text("name", "") or self._nodes.fields[node].text("name", "")
            entries.append((node, kind, intensity, colour, name))
        return entries


def _perspective(lens: Fields) -> dict[str, Any]:
    """The arguments of a perspective `Camera`."""
    vfov, aspect = np.degrees(lens.number("yfov")), lens.number("aspectRatio", 1.0)
    if not 0.0 < vfov < 180.0:
        raise lens.bad("yfov", "an angle between 0 and pi radians")
    if not 1.0 / HEIGHT <= aspect <= 32.0:
        raise lens.bad("aspectRatio", f"between 1/{HEIGHT} and 32")
    return {"vfov": float(vfov), "width": round(HEIGHT * aspect)}


def _orthographic(lens: Fields) -> dict[str, Any]:
    """The arguments of an orthographic `Camera`. Clipping planes are ignored, as for perspective cameras."""
    across, above = abs(lens.number("xmag")), abs(lens.number("ymag"))  # half the width and half the height
    if not 0.0 < above < np.inf:
        raise lens.bad("ymag", "a number other than 0")
    if not 1.0 / HEIGHT <= across / above <= 32.0:
        raise lens.bad("xmag", f"between 1/{HEIGHT} and 32 times ymag")
    return {"projection": "orthographic", "extent": 2.0 * above, "width": round(HEIGHT * across / above)}
