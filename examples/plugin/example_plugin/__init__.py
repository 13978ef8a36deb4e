"""A plugin for Antumbra: the builder `median`, the tracer `every-triangle` and the light `Window`."""

from antumbra.cli.arguments import LightForm, register_light
from antumbra.engine.method_registry import Builder, register

from .every_triangle import EveryTriangle
from .median import build
from .window import Window, parse

__all__ = ["Window", "add"]


def add() -> None:
    """Register the methods and the light: the entry point that pyproject.toml names."""
    register("build", "median", Builder(build, "halves the triangles along the longest axis", ""))
    register("trace", "every-triangle", EveryTriangle())
    register_light("window", LightForm("window:CX,CY,CZ:FACING:WIDTH:HEIGHT", parse))
