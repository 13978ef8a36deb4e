"""The glTF node hierarchy: transforms, keyframe animation, and the cameras and lights placed by nodes."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ...errors import InputError
from ...scene.camera import Camera
from ...scene.lights import DirectionalLight, Light, PointLight
from ..json_fields import Fields
from .accessors import Accessors

# --- The node hierarchy: local transforms, and world matrices for all nodes at once -----------------------------------


SINGULAR = 1e-12
"""A matrix with unit columns and a smaller determinant counts as singular."""


class Nodes(NamedTuple):
    """All nodes of a file, in the pose at rest."""

    fields: list[Fields]
    translation: np.ndarray  # (n, 3) float64
    rotation: np.ndarray  # (n, 4) float64, quaternion x y z w, unit
    scale: np.ndarray  # (n, 3) float64
    matrix: np.ndarray  # (n, 4, 4) float64, used instead of the three above where `fixed`
    fixed: np.ndarray  # (n,) bool
    parent: np.ndarray  # (n,) int64, -1 for a root
    levels: list[np.ndarray]  # node indices by depth, roots first
    visible: np.ndarray  # (n,) bool, whether the default scene reaches the node


def read_nodes(root: Fields) -> Nodes:
    """The nodes of a file, with the nodes of its default scene marked visible."""
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
    visible = _reached(root, fields, children, parent)
    return Nodes(fields, translation, rotation / length[:, None], scale, matrix, fixed, parent, levels, visible)


def local_matrices(translation, rotation, scale) -> np.ndarray:
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


def posed_matrices(nodes: Nodes, translation, rotation, scale) -> np.ndarray:
    """(n, 4, 4) float64: local matrices of all nodes, from these values or from a node's own matrix."""
    local = local_matrices(translation, rotation, scale)
    local[nodes.fixed] = nodes.matrix[nodes.fixed]
    return local


def world_matrices(nodes: Nodes, local: np.ndarray) -> np.ndarray:
    """(n, 4, 4) float64: each node's transform to world space, computed level by level from the roots."""
    world = local.copy()
    for level in nodes.levels[1:]:
        world[level] = world[nodes.parent[level]] @ local[level]
    return world


def transform_points(points: np.ndarray, matrices: np.ndarray) -> np.ndarray:
    """`points` ((v, 3)) under each of `matrices` ((k, 4, 4) float64): (k, v, 3) float64.

    The order of operations is fixed. The rounding of a matrix product would depend on the machine's BLAS.
    """
    x, y, z = (points[:, i].astype(np.float64) for i in range(3))
    out = np.empty((len(matrices), len(points), 3))
    for i in range(3):
        a, b, c, d = (matrices[:, i, j, None] for j in range(4))
        out[..., i] = a * x + b * y + c * z + d
    return out


def with_ancestors(nodes: Nodes, what: np.ndarray) -> np.ndarray:
    """(n,) bool: nodes in `what` ((n,) bool) and all their ancestors."""
    carry = what.copy()
    for level in reversed(nodes.levels[1:]):
        np.logical_or.at(carry, nodes.parent[level], carry[level])
    return carry


def singular(matrices: np.ndarray) -> np.ndarray:
    """(n,) bool: which of (n, 4, 4) transforms have no inverse. Their scale does not matter."""
    linear = matrices[:, :3, :3]
    lengths = np.linalg.norm(linear, axis=1)
    with np.errstate(all="ignore"):
        return ~(np.abs(np.linalg.det(linear / lengths[:, None, :])) > SINGULAR)


def check_invertible(nodes: Nodes, needed: np.ndarray) -> None:
    """Raise InputError with the first node of `needed` ((n,) bool) whose transform at rest has no inverse."""
    local = posed_matrices(nodes, nodes.translation, nodes.rotation, nodes.scale)
    bad = np.flatnonzero(needed & singular(local))
    if len(bad):
        where = nodes.fields[int(bad[0])].where
        raise InputError(f"{where} has a transform without inverse; give it a scale or matrix that is not flat")


def _matrix(fields: Fields) -> np.ndarray:
    values = fields.numbers("matrix", 16, None)
    if values is None:
        return np.eye(4)
    matrix = values.reshape(4, 4).T  # glTF stores columns
    if not np.allclose(matrix[3], (0.0, 0.0, 0.0, 1.0), atol=1e-6):
        raise fields.bad("matrix", "affine: every fourth number 0, the last 1")
    matrix[3] = 0.0, 0.0, 0.0, 1.0
    return matrix


def _parents(fields: list[Fields], children: list[list[int]]) -> np.ndarray:
    parent = np.full(len(fields), -1, np.int64)
    for i, below in enumerate(children):
        for child in below:
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


def _reached(root: Fields, fields: list[Fields], children: list[list[int]], parent: np.ndarray) -> np.ndarray:
    scenes = root.objects("scenes")
    if scenes:
        roots = scenes[root.whole("scene", 0, high=len(scenes))].indices("nodes", len(fields))
    else:
        roots = np.flatnonzero(parent < 0).tolist()
    reached = np.zeros(len(fields), bool)
    while roots:
        node = roots.pop()
        if not reached[node]:
            reached[node] = True
            roots.extend(children[node])
    return reached


# --- Keyframes: the value of an animation channel at a time -----------------------------------------------------------


WIDTH = {"translation": 3, "rotation": 4, "scale": 3}
STEP, LINEAR, CUBICSPLINE = "STEP", "LINEAR", "CUBICSPLINE"


class Track(NamedTuple):
    """One animated property of one node."""

    node: int
    path: str  # "translation", "rotation", "scale" or "weights"
    interpolation: str
    times: np.ndarray  # (k,) float64, seconds, never decreasing
    values: np.ndarray  # (k, c) float64; CUBICSPLINE: (k, 3, c) of in-tangent, value, out-tangent


def read_tracks(
    root: Fields, accessors: Accessors, nodes: Nodes, n_weights: list[int]
) -> tuple[list[Track], list[str]]:
    """The (tracks, notes) of all animations.

    Animations play together. Several may drive the same property of a node, as the clips of one character do. Then
    the first in the file counts and the others are left out, as in viewers that play the first clip.
    """
    tracks: dict[tuple[int, str], Track] = {}
    left_out: list[str] = []
    for number, animation in enumerate(root.objects("animations")):
        samplers, clash = animation.objects("samplers"), False
        for channel in animation.objects("channels"):
            track = _track(channel, samplers, accessors, nodes, n_weights)
            if track is not None:
                clash |= tracks.setdefault((track.node, track.path), track) is not track
        if clash:
            left_out.append(animation.text("name", None) or str(number))
    notes = []
    if left_out:
        shown = ", ".join(name[:40] for name in left_out[:8]) + (", ..." if len(left_out) > 8 else "")
        notes.append(f"{root.where} these animations move what an earlier one moves, which counts: {shown}")
    return list(tracks.values()), notes


def sample_track(track: Track, time: float) -> np.ndarray:
    """The value ((c,) float64) of a track at `time`. Outside the keys, it is the nearest key's value."""
    times, values = track.times, track.values
    keys = values[:, 1] if track.interpolation == CUBICSPLINE else values
    k = int(np.searchsorted(times, time, side="right")) - 1
    if k < 0:
        return keys[0]
    if k >= len(times) - 1 or track.interpolation == STEP:
        return keys[k]
    step = times[k + 1] - times[k]
    t = (time - times[k]) / step
    if track.interpolation == CUBICSPLINE:
        return _hermite(values[k], values[k + 1], t, step, track.path == "rotation")
    if track.path == "rotation":
        return _slerp(keys[k], keys[k + 1], t)
    return (1.0 - t) * keys[k] + t * keys[k + 1]


def _slerp(a: np.ndarray, b: np.ndarray, t: float) -> np.ndarray:
    """Spherical linear interpolation of unit quaternions, by the shorter arc."""
    cosine = float(a @ b)
    sign = -1.0 if cosine < 0.0 else 1.0
    angle = np.arccos(min(abs(cosine), 1.0))
    if angle < 1e-6:
        q = (1.0 - t) * a + sign * t * b
    else:
        q = (np.sin((1.0 - t) * angle) * a + sign * np.sin(t * angle) * b) / np.sin(angle)
    return q / np.linalg.norm(q)


def _hermite(before: np.ndarray, after: np.ndarray, t: float, step: float, rotation: bool) -> np.ndarray:
    """A cubic Hermite spline. Tangents are per second, so they scale with the key interval."""
    t2, t3 = t * t, t * t * t
    value = (
        (2 * t3 - 3 * t2 + 1) * before[1]
        + step * (t3 - 2 * t2 + t) * before[2]
        + (3 * t2 - 2 * t3) * after[1]
        + step * (t3 - t2) * after[0]
    )
    if not rotation:
        return value
    length = np.linalg.norm(value)
    return value / length if length > 1e-12 else before[1]


def _track(channel, samplers, accessors: Accessors, nodes: Nodes, n_weights: list[int]) -> Track | None:
    target = channel.object("target")
    path = None if target is None else target.text("path", None)
    if path not in (*WIDTH, "weights") or "node" not in target:
        return None  # a target that an extension defines
    node = target.whole("node", high=len(nodes.fields))
    if path != "weights" and nodes.fixed[node]:
        moved = nodes.fields[node].where
        raise InputError(f"{channel.where} moves {moved}, which has a matrix; export it with TRS instead")
    sampler = samplers[channel.whole("sampler", high=len(samplers))]
    interpolation = sampler.text("interpolation", LINEAR)
    if interpolation not in (STEP, LINEAR, CUBICSPLINE):
        raise sampler.bad("interpolation", "STEP, LINEAR or CUBICSPLINE")
    times = accessors.finite(sampler.whole("input", high=len(accessors)), "SCALAR")[:, 0]
    if len(times) == 0:
        return None
    if (np.diff(times) < 0.0).any():
        raise InputError(f"{sampler.where}: times of the keys go backwards; export the animation again")
    width = n_weights[node] if path == "weights" else WIDTH[path]
    if width == 0:
        return None  # weights of a mesh without morph targets
    kind = "SCALAR" if path == "weights" else f"VEC{width}"
    output = accessors.finite(sampler.whole("output", high=len(accessors)), kind)
    shape = (len(times), 3, width) if interpolation == CUBICSPLINE else (len(times), width)
    if output.size != np.prod(shape):
        raise InputError(
            f"{sampler.where} has {output.size} numbers for {len(times)} keys; {np.prod(shape)} are needed"
        )
    values = output.reshape(shape)
    if path == "rotation":
        values = _unit_keys(values, sampler)
    return Track(node, path, interpolation, times, values)


def _unit_keys(values: np.ndarray, sampler: Fields) -> np.ndarray:
    """Rotation keys, normalised. The tangents of a spline are not changed."""
    values = values.copy()
    keys = values[:, 1] if values.ndim == 3 else values
    lengths = np.linalg.norm(keys, axis=1, keepdims=True)
    if not (lengths > 0.0).all():
        raise InputError(f"{sampler.where} has a rotation key that is zero; quaternions must be of unit length")
    keys /= lengths
    return values


# --- Cameras and KHR_lights_punctual lights, placed by nodes ----------------------------------------------------------


HEIGHT = 1024  # pixels of a camera's picture; glTF gives only the aspect ratio
LIGHTS_EXTENSION = "KHR_lights_punctual"


class GltfViews:
    """The cameras and the lights of a file's scene, in the order of their nodes."""

    def __init__(self, root: Fields, nodes: Nodes):
        self.notes: list[str] = []
        self._nodes = nodes
        self._cameras = self._placed_cameras(root)
        self._lights = self._placed_lights(root)

    def holders(self) -> list[int]:
        """Nodes that hold a camera or light."""
        return [node for node, _ in self._cameras] + [node for node, *_ in self._lights]

    def cameras(self, world: np.ndarray) -> list[Camera]:
        """The cameras, which look along -Z of their nodes; `world` has the nodes' world matrices."""
        cameras = []
        for node, lens in self._cameras:
            position, up, backward = (
                world[node][:3, 3],
                self._axis(world, node, 1),
                self._axis(world, node, 2),
            )
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

    def _axis(self, world: np.ndarray, node: int, column: int) -> np.ndarray:
        axis = world[node][:3, column]
        length = np.linalg.norm(axis)
        if not 0.0 < length < np.inf:
            raise InputError(f"{self._nodes.fields[node].where} holds a camera or light but its transform is flat")
        return axis / length

    def _placed_cameras(self, root: Fields) -> list[tuple[int, dict]]:
        cameras, placed = root.objects("cameras"), []
        for node in np.flatnonzero(self._nodes.visible).tolist():
            index = self._nodes.fields[node].whole("camera", None, high=len(cameras))
            if index is None:
                continue
            perspective, flat = cameras[index].object("perspective"), cameras[index].object("orthographic")
            if perspective is not None:
                placed.append((node, _perspective(perspective)))
            elif flat is not None:
                placed.append((node, _orthographic(flat)))
            else:
                self.notes.append(f"{cameras[index].where} is neither perspective nor orthographic; left out")
        return placed

    def _placed_lights(self, root: Fields) -> list[tuple[int, str, float, tuple, str]]:
        extension = root.extension(LIGHTS_EXTENSION)
        lights, placed = [] if extension is None else extension.objects("lights"), []
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
            placed.append((node, kind, intensity, colour, name))
        return placed


def _perspective(lens: Fields) -> dict:
    """The arguments of a perspective `Camera`."""
    vfov, aspect = np.degrees(lens.number("yfov")), lens.number("aspectRatio", 1.0)
    if not 0.0 < vfov < 180.0:
        raise lens.bad("yfov", "an angle between 0 and pi radians")
    if not 1.0 / HEIGHT <= aspect <= 32.0:
        raise lens.bad("aspectRatio", f"between 1/{HEIGHT} and 32")
    return {"vfov": float(vfov), "width": round(HEIGHT * aspect)}


def _orthographic(lens: Fields) -> dict:
    """The arguments of an orthographic `Camera`. Like those of perspective cameras, its clipping planes are ignored."""
    across, above = abs(lens.number("xmag")), abs(lens.number("ymag"))  # half the width and half the height
    if not 0.0 < above < np.inf:
        raise lens.bad("ymag", "a number other than 0")
    if not 1.0 / HEIGHT <= across / above <= 32.0:
        raise lens.bad("xmag", f"between 1/{HEIGHT} and 32 times ymag")
    return {"projection": "orthographic", "extent": 2.0 * above, "width": round(HEIGHT * across / above)}
