"""Irradiance on white surfaces by Mitsuba 3: the integrator `direct`, in a scene with one of our lights."""

from functools import cache

import numpy as np

import antumbra as at
from antumbra.base.errors import InputError

VARIANT = "scalar_rgb"  # it needs no LLVM
_FAR = 1e6  # distance of suns; receivers lie within a few units of zero
_AT_ONCE = 1 << 10  # points
_NEAR = 1e-3  # rays start this far above the points that they see


@cache
def library():
    """The mitsuba module. Raises InputError if it is not installed."""
    try:
        import mitsuba
    except ImportError as error:
        raise InputError(f"Mitsuba cannot be imported ({error}): pip install 'antumbra[all-peers]'") from None
    mitsuba.set_variant(VARIANT)
    return mitsuba


def _columns(x, y, z, origin):
    """A transform whose matrix has these columns."""
    mitsuba = library()
    matrix = np.eye(4)
    matrix[:3] = np.stack([x, y, z, origin], 1)
    return mitsuba.ScalarTransform4f(matrix)


def _area(shape: dict, radiance: float) -> dict:
    rgb = {"type": "rgb", "value": [radiance] * 3}
    return {**shape, "emitter": {"type": "area", "radiance": rgb}}


def _disk(centre, axis, radius: float, radiance: float) -> dict:
    """A disk that shines towards zero. Mitsuba's shapes shine to one side."""
    axis = -axis if axis @ centre > 0.0 else axis
    u = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    u /= np.linalg.norm(u)
    place = _columns(radius * u, radius * np.cross(axis, u), axis, centre)
    return _area({"type": "disk", "to_world": place}, radiance)


def emitter(light: at.Light) -> dict:
    """The light in Mitsuba's units, for receivers around zero."""
    mitsuba = library()
    if isinstance(light, at.PointLight):
        rgb = {"type": "rgb", "value": [light.intensity] * 3}
        return {"type": "point", "position": light.position.tolist(), "intensity": rgb}
    if isinstance(light, at.QuadLight):
        centre, u, v = light.corner + (light.u + light.v) / 2, light.u / 2, light.v / 2
        if np.cross(u, v) @ centre > 0.0:
            u, v = v, u
        normal = np.cross(u, v) / np.linalg.norm(np.cross(u, v))
        return _area({"type": "rectangle", "to_world": _columns(u, v, normal, centre)}, light.intensity / light.area())
    if isinstance(light, at.DiskLight):
        return _disk(light.center, light.normal, light.radius, light.intensity / light.area())
    if isinstance(light, at.SphereLight):
        shape = {"type": "sphere", "center": light.center.tolist(), "radius": light.radius}
        return _area(shape, light.intensity / (np.pi * light.radius**2))
    if isinstance(light, at.DirectionalLight):
        half = np.radians(light.angular_diameter) / 2
        radiance = light.intensity / (np.pi * np.sin(half) ** 2)
        return _disk(-light.direction * _FAR, light.direction, _FAR * np.tan(half), radiance)
    if isinstance(light, at.Sky):
        image = np.roll(light.map, light.map.shape[1] // 2, 1) * light.intensity
        if image.shape[1] == 1:
            image = np.repeat(image, 4, 1)
        return {"type": "envmap", "bitmap": mitsuba.Bitmap(np.ascontiguousarray(image, np.float32))}
    raise InputError(f"{type(light).__name__} has no counterpart here")


def irradiance(vertices, light: at.Light, points, normals, spp: int, seed: int = 0) -> np.ndarray:
    """(n, 3) float64: irradiance at points (n, 3) of surfaces with these unit normals.

    vertices : (m, 3, 3), triangles; points lie on them
    """
    mitsuba = library()
    mesh = mitsuba.Mesh("triangles", 3 * len(vertices), len(vertices), has_vertex_normals=False)
    parameters = mitsuba.traverse(mesh)
    parameters["vertex_positions"] = np.ascontiguousarray(vertices, np.float32).ravel()
    parameters["faces"] = np.arange(3 * len(vertices), dtype=np.uint32)
    parameters.update()
    white = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 1.0}}}
    mesh.set_bsdf(mitsuba.load_dict(white))
    scene = mitsuba.load_dict(
        {"type": "scene", "triangles": mesh, "light": emitter(light), "integrator": {"type": "direct"}}
    )
    batches = []
    for first in range(0, len(points), _AT_ONCE):
        some = slice(first, first + _AT_ONCE)
        sensor = mitsuba.load_dict(_meters(points[some], normals[some]))
        batches.append(np.array(mitsuba.render(scene, sensor=sensor, spp=spp, seed=seed + first), np.float64)[0])
    return np.pi * np.concatenate(batches)


def _meters(points, normals) -> dict:
    """A sensor whose pixels each see one point, from just above it."""
    meters = {}
    for k, (p, n) in enumerate(zip(points, normals)):
        ray = {"origin": (p + _NEAR * n).tolist(), "direction": (-n).tolist()}
        meters[f"meter{k:06d}"] = {"type": "radiancemeter", **ray, "film": _film(1)}
    return {"type": "batch", "film": _film(len(points)), "sampler": {"type": "multijitter"}, **meters}


def _film(width: int) -> dict:
    pixels = {"pixel_format": "rgb", "component_format": "float32", "rfilter": {"type": "box"}}
    return {"type": "hdrfilm", "width": width, "height": 1, **pixels}
