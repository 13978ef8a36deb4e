"""What the plan `auto` chose for a picture, why, and how well it predicted."""

from typing import TYPE_CHECKING

from . import report

if TYPE_CHECKING:
    from ..auto.choose import Choice
    from .picturespec import Shot

_WIDTH = 110  # characters of a line
_REASONS = {"prediction": "predicted", "earlier query": "as for an earlier query"}


def print_choices(shot: "Shot", triangles: int) -> None:
    """Print a row for the tree and one for each query; for a plan that chooses nothing, its name."""
    from ..auto.rates import build_seconds, machine
    from ..plan import parse_plan

    frame = shot.frame
    if frame.choices is None:
        print(f"The plan {frame.plan} names its methods; nothing was chosen.")
        return
    built, builder = frame.timings["build"], parse_plan(frame.plan).build
    rows = []
    if builder in machine().builds:
        predicted = report.duration(build_seconds(builder, triangles))
        rows.append(("tree", f"{triangles:,}", builder, "predicted rays", predicted, report.duration(built)))
    names = [type(light).__name__ for light in shot.lights]
    for i, choice in enumerate(frame.choices):
        times = report.duration(choice.predicted), report.duration(choice.seconds)
        way = choice.way + ", sorted" * choice.sorted
        rows.append((names[i] if i < len(names) else "more rays", f"{choice.rays:,}", way, _reason(choice), *times))
    head = ("query", "rays", "method", "why", "predicted", "measured")
    report.print_table(head, rows, right=(1, 4, 5), width=_WIDTH)


def _reason(choice: "Choice") -> str:
    if choice.reason != "sample":
        return _REASONS[choice.reason]
    of_ray = ", ".join(f"{way} {ns:.3g}" for way, ns in sorted(choice.tried.items(), key=lambda item: item[1]))
    return f"a sample: {of_ray} ns a ray"
