"""Settings of all tests. Kernels of all tests are compiled before the first test."""

import gc
import os
import signal

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # one core for each test process; set before numpy is imported

import pytest

from antumbra.engine.method_registry import add_plugins
from antumbra.engine.precompilation import compile_missing, missing_of
from antumbra.generate.procedural_scenes import load_plugin_scenes
from antumbra.kernels.toolchain import kernel_manifest
from devices import opened

pytest_plugins = ["command_line", "fake_cuda", "missing_packages", "outcomes", "ray_nodes", "selection", "wasm_kernels"]
load_plugin_scenes()
add_plugins()  # so that registries are the same in all tests, and the recorded kernels are those of all methods


if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:  # as shells start background jobs; commands would inherit it
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_finish():
    """Let no garbage collection visit what was collected, a million objects, again: all of it lives until the end."""
    gc.freeze()


def pytest_runtest_setup(item):
    """Skip tests of a device that is not there."""
    for mark in item.iter_markers("device"):
        opened(*mark.args)


def pytest_configure(config):
    """Compile all kernels once, in the process that starts the others, if all tests are run."""
    all_tests = config.args_source is pytest.Config.ArgsSource.TESTPATHS and not config.option.skipped
    if getattr(config.option, "numprocesses", None) and all_tests:
        own = "not papers" in config.option.markexpr
        if missing := missing_of(
            (
                kernel_manifest.read_manifests(kernel_manifest.MANIFEST) if own else kernel_manifest.recorded_kernels()
            ).kernels
        ):
            compile_missing(missing)
