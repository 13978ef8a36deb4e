"""Virtual point lights: instant radiosity, with point lights where a light's photons hit surfaces [Keller 1997]."""

import numpy as np
from numpy.typing import NDArray

from ..base.checks import flag, whole_number
from ..base.errors import InputError
from ..base.wording import counted
from ..engine.scene_loading import SceneLike, scene_of
from ..kernels.elementary import cos, sin
from ..kernels.small_matrices import length
from ..query.nearest_points import PointTree
from ..query.receivers import surface_receivers
from ..query.sobol_sequence import scrambled_sobol
from ..scene.light_lists import PointLights
from ..scene.lights import (
    DirectionalLight,
    DiskLight,
    Light,
    PointLight,
    QuadLight,
    SphereLight,
    check_lights,
    tangents,
)
from ..scene.sky import Sky
from ..scene.triangles import Triangles


def virtual_point_lights(
    scene: SceneLike,
    light: Light,
    n: int = 256,
    seed: int = 0,
    time: float = 0.0,
    *,
    interleave: bool = True,
    threads: int | None = None,
) -> PointLights:
    """Approximate light that has bounced once by point lights: instant radiosity [Keller 1997].

    The light emits n photons, distributed by a Sobol sequence. Area lights emit with cosine density, spheres over their
    whole surface, and distant lights through a disk that covers the scene. A sky emits like its distant lights. Just
    off each surface point that a photon hits, there is a point light with the photon's power times the surface colour
    and a cosine falloff around the normal. All photons carry the same power; photons that leave the scene are lost.

    The sum over the lights is an unbiased estimate of the irradiance after one bounce, except that the factor
    1 / distance^2 is clamped (``PointLights.nearest``) at the radius of the disk that one light typically represents.
    Otherwise the lights would show as bright spots on receivers nearby. Corners are therefore slightly too dark.

    Parameters
    ----------
    scene : Scene, PagedScene, or anything that `antumbra.load` takes
    light : Light
        Any light except ambient occlusion, `PointLights` and `DirectionalLights`.
    n : int
        Number of photons, 1 to 16384 (1 to 1024 without `interleave`).
    seed : int
        Seed of the scrambling; the same seed gives the same lights.
    time : float
        Seconds, clamped to [0, scene.duration].
    interleave : bool
        Whether each pixel tests only a sixteenth of the lights, see `PointLights`.
    threads : int or None
        None: all cores.

    Returns
    -------
    PointLights
        At most n lights, with ``indirect=True``.

    Raises
    ------
    InputError
        If the light is of an unsupported kind, n is out of range, or no photon meets the scene.

    Examples
    --------
    >>> room = at.procedural("atrium", triangles=5_000)
    >>> bounced = at.virtual_point_lights(room, at.SphereLight((0, 4, 0), 0.5, intensity=100), n=64)
    >>> bounced.samples(16)  # each pixel tests every 16th light
    4
    """
    scene = scene_of(scene)
    (light,) = check_lights([light], scene.up)
    n = whole_number(n, "n", 1, 16384 if flag(interleave, "interleave") else 1024)
    seed = whole_number(seed, "seed", 0, 2**63 - 1)
    centre, radius = scene.bounds.mean(0), length(np.ptp(scene.bounds, axis=0)) / 2.0
    xi = scrambled_sobol(n, 4, seed)
    origins, directions, power = emit_photons(light, xi, centre, radius)
    hit = scene.closest_hit(origins, directions, time=time, threads=threads)
    mask = hit.mask
    if not mask.any():
        what = f"none of the {counted(n, 'photon')} of the {type(light).__name__} hits {scene.name}"
        raise InputError(f"{what}; move the light nearer, or take more")
    triangles, face = hit.surfaces()
    face, points = face[mask], origins[mask] + hit.t[mask, None] * directions[mask]
    positions, normals = _offset_from_surface(points, directions[mask], face, triangles, threads)
    return PointLights(
        positions,
        np.asarray(power / n / np.pi),  # Eq. (4) of docs/design/lights.md: intensity along the normal
        triangles.colour[face] * _photon_colours(light, xi)[mask],
        normals,
        interleave=interleave,
        indirect=True,
        nearest=_typical_radius(positions),
    )


def emit_photons(
    light: Light, xi: NDArray[np.float64], centre: NDArray[np.float64], radius: float | np.floating
) -> tuple[NDArray[np.float64], NDArray[np.float64], float | np.floating]:
    """World-space origins (n, 3) and unit directions (n, 3) of the photons, and their total power.

    The power follows from the unit of `intensity` in shading: for flat lights candela along the axis, with cosine
    falloff on both sides; for points and spheres candela in every direction; for distant lights lux.
    """
    a, b = xi[:, 0], xi[:, 1]
    if isinstance(light, PointLight):
        return np.broadcast_to(light.position, (len(xi), 3)), _square_to_sphere(a, b), 4.0 * np.pi * light.intensity
    if isinstance(light, SphereLight):
        normal = _square_to_sphere(a, b)
        return (
            light.center + light.radius * normal,
            _cosine_directions(normal, xi[:, 2:]),
            4.0 * np.pi * light.intensity,
        )
    if isinstance(light, Sky):
        directions = -light.points[_chosen_lights(light, xi)]
        power = np.pi * radius**2 * float(light.intensities.sum()) * light.intensity
        return _photon_origins(directions, a, b, centre, radius), directions, power
    if isinstance(light, DirectionalLight):
        directions, share = _cone_directions(light, xi[:, 2:])
        return (
            _photon_origins(directions, a, b, centre, radius),
            directions,
            np.pi * radius**2 * light.intensity * share,
        )
    if isinstance(light, QuadLight):
        origins = light.corner + a[:, None] * light.u + b[:, None] * light.v
        axis = np.cross(light.u, light.v) / light.area()
    elif isinstance(light, DiskLight):
        u, v = tangents(light.normal)
        x, y = (_square_to_disk(a, b) * light.radius).T[..., None]
        origins, axis = light.center + x * u + y * v, light.normal
    else:
        raise InputError(
            f"{type(light).__name__} emits no photons; use a point, quad, disk, sphere or distant light, or a sky"
        )
    side = np.where(xi[:, 2] < 0.5, 1.0, -1.0)[:, None]
    xi = np.stack([2.0 * xi[:, 2] % 1.0, xi[:, 3]], 1)
    return origins, _cosine_directions(side * axis, xi), 2.0 * np.pi * light.intensity


def _photon_origins(
    directions: NDArray[np.float64],
    a: NDArray[np.float64],
    b: NDArray[np.float64],
    centre: NDArray[np.float64],
    radius: float | np.floating,
) -> NDArray[np.float64]:
    """(n, 3): origins of photons with unit directions (n, 3), on disks that cover the scene."""
    u, v = (np.stack(axes) for axes in zip(*map(tangents, directions)))
    x, y = (_square_to_disk(a, b) * radius).T[..., None]
    origins: NDArray[np.float64] = centre + x * u + y * v - 2.0 * radius * directions
    return origins


def _cone_directions(light: DirectionalLight, xi: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """(n, 3) unit directions, uniform over a distant light's solid angle; and lux on the photons' disks over its lux.

    A surface that faces the light gets the cosine-weighted integral of the radiance, and these disks get the
    unweighted one.
    """
    u, v = tangents(light.direction)
    min_cosine = cos(np.radians(light.angular_diameter) / 2.0)
    cosine, angle = 1.0 - xi[:, :1] * (1.0 - min_cosine), 2.0 * np.pi * xi[:, 1:]
    sine = np.sqrt(np.maximum(1.0 - cosine * cosine, 0.0))
    return cosine * light.direction + sine * (cos(angle) * u + sin(angle) * v), 2.0 / (1.0 + min_cosine)


def _chosen_lights(sky: Sky, xi: NDArray[np.float64]) -> NDArray[np.int64]:
    """(n,) int: the light of the sky that emits each photon. All its lights have the same power."""
    lights: NDArray[np.int64] = np.minimum((xi[:, 2] * sky.count).astype(int), sky.count - 1)
    return lights


def _photon_colours(light: Light, xi: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 3): the colour of each photon."""
    photon_colours = light.colours[_chosen_lights(light, xi)] if isinstance(light, Sky) else np.ones((len(xi), 3))
    tinted: NDArray[np.float64] = photon_colours * np.asarray(light.colour)
    return tinted


def _square_to_sphere(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Map the unit square uniformly to the unit sphere."""
    z, angle = 1.0 - 2.0 * a, 2.0 * np.pi * b
    r = np.sqrt(np.maximum(1.0 - z * z, 0.0))
    return np.stack([r * cos(angle), r * sin(angle), z], -1)


def _square_to_disk(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Map the unit square uniformly to the unit disk."""
    r, angle = np.sqrt(a), 2.0 * np.pi * b
    return np.stack([r * cos(angle), r * sin(angle)], -1)


def _cosine_directions(normals: NDArray[np.float64], xi: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 3) unit directions around unit normals with cosine density: points on a sphere tangent to the surface."""
    d = normals + 0.9999999 * _square_to_sphere(xi[:, 0], xi[:, 1])  # slightly less than 1, so never zero
    unit: NDArray[np.float64] = d / np.linalg.norm(d, axis=1, keepdims=True)
    return unit


def _offset_from_surface(
    points: NDArray[np.float64],
    directions: NDArray[np.float64],
    face: NDArray[np.int32],
    triangles: Triangles,
    threads: int | None,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """World-space positions just off the faces hit at `points`, and unit normals towards the photons' side."""
    corners = triangles.vertices[face].astype(np.float64)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    away = (normals * directions).sum(1) > 0.0
    normals *= np.where(away, -1.0, 1.0)[:, None] / np.linalg.norm(normals, axis=1, keepdims=True)
    local, side = (points - triangles.origin).astype(np.float32), np.where(away, -1, 1).astype(np.int8)
    flat = triangles.vertices.reshape(-1, 9)
    receivers = surface_receivers(local, normals.astype(np.float32), face, side, flat, threads)
    return receivers + triangles.origin, normals


def _typical_radius(positions: NDArray[np.float64]) -> float:
    """Radius of the disk that one light typically represents, from the median distance to the nearest other light."""
    if len(positions) < 2:
        return 0.0
    nearest = PointTree(positions).nearest(positions, others=True).distances
    return float(2.0 / np.sqrt(np.pi) * np.median(nearest))  # random points of density p are 1 / (2 sqrt(p)) apart
