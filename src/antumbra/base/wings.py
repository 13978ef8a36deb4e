"""What the wings, `city`, `lab` and `web`, add to the core: named here, and imported when it is first used.

The core imports no wing, also not inside functions. Its registries read these places instead, so that without a wing
they would just be shorter. Commands are named in the table of commands, and public names in that of the package.
"""

from collections.abc import Callable
from importlib import import_module
from typing import Any

FORMATS = ("antumbra.city.city_formats:FORMATS",)
"""Lists of `formats.scene_format.Format`, in display order."""

FILES_IN_TEXTS = ("antumbra.city.sensors.sensor_files:raster_file",)
"""Functions of an argument's text that return the path of a file in it, or None."""

SENSOR_BLOCKS = "antumbra.city.sensors.sensor_files:sensor_blocks"
"""The function that describes the sensors that a text names."""

OPEN_RASTER = "antumbra.city.gis.large_terrain:open_raster"
"""The function that opens a raster for shadows at its own cells, whatever its size."""

VEGETATION_FILE = "antumbra.city.vegetation.vegetation_table:checked_vegetation_file"
"""The function that checks the path of a file of plants."""

CHECK_MAP = "antumbra.city.sheets.page:check_map"
"""The function that checks the path of a map."""

PARSE_SHEET = "antumbra.city.sheets.sheet_options:parse_sheet"
"""The function that makes the options of a map sheet from texts."""

RULES = "antumbra.city.sun.daylight_rules:RULES"
"""The daylight rules, by name."""

PAGE = "antumbra.web.scene_page:make_page"
"""The function that makes the page of a scene."""

CHECK_PAGE = "antumbra.web.page_export:check_scene"
"""The function that checks that a page can show a scene."""

BAKED_PAGE = "antumbra.web.baked_page:baked_page"
"""The function that makes the page of a bake."""

SWEEP_SAH, TL_LBVH = "antumbra.lab.builders.sweep_sah:build", "antumbra.lab.builders.tl_lbvh:build"
"""Builders."""

BENCH = "antumbra.lab.bench_command:app"
"""The commands of ``antumbra bench``."""


def later(place: str) -> Callable[..., Any]:
    """A function that a place names, which is imported when it is called."""
    return lambda *arguments, **keywords: named(place)(*arguments, **keywords)


def named(place: str) -> Any:
    """What a place, such as "antumbra.city.city_formats:FORMATS", names."""
    module, _, name = place.partition(":")
    return getattr(import_module(module), name)
