"""The names of the tables of ``antumbra bench chc-rt``."""

from enum import StrEnum


class Table(StrEnum):
    scenes = "scenes"
    times = "times"
    phases = "phases"
    queries = "queries"
    randomisation = "randomisation"
    aggressive = "aggressive"
    ablation = "ablation"
    store = "store"


WALKED = frozenset({Table.times, Table.phases, Table.queries, Table.store})
"""Tables of the same walkthroughs."""

IN_CORE = tuple(table for table in Table if table != Table.store)
PAGED = tuple(table for table in Table if table != Table.randomisation)
"""The tables of scenes in memory, and of a store."""
