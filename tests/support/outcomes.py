"""Say at the end of a run what was skipped for want of a package, and how to repeat what failed."""

import os
import re
import shlex
import sys
from collections import Counter

import pytest

from antumbra.kernels.processor import level
from antumbra.kernels.toolchain.kernel_cache import cache_folder
from selection import MARKERS, SKIPPED

MOST = 20  # commands that are printed


class Outcomes:
    """Collects the skipped and failed tests of all processes."""

    def __init__(self, config: pytest.Config) -> None:
        self.config = config
        self.skipped: dict[str, str] = {}  # id of a test, or a file -> reason
        self.failed: list[str] = []

    def pytest_runtest_logreport(self, report):
        self._add(report)

    def pytest_collectreport(self, report):
        self._add(report)

    def _add(self, report) -> None:
        if report.skipped and isinstance(report.longrepr, tuple):
            self.skipped[report.nodeid] = report.longrepr[2].removeprefix("Skipped: ")
        elif report.failed and report.nodeid not in self.failed:
            self.failed.append(report.nodeid)

    @pytest.hookimpl(trylast=True)
    def pytest_sessionfinish(self):
        if getattr(self.config, "cache", None) and not self.config.option.collectonly:
            self.config.cache.set(SKIPPED, sorted(self.skipped))
            self.config.cache.set(MARKERS, self.config.option.markexpr)

    def pytest_terminal_summary(self, terminalreporter):
        if self.skipped:
            terminalreporter.section("skipped: NOT checked here")
            terminalreporter.write_line("\n".join(skips(self.skipped)))
        if self.failed:
            terminalreporter.section("to repeat the failures")
            terminalreporter.write_line("\n".join(commands(self.failed)))


def skips(reasons: dict[str, str]) -> list[str]:
    """A line for each reason, most frequent first, and the remedy."""
    counts = Counter(re.sub(r"\s+", " ", reason)[:100] for reason in reasons.values())
    lines = [f"{count:5}  {reason}" for reason, count in counts.most_common()]
    return [*lines, "After pip install '.[test-all]', pytest --skipped runs those for which a package was missing."]


def commands(failed: list[str]) -> list[str]:
    """Commands that run failed tests alone, and the settings that may matter."""
    lines = [f"pytest -n 0 -m '' {shlex.quote(each)}" for each in failed[:MOST]]
    if len(failed) > MOST:
        lines.append(f"and {len(failed) - MOST} more")
    variables = {name: value for name, value in os.environ.items() if name.startswith("ANTUMBRA_")}
    return [
        *lines,
        f"Python {sys.version.split()[0]} on {sys.platform}, kernels for {level()} in {cache_folder()}",
        "environment: " + (", ".join(f"{n}={v}" for n, v in sorted(variables.items())) or "no ANTUMBRA_ variables"),
        "A failing property test prints its smallest example and @reproduce_failure above; .hypothesis/ keeps it.",
    ]


def pytest_configure(config):
    if not hasattr(config, "workerinput"):  # not in the processes of pytest-xdist
        config.pluginmanager.register(Outcomes(config), "outcomes-of-all-processes")
