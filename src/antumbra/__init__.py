"""Antumbra: which points see which lights, exactly and fast.

>>> import antumbra as at
>>> scene = at.procedural("atrium", triangles=5_000)
>>> frame = at.render(scene, scene.cameras[0].resized(64, 64), scene.lights, spp=16)
>>> frame.visibility[0].shape
(64, 64)
"""

import importlib
import typing

if typing.TYPE_CHECKING:
    from .errors import InputError
    from .frame import Frame
    from .plan import Plan
    from .queries import Visibility, visibility
    from .query.gbuffer import GBuffer
    from .query.rays import Hit
    from .renderer import Renderer, render
    from .scene.camera import Camera
    from .scene.generated import procedural
    from .scene.lights import (
        AmbientOcclusion,
        DirectionalLight,
        DiskLight,
        Light,
        PointLight,
        QuadLight,
        SphereLight,
    )
    from .scene.load import load
    from .scene.point_lights import PointLights
    from .scene.scene import Scene
    from .scene.triangles import Triangles
    from .srdh_rays import SrdhRays
    from .store.build import BuildReport, build_store
    from .store.scene import PagedScene
    from .virtual_lights import virtual_point_lights

__version__ = "0.1.0"

__all__ = [
    "AmbientOcclusion",
    "BuildReport",
    "Camera",
    "DirectionalLight",
    "DiskLight",
    "Frame",
    "GBuffer",
    "Hit",
    "InputError",
    "Light",
    "PagedScene",
    "Plan",
    "PointLight",
    "PointLights",
    "QuadLight",
    "Renderer",
    "Scene",
    "SphereLight",
    "SrdhRays",
    "Triangles",
    "Visibility",
    "build_store",
    "load",
    "procedural",
    "render",
    "virtual_point_lights",
    "visibility",
]

# Names are imported when they are first used: Numba takes longer to import than the command line has for its help.
_HOMES = {
    "errors": ["InputError"],
    "plan": ["Plan"],
    "queries": ["Visibility", "visibility"],
    "query.gbuffer": ["GBuffer"],
    "query.rays": ["Hit"],
    "frame": ["Frame"],
    "renderer": ["Renderer", "render"],
    "scene.camera": ["Camera"],
    "scene.generated": ["procedural"],
    "scene.lights": [
        "AmbientOcclusion",
        "DirectionalLight",
        "DiskLight",
        "Light",
        "PointLight",
        "QuadLight",
        "SphereLight",
    ],
    "scene.load": ["load"],
    "scene.point_lights": ["PointLights"],
    "scene.scene": ["Scene"],
    "scene.triangles": ["Triangles"],
    "srdh_rays": ["SrdhRays"],
    "store.build": ["BuildReport", "build_store"],
    "store.scene": ["PagedScene"],
    "virtual_lights": ["virtual_point_lights"],
}
_HOME = {name: home for home, names in _HOMES.items() for name in names}


if not typing.TYPE_CHECKING:  # to a type checker, a name that is not above is an error

    def __getattr__(name):
        if name not in _HOME:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        value = getattr(importlib.import_module(f"{__name__}.{_HOME[name]}"), name)
        globals()[name] = value
        return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
