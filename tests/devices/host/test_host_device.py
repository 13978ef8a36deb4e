"""The host device runs kernels that the toolchain has compiled, with the bits of NumPy."""

from fractions import Fraction

import numpy as np
import pytest

import device_kernels as sample
from antumbra.devices.device import DeviceError, OutOfDeviceMemory
from antumbra.devices.host import host_device
from antumbra.devices.host.host_device import HostDevice

FLOATS, DOUBLES, LINKS = (each.code("ptx") for each in sample.SAMPLES[:3])


@pytest.fixture
def device():
    return HostDevice()


def numbers(kind, exponents, n=10_000, seed=3):
    """Numbers of all magnitudes, subnormal ones and infinite results among them."""
    rng = np.random.default_rng(seed)
    with np.errstate(over="ignore"):
        return np.ldexp(rng.random((2, n)) - 0.5, rng.integers(-exponents, exponents, (2, n))).astype(kind)


def test_float32_operations_are_those_of_numpy(device):
    a, b = numbers(np.float32, 140)
    scale = np.float32(0.3)
    with device.upload(a) as x, device.upload(b) as y, device.allocate(20 * len(a)) as out:
        words = np.array([x.address, y.address, out.address, len(a), int(scale.view(np.int32))])
        device.launch(device.load(FLOATS), words, len(a))
        got = out.read(np.empty((len(a), 5), np.float32))
    with np.errstate(all="ignore"):
        fused = (a.astype(np.longdouble) * b + scale).astype(np.float32)
        expected = np.stack([a + b, a - b, a * b, a / b, fused], 1)
    assert (got[:, :4].view(np.int32) == expected[:, :4].view(np.int32)).all()
    assert (got[:, 4] == expected[:, 4]).mean() > 0.999  # a long double rounds twice
    assert np.isinf(expected).any() and (expected == 0).any()


def test_float64_operations_are_those_of_numpy(device):
    a, b = numbers(np.float64, 200)
    with device.upload(a) as x, device.upload(b) as y, device.allocate(48 * len(a)) as out:
        device.launch(device.load(DOUBLES), np.array([x.address, y.address, out.address, len(a)]), len(a))
        got = out.read(np.empty((len(a), 6)))
    expected = np.stack([a + b, a - b, a * b, a / b, got[:, 4], np.sqrt(np.abs(a))], 1)
    assert (got.view(np.int64) == expected.view(np.int64)).all()
    for x, y, product, error in zip(a[:99], b[:99], got[:99, 2], got[:99, 4]):
        assert Fraction(x) * Fraction(y) == Fraction(product) + Fraction(error)


def test_stacks_vectors_bytes_and_atomics_work_together(device):
    """Each thread finds itself in a traversal, as the same traversal in Python does."""
    n = 60
    boxes = np.random.default_rng(4).random((n, 4), np.float32)
    with device.upload(boxes) as there, device.allocate(n) as order, device.upload(np.zeros(1, np.int64)) as visits:
        device.launch(device.load(LINKS), np.array([there.address, order.address, n, visits.address]), n)
        ranks, total = order.read(np.empty(n, np.uint8)), visits.read(np.empty(1, np.int64))[0]
    expected, stack = [], [0]
    while stack:
        item = stack.pop()
        expected.append(item)
        left, right = 2 * item + 1, 2 * item + 2
        if right < n:
            low, high = np.minimum(boxes[left], np.float32(1.0)), np.maximum(boxes[right], np.float32(0.25))
            swap = low[0] + low[3] < high[1] * high[2]
            stack += [left, right] if swap else [right, left]
        elif left < n:
            stack.append(left)
    assert np.argsort(ranks).tolist() == expected and total == n * n


def test_new_memory_is_not_zero(device):
    with device.allocate(1000) as memory:
        assert memory.read(np.zeros(1000, np.uint8)).all() and memory.address % 128 == 0


def test_memory_has_a_budget(device):
    small = HostDevice(max_memory=1 << 20)
    with pytest.raises(OutOfDeviceMemory, match="raise max_memory"):
        small.allocate(2 << 20)
    block = small.allocate(1 << 20)
    block.free()
    assert small.used == 0 and small._arrays == {}


def test_a_kernel_is_translated_once(monkeypatch, device):
    device.load(FLOATS)
    monkeypatch.setattr(host_device, "PtxProgram", lambda code: pytest.fail("it is translated again"))
    assert HostDevice().load(FLOATS).entry == FLOATS.entry


def test_spirv_is_refused(device):
    with pytest.raises(ValueError, match="loads ptx"):
        device.load(sample.SAMPLES[0].code("spirv"))


def test_damaged_code_is_an_error(device):
    with pytest.raises(DeviceError):
        device.load(FLOATS._replace(code=FLOATS.code[:900]))
