"""Times contenders that answer the same rays, in turns in one process, and compares their answers."""

import statistics
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

OURS = "antumbra"
CLOCKS = {"wall": time.perf_counter, "cpu": time.process_time}
"""Clocks to time with. On one thread, "cpu" does not count the time of other processes on a busy machine."""

_CLOSE, _MOST = 1.25, 2  # modes of a family in the rounds: largest time relative to its best mode, largest number


class Contender(NamedTuple):
    """A method that answers rays. Contenders of one peer's family are its modes; only the best modes count."""

    family: str
    name: str
    ready: Callable[[], Any]  # makes the argument of `run`, anew each time; not timed
    run: Callable[[Any], Any]  # answers the rays; timed
    answer: Callable[[Any], np.ndarray]  # result of `run` -> one number for each ray


class Result(NamedTuple):
    """The result of one contender."""

    contender: Contender
    tried: float  # seconds of the first try, in which our kernels are compiled or loaded
    seconds: list[float]  # seconds of the rounds; empty if other modes of its family were faster
    differs: int  # rays whose answer differs from the first contender's

    def rate(self, n: int, take=statistics.median) -> float:
        """Million rays a second of n rays."""
        return n / take(self.seconds or [self.tried]) / 1e6


def contest(contenders: list[Contender], asked: np.ndarray, rounds: int, clock: str, say: Callable[[str], None]):
    """Try all contenders once, then time ours and the best modes of each family, in turns, for `rounds` rounds.

    asked : (rays,) bool; answers are compared where it is True
    say : shows the current operation

    Returns a list of Result, and the first contender's answers to the rays asked.
    """
    tried, differs, reference = [], [], None
    for contender in contenders:
        say(contender.name)
        seconds, result = _timed(contender, CLOCKS[clock])
        answer = contender.answer(result)[asked]
        reference = answer if reference is None else reference
        tried.append(seconds)
        differs.append(int(np.count_nonzero(answer != reference)))
        del result
    rest = _finalists(contenders, tried)
    seconds = {i: [] for i in rest}
    for turn in range(rounds):
        say(f"round {turn + 1} of {rounds}")
        for i in rest:
            seconds[i].append(_timed(contenders[i], CLOCKS[clock])[0])
    return [Result(c, tried[i], seconds.get(i, []), differs[i]) for i, c in enumerate(contenders)], reference


def _timed(contender: Contender, clock) -> tuple[float, Any]:
    state = contender.ready()
    start = clock()
    result = contender.run(state)
    return clock() - start, result


def _finalists(contenders, tried) -> list[int]:
    """Indices of all our contenders, and of the fastest modes of each peer."""
    chosen = {i for i, c in enumerate(contenders) if c.family == OURS}
    for family in {c.family for c in contenders} - {OURS}:
        modes = sorted((tried[i], i) for i, c in enumerate(contenders) if c.family == family)
        chosen |= {i for seconds, i in modes[:_MOST] if seconds <= _CLOSE * modes[0][0]}
    return sorted(chosen)


def rows(case: dict, results: list[Result], n: int) -> list[dict]:
    """A row for each contender. `ratio`, in our rows, is relative to the fastest peer."""
    peers = [r.rate(n) for r in results if r.contender.family != OURS and r.seconds]
    found = []
    for r in results:
        row = {**case, "family": r.contender.family, "contender": r.contender.name, "rays": n}
        row |= {"mrays": r.rate(n), "best_mrays": r.rate(n, min), "rounds": len(r.seconds), "seconds": r.seconds}
        row |= {"differs": r.differs, "tried_seconds": r.tried}
        if r.contender.family == OURS and peers:
            row["ratio"] = r.rate(n) / max(peers)
        found.append(row)
    return found


def summary(found: list[dict]) -> list[str]:
    """Lines with the geometric mean and the worst of the ratios over all cases, for each of our contenders."""
    ratios: dict[tuple, list[tuple[float, str]]] = {}
    for row in found:
        if "ratio" in row:
            case = " ".join(str(row[k]) for k in ("scene", "light") if k in row)
            ratios.setdefault((row["contender"], row["threads"]), []).append((row["ratio"], case))
    lines = []
    for (name, threads), cases in ratios.items():
        worst, where = min(cases)
        mean = statistics.geometric_mean(ratio for ratio, _ in cases)
        lines.append(
            f"{name}, {threads} thread{'s'[: threads > 1]}: {mean:.2f} times the best peer in geometric mean of "
            f"{len(cases)} cases, {worst:.2f} in the worst ({where})"
        )
    return lines
