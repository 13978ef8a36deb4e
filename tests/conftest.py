"""Settings of all tests, and kernels for all of them, compiled before the first one."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # each process of the tests has a core; before numpy is imported

import pytest
from hypothesis import settings

from antumbra.kernels.needs import recorded
from antumbra.methods import add_plugins
from antumbra.rendering.ready import compile_missing, missing_of
from antumbra.scene.procedural import add_scenes

pytest_plugins = ["command_line"]
add_scenes()
add_plugins()  # so that registries are the same in all tests, and what is recorded is that of all methods

# Continuous integration repeats the same examples each time; developers' runs search on.
settings.register_profile("ci", derandomize=True, deadline=None)
if os.environ.get("CI"):
    settings.load_profile("ci")


def pytest_configure(config):
    """In the process that starts the others, when all tests are run: it compiles what they would compile one by one."""
    all_tests = config.args_source is pytest.Config.ArgsSource.TESTPATHS
    if getattr(config.option, "numprocesses", None) and all_tests and (missing := missing_of(recorded().kernels)):
        compile_missing(missing)
