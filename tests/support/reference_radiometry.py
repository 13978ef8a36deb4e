"""Irradiance by sums over a light, in numpy. Nothing is imported from the package but its lights' fields.

A sphere is seen by its directions, not by the disk that the package samples, and a sun by its solid angle.
"""

import numpy as np

N = 700


def unit(v):
    v = np.asarray(v, float)
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def _basis(axis):
    u = unit(np.cross(axis, np.eye(3)[np.abs(axis).argmin()]))
    return u, np.cross(axis, u)


def _square(n):
    middle = (np.arange(n) + 0.5) / n
    return (each.ravel() for each in np.meshgrid(middle, middle, indexing="ij"))


def _cone(axis, sine2, n):
    """Unit directions that fill a cone evenly, and its solid angle; sine2: of its half-angle, squared."""
    a, b = _square(n)
    height = sine2 / (1.0 + np.sqrt(1.0 - sine2))  # 1 - cosine
    cosine = 1.0 - a * height
    sine = np.sqrt(1.0 - cosine**2)
    u, v = _basis(axis)
    turn = 2 * np.pi * b
    ways = cosine[:, None] * axis + sine[:, None] * (np.cos(turn)[:, None] * u + np.sin(turn)[:, None] * v)
    return ways, 2 * np.pi * height


def _on_surface(light, n):
    """Points of a flat light, and its unit normal."""
    a, b = _square(n)
    if hasattr(light, "corner"):
        return light.corner + a[:, None] * light.u + b[:, None] * light.v, unit(np.cross(light.u, light.v))
    u, v = _basis(light.normal)
    r, turn = light.radius * np.sqrt(a), 2 * np.pi * b
    return light.center + (r * np.cos(turn))[:, None] * u + (r * np.sin(turn))[:, None] * v, light.normal


def irradiance(light, point, normal, seen=None, n=N) -> float:
    """Irradiance at a point outside of the light, for intensity 1.

    seen : function of (k, 3) points towards which the point looks; whether it sees them. None: all of them
    """
    point, normal = np.asarray(point, float), unit(normal)
    if seen is None:
        seen = lambda ends: np.ones(len(ends), bool)
    if hasattr(light, "position"):
        way = light.position - point
        return seen(light.position[None])[0] * max(way @ normal, 0.0) / np.linalg.norm(way) ** 3
    if hasattr(light, "angular_diameter"):
        sine2 = np.sin(np.radians(light.angular_diameter) / 2) ** 2
        if sine2 == 0.0:
            return max(-light.direction @ normal, 0.0) * (
                seen is None or bool(seen(point - 1e6 * light.direction[None])[0])
            )
        ways, angle = _cone(-light.direction, sine2, n)
        ends, radiance = point + 1e6 * ways, 1.0 / (np.pi * sine2)
    elif hasattr(light, "normal") or hasattr(light, "corner"):
        ends, axis = _on_surface(light, n)
        ways = ends - point
        r2 = (ways**2).sum(-1)
        weights = np.maximum(ways @ normal, 0.0) * np.abs(ways @ axis) / r2**2
        return float((weights * seen(ends)).mean())  # radiance times area is 1
    else:
        away = light.center - point
        distance = np.linalg.norm(away)
        sine2 = (light.radius / distance) ** 2
        ways, angle = _cone(away / distance, sine2, n)
        along = ways @ away
        near = along - np.sqrt(np.maximum(light.radius**2 - (away @ away - along**2), 0.0))
        ends, radiance = point + near[:, None] * ways, 1.0 / (np.pi * light.radius**2)
    cosines = np.maximum(ways @ normal, 0.0)
    return float(radiance * angle * (cosines * seen(ends)).mean())
