"""The names of the tables of ``antumbra bench chc-rt``."""

from enum import StrEnum


class Table(StrEnum):
    times = "times"
    phases = "phases"
    queries = "queries"
    randomisation = "randomisation"
    aggressive = "aggressive"
    store = "store"
