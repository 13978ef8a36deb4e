"""All commands of ``antumbra``: where each is defined, and its line in the help. A new command is a line here.

The modules are named, not imported: that of a command is loaded when the command runs or explains itself.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

from .wings import named


class Command(NamedTuple):
    """Where a command is defined. The function has the command's name, with _ for -."""

    module: str
    group: str  # its group in the list of commands
    help: str  # its line in the list of commands: the first line of its own help
    kernels: str = ""  # module:name of the example calls of a study's own kernels, if it has some

    def function(self, name: str) -> Callable[..., Any]:
        """The command's function, whose module is imported."""
        function: Callable[..., Any] = named(f"{self.module}:{name.replace('-', '_')}")
        return function


COMMANDS = {
    "render": Command("antumbra.cli.render_command", "Pictures", "Render SCENE with exact shadows."),
    "view": Command("antumbra.cli.view_command", "Pictures", "Show SCENE in the browser."),
    "page": Command("antumbra.web.page_command", "Pictures", "Write SCENE as one HTML file that works offline."),
    "bake": Command(
        "antumbra.cli.bake_command",
        "Pictures",
        "Bake occlusion, shadows or light into a glTF file.",
        kernels="antumbra.baking.surface_meter:EXAMPLES",
    ),
    "dataset": Command("antumbra.cli.dataset_command", "Pictures", "Render images with visibility, occluders and ids."),
    "sun": Command(
        "antumbra.city.sun.sun_command",
        "Sun and shadow",
        "Compute sun hours on surfaces.",
        kernels="antumbra.city.sun.sun_tally:EXAMPLES",
    ),
    "shadow": Command(
        "antumbra.city.shadow.shadow_command", "Sun and shadow", "Draw the shadow on the ground, as GIS polygons."
    ),
    "calendar": Command(
        "antumbra.city.sun.calendar_command", "Sun and shadow", "Find the first and last sun of each day."
    ),
    "route": Command("antumbra.city.sun.route_command", "Sun and shadow", "Compute the hourly shade along a route."),
    "pv": Command("antumbra.city.pv.pv_command", "Sun and shadow", "Compute the shading of solar modules."),
    "skyline": Command(
        "antumbra.city.skyline.skyline_command",
        "Sun and shadow",
        "Compute the horizon elevation at every azimuth.",
        kernels="antumbra.city.skyline.skyline:EXAMPLES",
    ),
    "viewshed": Command(
        "antumbra.city.sight.viewshed_command",
        "Sight",
        "Count the observers that see each place.",
        kernels="antumbra.city.sight.least_heights:EXAMPLES",
    ),
    "visible": Command(
        "antumbra.city.sight.visible_command",
        "Sight",
        "Compute how much of a target each place sees.",
    ),
    "los": Command("antumbra.city.sight.los_command", "Sight", "Find which points see each other."),
    "matrix": Command(
        "antumbra.city.sight.matrix_command",
        "Sight",
        "Find which sensors see which targets, as a matrix.",
        kernels="antumbra.city.sight.visibility_matrix:EXAMPLES",
    ),
    "view-factors": Command(
        "antumbra.city.view_factors.view_factors_command",
        "Sight",
        "Compute view factors between surfaces and the sky.",
    ),
    "info": Command("antumbra.cli.scene_commands", "Scenes", "Show the contents of SCENE."),
    "scenes": Command("antumbra.cli.scene_commands", "Scenes", "List the built-in scenes, or export one."),
    "formats": Command("antumbra.cli.scene_commands", "Scenes", "List the file formats, and the options of SCENE."),
    "build": Command("antumbra.cli.build_command", "Scenes", "Build a store for scenes larger than memory."),
    "doctor": Command("antumbra.cli.installation_commands", "Installation and machines", "Check this installation."),
    "warmup": Command(
        "antumbra.cli.installation_commands", "Installation and machines", "Compile all kernels ahead of time."
    ),
    "merge": Command("antumbra.cli.shards", "Installation and machines", "Join the shards of a command."),
    "plans": Command("antumbra.cli.installation_commands", "Research", "List the methods, and how they form plans."),
    "compare": Command("antumbra.lab.compare_command", "Research", "Measure plans side by side on one picture."),
    "explain": Command("antumbra.lab.explain_commands", "Research", "Show where plans spend their traversal steps."),
    "culling": Command("antumbra.lab.explain_commands", "Research", "Show which triangles survive pre-BVH culling."),
}
"""Name -> command, in the order of the help."""
