"""Skip loudly what fails only because an optional package is not installed, as after ``pip install '.[test]'``.

Only a package that cannot be imported here counts, so that nothing is excused where all extras are installed.
"""

import importlib.util
import re

import pytest

_NAMED = re.compile(r"needs ([\w.-]+): pip install|No module named '([\w.]+)'|could not import '([\w.]+)'")
_MODULES = {"imageio-ffmpeg": "imageio_ffmpeg", "mapbox-earcut": "mapbox_earcut", "scipy.sparse": "scipy"}


def missing(text: str) -> str | None:
    """The package named in an error message that is really missing; None: there is no such package."""
    for match in _NAMED.finditer(text):
        name = next(filter(None, match.groups()))
        module = _MODULES.get(name, name).partition(".")[0]
        if importlib.util.find_spec(module) is None:
            return module
    return None


def _excuse(report, path: str, line: int) -> None:
    text = "\n".join([report.longreprtext, *(content for _, content in report.sections)])
    if report.failed and (name := missing(text)):
        report.outcome = "skipped"
        report.longrepr = (path, line, f"Skipped: needs {name}, which is not installed")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    report = yield
    _excuse(report, str(item.path), item.location[1] or 0)
    return report


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report(collector):
    report = yield
    _excuse(report, str(collector.path), 0)
    return report
