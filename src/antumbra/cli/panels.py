"""Options of a command in groups, such as Camera and Light. Help is plain text, which needs no Rich."""

from typing import Any

from typer.core import TyperCommand

PANELS: dict[str, tuple[str, ...]] = {
    "Scene": ("up",),
    "Camera": ("camera", "size"),
    "Light": ("light", "sky", "ao", "vpl", "exposure"),
    "Quality": ("preset",),
    "Animation": ("frames", "fps", "overwrite"),
    "Speed": ("plan", "explain_plan"),
    "Machines": ("shard", "ray"),
    "Output": ("output", "html", "json", "quiet"),
}
"""Title -> parameters below it, besides those that name a title themselves. Others stand below "Options"."""

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
    own = getattr(param, "rich_help_panel", None)
    return own or next((title for title, names in PANELS.items() if param.name in names), "Options")
