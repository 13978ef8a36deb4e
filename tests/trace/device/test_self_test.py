"""The self-test of cards: it passes where the code is right, and notices single instructions that are not."""

import random
import re
import signal

import pytest

import forked
from antumbra.devices.device import DeviceError
from antumbra.devices.device_list import open_device
from antumbra.devices.host.host_device import HostDevice
from antumbra.trace.device import self_test
from antumbra.trace.device.build_kernels import BUILD_KERNELS
from antumbra.trace.device.cutout_kernels import CUTOUT_KERNELS
from antumbra.trace.device.device_kernels import KERNELS
from antumbra.trace.device.instance_kernels import INSTANCE_KERNELS
from antumbra.trace.device.nearest_list_kernels import NEAREST_LIST_KERNELS
from antumbra.trace.device.pixel_kernels import PIXEL_KERNELS
from antumbra.trace.device.raster_kernels import RASTER_KERNELS
from antumbra.trace.device.self_test import check_device, open_tested, run_self_test
from antumbra.trace.device.tree_list_kernels import TREE_LIST_KERNELS
from devices import DEVICES, opened
from forked import in_child

# Instructions of PTX, and other ones in their place


EXCHANGED = {"add.rn": "sub.rn", "sub.rn": "add.rn", "mul.rn": "add.rn", "min": "max", "max": "min"}
EXCHANGED |= {f"setp.{a}": f"setp.{b}" for a, b in [("lt", "gt"), ("gt", "lt"), ("le", "ge"), ("ge", "le")]}
EXCHANGED |= {f"setp.{a}u": f"setp.{b}u" for a, b in [("lt", "gt"), ("gt", "lt"), ("le", "ge"), ("ge", "le")]}
EXCHANGED |= {"setp.eq": "setp.neu", "setp.neu": "setp.eq"}
FLOAT = re.compile(r"(\s*(?:@\S+\s+)?)(\w+(?:\.\w+)*)\.(f32|f64)\s+(.*);")


def altered(line):
    """An instruction on floats with another operation, or with exchanged operands of an fma; None for other lines."""
    match = FLOAT.fullmatch(line)
    if match is None:
        return None
    head, operation, kind, operands = match.groups()
    if operation == "fma.rn":
        to, a, b, c = operands.split(", ")
        return f"{head}fma.rn.{kind} {to}, {a}, {c}, {b};" if b != c else None
    return f"{head}{EXCHANGED[operation]}.{kind} {operands};" if operation in EXCHANGED else None


def ptx_lines(kernel):
    return kernel.code("ptx").code.decode().splitlines()


class Altered:
    """A kernel whose PTX has another instruction in one place."""

    def __init__(self, name, rng):
        code, lines = KERNELS[name].code("ptx"), ptx_lines(KERNELS[name])
        place = rng.choice([k for k, line in enumerate(lines) if altered(line)])
        self.change = f"{lines[place].strip()} -> {altered(lines[place]).strip()}"
        lines[place] = altered(lines[place])
        self._code = code._replace(code="\n".join(lines).encode(), digest=f"{name} {place}")

    def code(self, form):
        assert form == "ptx"
        return self._code


def sees():
    """Whether the self-test on the host has wrong answers, in a child that is killed if a search never ends."""

    def has_wrong_answers():
        signal.setitimer(signal.ITIMER_PROF, 15)  # seconds of the processor, since the machine may be busy
        return run_self_test(open_device("host")).wrong > 0

    try:
        return in_child(has_wrong_answers)
    except AssertionError:
        return True


def seen(names, seed, monkeypatch):
    """For one altered instruction of each kernel named, whether the self-test on the host sees it."""
    rng, found = random.Random(seed), []
    monkeypatch.setattr(forked, "SECONDS", 3600)
    for name in names:
        with monkeypatch.context() as patch:
            kernel = Altered(name, rng)
            patch.setitem(KERNELS, name, kernel)
            found.append(sees())
            print(name, kernel.change, found[-1])
    return found


@pytest.mark.parametrize("name", DEVICES)
def test_right_code_passes(name):
    answers, wrong = run_self_test(opened(name))
    assert wrong == 0 and answers > 50_000


def test_altered_instructions_are_seen(monkeypatch):
    """Not all: many only end a search earlier, or widen a bound, so that the CPU decides more."""
    assert any(seen(["trace_any", "trace_nearest", "settle_nearest", "report_hits"], 3, monkeypatch))


def test_an_altered_texel_or_copy_is_seen(monkeypatch):
    assert any(seen(["sum_depths_of_samples", "write_shares", "nearest_cutouts", "nearest_in_copies"], 3, monkeypatch))


def test_an_altered_build_is_seen(monkeypatch):
    assert any(seen(["make_grid", "bound_nodes"], 3, monkeypatch))


def test_every_kernel_of_builds_pixels_cut_outs_and_copies_takes_part(monkeypatch):
    launched, launch = set(), HostDevice._launch
    monkeypatch.setattr(HostDevice, "_launch", lambda self, module, *rest: (
        launched.add(module.entry), launch(self, module, *rest)
    ))  # fmt: skip
    run_self_test(open_device("host"))
    kernels = BUILD_KERNELS | PIXEL_KERNELS | RASTER_KERNELS | CUTOUT_KERNELS | INSTANCE_KERNELS
    kernels |= TREE_LIST_KERNELS | NEAREST_LIST_KERNELS
    assert {kernel.code("ptx").entry for kernel in kernels.values()} <= launched


@pytest.mark.slow
def test_half_of_the_altered_instructions_are_seen(monkeypatch):
    names = [name for name, kernel in KERNELS.items() if any(map(altered, ptx_lines(kernel)))]
    assert len(names) >= 10
    found = {name: sum(seen([name] * 12, 4, monkeypatch)) for name in names}
    assert all(found.values()), found
    assert sum(found.values()) >= 0.45 * 12 * len(names), found


# The first use of a card


@pytest.fixture
def first_use(tmp_path, monkeypatch):
    """A user whose cache is empty; the runs of the self-test."""
    monkeypatch.setattr(self_test, "cache_root", lambda: tmp_path)
    monkeypatch.setattr(self_test, "_passed", set())
    runs, run = [], run_self_test
    monkeypatch.setattr(self_test, "run_self_test", lambda device: runs.append(str(device)) or run(device))
    return runs


def passes(tmp_path):
    return [path.suffix for path in (tmp_path / "devices").glob("*")]


def test_a_card_is_tested_once_per_driver(first_use, tmp_path, monkeypatch):
    device = open_device("host")
    check_device(device)
    check_device(open_device("host"))
    monkeypatch.setattr(self_test, "_passed", set())  # another process
    check_device(device)
    assert len(first_use) == 1 and passes(tmp_path) == [".passed"]
    device.driver = "another driver"
    check_device(device)
    assert len(first_use) == 2 and passes(tmp_path) == [".passed"] * 2


def test_a_card_that_answers_wrongly_is_refused_each_time(first_use, tmp_path, monkeypatch):
    rng = random.Random(3)
    monkeypatch.setitem(KERNELS, "refit_nodes", Altered("refit_nodes", rng))
    for _ in range(2):
        with pytest.raises(
            DeviceError, match=r"answers in its self-test are wrong, so it is not used; update its driver"
        ):
            check_device(open_device("host"))
    assert len(first_use) == 2 and not passes(tmp_path)


def test_a_cache_that_cannot_be_written_is_no_error(first_use, tmp_path):
    (tmp_path / "devices").write_text("a file")
    check_device(open_device("host"))
    assert len(first_use) == 1


def test_the_budget_of_the_owner_is_not_for_the_self_test(first_use):
    device = open_device("host", max_memory=1000)
    check_device(device)
    assert device.used == 0 and len(first_use) == 1


def test_the_host_is_no_card(first_use):
    assert open_tested("host").kind == "host" and not first_use


def test_a_card_is_tested_when_it_is_opened(first_use):
    opened("opencl")
    open_tested("opencl")
    assert len(first_use) == 1


def test_a_card_behind_nvidias_driver_passes(fake_cuda):
    """The fake driver's kernels are the PTX on the processor, so only the card and its compiler take no part."""
    card, host = open_device("cuda"), open_device("host")
    for kernel in KERNELS.values():
        module = host.load(kernel.code("ptx"))
        fake_cuda.register(module, lambda words, blocks, block, m=module: host.launch(m, words, blocks * block, block))
    answers, wrong = run_self_test(card)
    assert wrong == 0 and answers > 50_000
