"""Options of a command in groups, such as Camera and Light. Help is plain text, which needs no Rich."""

from typing import Any

from typer.core import TyperCommand

PANELS: dict[str, tuple[str, ...]] = {
    "Scene": ("time", "up", "ground"),
    "Camera": ("camera", "size"),
    "Light": ("light", "ao", "vpl", "bounce", "exposure"),
    "Quality": (
        "spp",
        "sampler",
        "filter",
        "antialias",
        "adaptive",
        "adaptive_spp",
        "cull_faces",
        "textures",
        "smooth_normals",
    ),
    "Animation": ("frames", "fps", "overwrite"),
    "Speed": ("plan", "explain_plan", "srdh_rays", "gbuffer", "threads", "max_memory"),
    "Machines": ("shard", "ray"),
    "Output": ("output", "html", "counters", "json", "quiet"),
}  # fmt: skip
"""Title -> the parameters below it. Other options stand below "Options"."""

_LEAST = 12  # options from which groups help


class Grouped(TyperCommand):
    """A command whose help shows its options in groups, if it has many."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        params = self.get_params(ctx)
        grouped = sum(param.param_type_name == "option" for param in params) >= _LEAST
        sections: dict[str, list] = {title: [] for title in ("Arguments", *PANELS, "Options")}
        for param in params:
            record = param.get_help_record(ctx)
            if record is not None:
                sections[_title(param) if grouped or param.param_type_name == "argument" else "Options"].append(record)
        for title, records in sections.items():
            if records:
                with formatter.section(title):
                    formatter.write_dl(records)


def _title(param: Any) -> str:
    if param.param_type_name == "argument":
        return "Arguments"
    return next((title for title, names in PANELS.items() if param.name in names), "Options")
