"""All commands of ``antumbra``: where each is defined, and its line in the help. A new command is a line here.

The modules are named, not imported: that of a command is loaded when the command runs or explains itself.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

from .wings import named


class Command(NamedTuple):
    """Where a command is defined. The function has the command's name, with _ for -."""

    module: str
    help: str  # its line in the list of commands: the first line of its own help
    grouped: bool = True  # whether its help groups its options if there are many
    kernels: str = ""  # module:name of the example calls of a study's own kernels, if it has some

    def function(self, name: str) -> Callable[..., Any]:
        """The command's function, whose module is imported."""
        function: Callable[..., Any] = named(f"{self.module}:{name.replace('-', '_')}")
        return function


COMMANDS = {
    "render": Command("antumbra.cli.render_command", "Render SCENE with exact shadows."),
    "sun": Command(
        "antumbra.city.sun.sun_command",
        "Find the hours of direct sun on the surfaces of SCENE.",
        kernels="antumbra.city.sun.sun_tally:EXAMPLES",
    ),
    "pv": Command(
        "antumbra.city.pv.pv_command", "Find how much of each photovoltaic module in SCENE is shaded, by time."
    ),
    "route": Command(
        "antumbra.city.sun.route_command",
        "Find how much of each hour the stations along a route through SCENE are in shade.",
    ),
    "calendar": Command(
        "antumbra.city.sun.calendar_command",
        "Find the first and the last sun of each day at points of SCENE, behind its horizon.",
    ),
    "shadow": Command("antumbra.city.shadow.shadow_command", "Find the shadow on the ground of SCENE, as polygons."),
    "view": Command("antumbra.cli.view_command", "Show SCENE in the browser, until Ctrl-C."),
    "page": Command(
        "antumbra.web.page_command",
        "Write SCENE as one HTML file with exact shadows, which any browser opens offline.",
    ),
    "bake": Command(
        "antumbra.cli.bake_command",
        "Bake occlusion, shadows or light of SCENE into a copy of its glTF file.",
        grouped=False,
        kernels="antumbra.baking.surface_meter:EXAMPLES",
    ),
    "los": Command(
        "antumbra.city.sight.los_command",
        "Find which points see each other in SCENE, and what blocks the others.",
        grouped=False,
    ),
    "viewshed": Command(
        "antumbra.city.sight.viewshed_command",
        "Count the observers that see each sensor of SCENE.",
        grouped=False,
        kernels="antumbra.city.sight.least_heights:EXAMPLES",
    ),
    "visible": Command(
        "antumbra.city.sight.visible_command",
        "Find the share of a target in SCENE that each sensor sees.",
        grouped=False,
    ),
    "matrix": Command(
        "antumbra.city.sight.matrix_command",
        "Find which sensors of SCENE see which targets, as one bit per pair.",
        grouped=False,
        kernels="antumbra.city.sight.visibility_matrix:EXAMPLES",
    ),
    "skyline": Command(
        "antumbra.city.skyline.skyline_command",
        "Find the skyline of points in SCENE: the elevation of the horizon by azimuth.",
        grouped=False,
        kernels="antumbra.city.skyline.skyline:EXAMPLES",
    ),
    "view-factors": Command(
        "antumbra.city.view_factors.view_factors_command",
        "Find the view factors between the surfaces of SCENE, and of the sky.",
        grouped=False,
    ),
    "dataset": Command(
        "antumbra.cli.dataset_command",
        "Render a data set of SCENE: per camera, a multi-layer EXR and a shadow mask of each light.",
    ),
    "merge": Command(
        "antumbra.cli.shards",
        "Join the shards of a command into the files it writes without --shard, byte for byte.",
        grouped=False,
    ),
    "build": Command("antumbra.cli.scene_commands", "Combine SCENEs in one store, which may exceed memory."),
    "info": Command("antumbra.cli.scene_commands", "Show the contents of SCENE."),
    "scenes": Command(
        "antumbra.cli.scene_commands", "List the procedural and the example scenes, or export a procedural one."
    ),
    "formats": Command("antumbra.cli.scene_commands", "List the file formats of scenes, and what is lost in them."),
    "plans": Command("antumbra.cli.installation_commands", "List the methods, and the plans they form."),
    "warmup": Command(
        "antumbra.cli.installation_commands",
        "Compile all kernels ahead of time, store them on disk, and calibrate the plan auto.",
    ),
    "culling": Command("antumbra.lab.explain_commands", "Show which triangles of SCENE survive pre-BVH culling."),
    "explain": Command(
        "antumbra.lab.explain_commands", "Show where plans spend the traversal steps of SCENE's shadow rays."
    ),
    "compare": Command("antumbra.lab.compare_command", "Measure plans on the same picture of SCENE, side by side."),
    "doctor": Command(
        "antumbra.cli.installation_commands",
        "Check this installation: versions, processor, kernels on disk, optional packages, devices, and a small query.",
    ),
}
"""Name -> command, in the order of the help."""
