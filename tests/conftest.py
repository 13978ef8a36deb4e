"""Settings of all tests, and kernels for all of them, compiled before the first one."""

import os
import subprocess
import sys

import pytest
from hypothesis import settings

# Continuous integration repeats the same examples each time; developers' runs search on.
settings.register_profile("ci", derandomize=True, deadline=None)
if os.environ.get("CI"):
    settings.load_profile("ci")

# Two processes that met the same kernels at the same time would both compile them. So each compiles its own first:
# plan, how primary visibility is found, whether steps are counted.
FIRST = (
    [("bsah+single", "raster", False), ("bsah+single", "raster", True), ("bsah+wide", "raster", False)],
    [(plan, "rays", False) for plan in ("bsah+multifrusta", "bsah+chcrt", "bsah+packet16", "bsah+packet256", "cones")],
)
COMPILE = """
import sys
from antumbra.plan import parse_plan
from antumbra.warm import warm_up

for plan, gbuffer, counted in eval(sys.argv[1]):
    warm_up(parse_plan(plan), gbuffer, counted)
"""


def pytest_configure(config):
    """In the process that starts the others, when all tests are run."""
    if getattr(config.option, "numprocesses", None) and config.args_source is pytest.Config.ArgsSource.TESTPATHS:
        shares = [subprocess.Popen([sys.executable, "-c", COMPILE, repr(share)]) for share in FIRST]
        for share in shares:
            share.wait()
