"""Kernels that first pictures do without are loaded for queries that pay for them."""

from math import inf

import pytest

from antumbra.engine.auto import kernel_loads
from antumbra.engine.auto.cost_model import GUIDED, strategies
from antumbra.kernels.toolchain.compile_pool import KernelRequest

LATER = "multifrusta:by-sample"
ALL_LATER = "wide", "wide:samples", LATER


@pytest.fixture
def missing(monkeypatch):
    """The kernels that are not on disk; none is loaded yet."""
    kernels = set()
    monkeypatch.setattr(kernel_loads, "TRACER_LOADS", kernel_loads.KernelLoads())
    monkeypatch.setattr(kernel_loads, "missing_of", lambda recorded: kernels)
    kernel_loads._load_seconds.cache_clear()
    yield kernels
    kernel_loads._load_seconds.cache_clear()


def seconds_until(share):
    """The time of queries for which the kernels pay; `share`: of the seconds of loading them."""
    cost = strategies()[LATER].cost
    return share * cost.load / cost.saving


def test_kernels_are_loaded_once_queries_would_have_gained_their_time():
    loads = kernel_loads.KernelLoads()
    assert not loads.pays("culling", -1.0) and not loads.pays("culling", 0.015) and not loads.pays(GUIDED, 0.01)
    assert loads.pays("culling", 0.006) and loads.pays("culling", 1e-6) and not loads.pays("culling", 0.0)


def test_a_tracer_that_is_loaded_later_waits_for_queries_that_pay(missing):
    names = [name for name in strategies() if name == LATER or name not in ALL_LATER]
    others = [name for name in names if name != LATER]
    assert kernel_loads.worth_loading(names, seconds_until(0.6)) == others
    assert kernel_loads.worth_loading(names, 0.0) == others
    assert kernel_loads.worth_loading(names, seconds_until(0.6)) == names


@pytest.mark.parametrize("compiler, seconds", [(True, 5.0), (False, inf)])
def test_kernels_that_are_not_on_disk_take_as_long_as_compiling_them(missing, monkeypatch, compiler, seconds):
    missing |= {KernelRequest("a:b", "", 3.0), KernelRequest("a:c", "", 2.0)}
    monkeypatch.setattr(kernel_loads, "has_compiler", lambda: compiler)
    assert kernel_loads._load_seconds(LATER) == pytest.approx(seconds + strategies()[LATER].cost.load)
    assert LATER not in kernel_loads.worth_loading([LATER], seconds_until(100.0))


def test_which_tracers_are_loaded_later():
    """First pictures compile the kernels of all others."""
    assert [name for name, tracer in strategies().items() if tracer.cost.load] == list(ALL_LATER)
