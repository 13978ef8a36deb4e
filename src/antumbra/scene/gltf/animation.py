"""Keyframes: the value of an animation channel at a time."""

from typing import NamedTuple

import numpy as np

from ...errors import InputError
from .accessors import Accessors
from .fields import Fields
from .nodes import Nodes

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


def sample(track: Track, time: float) -> np.ndarray:
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
