"""The map sheet of lines of sight: each line in plan, solid if both points see each other, and a table of all pairs."""

from pathlib import Path

from ...engine.scene import AnyScene
from ...scene.scene_bounds import plan_points
from ..sheets.page import check_map
from ..sheets.sheet import save_report
from ..sheets.sheet_options import Sheet
from ..tables.map_legend import SightLine
from ..tables.map_sheet import table_report
from .sightlines import PairList, Sightlines, sight_table

_LABELS = "id", "name", "label"  # columns of the user's tables, in order of preference


def save_sight_map(scene: AnyScene, pairs: PairList, sightlines: Sightlines, path: Path, sheet: Sheet) -> None:
    """Write the map sheet of lines of sight.

    Raises
    ------
    InputError
        If the path cannot be written, the map does not fit at the sheet's scale, or there are no pairs.
    """
    target, table = check_map(path), sight_table(scene, pairs, sightlines)
    begin, end = (plan_points(each, scene.up) for each in (pairs.observers, pairs.targets))
    ends = zip(begin.tolist(), end.tolist(), sightlines.visible.tolist(), _names(pairs, "from"), _names(pairs, "to"))
    lines = [SightLine((a[0], a[1]), (b[0], b[1]), *rest) for a, b, *rest in ends]
    save_report(target, table_report(table, "visible", sheet, lines), sheet)


def _names(pairs: PairList, side: str) -> list[str]:
    """The labels of the ends of a side, "from" or "to"; empty where the user's table has none."""
    columns = pairs.attributes or {}
    found = next((columns[f"{side}_{name}"] for name in _LABELS if f"{side}_{name}" in columns), None)
    return [""] * len(pairs.observers) if found is None else [str(value) for value in found.tolist()]
