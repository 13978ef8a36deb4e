"""What every device does alike: memory, launches, queues and budgets, over all that this machine has."""

import gc
import os
import pickle
import threading

import numpy as np
import pytest

from antumbra.devices.arrays import DeviceArray, borrow
from antumbra.devices.device import DeviceError, OutOfDeviceMemory, wait_until
from antumbra.devices.device_list import open_device
from device_kernels import SAMPLES, Arrays
from devices import DEVICES, launch, opened
from forked import in_child

FLOATS, DOUBLES, _, REVERSED, _, ODDS = SAMPLES


@pytest.fixture(params=DEVICES)
def device(request):
    return opened(request.param)


def any_floats(n, seed):
    """Random bit patterns: of all magnitudes, subnormal numbers, infinities and NaN."""
    return np.random.default_rng(seed).integers(0, 1 << 32, n, dtype=np.uint32).view(np.float32)


# Kernels


def test_float32_operations_give_the_bits_of_numpy(device):
    n, scale = 20_000, np.float32(3.7)
    a, b = any_floats(n, 1), any_floats(n, 2)
    one, other, out = device.upload(a), device.upload(b), device.allocate(20 * n)
    launch(device, FLOATS, [Arrays(one.address, other.address, out.address, n, scale)], n)
    found = out.read(np.zeros((n, 5), np.float32))
    with np.errstate(all="ignore"):
        expected = np.stack([a + b, a - b, a * b, a / b], axis=1)
    np.testing.assert_array_equal(found[:, :4], expected)
    assert np.isfinite(expected).any() and (abs(expected[np.isfinite(expected)]) < 1e-38).any()


def test_float64_operations_give_the_bits_of_numpy(device):
    n = 20_000
    rng = np.random.default_rng(3)
    a, b = rng.normal(size=(2, n)) * 2.0 ** rng.integers(-300, 300, (2, n))
    one, other, out = device.upload(a), device.upload(b), device.allocate(48 * n)
    launch(device, DOUBLES, [one.address, other.address, out.address, n], n)
    found = out.read(np.zeros((n, 6)))
    np.testing.assert_array_equal(found[:, :4], np.stack([a + b, a - b, a * b, a / b], axis=1))
    np.testing.assert_array_equal(found[:, 5], np.sqrt(abs(a)))


@pytest.mark.parametrize("block", [32, 64, 256])
def test_blocks_have_the_size_of_the_launch(device, block):
    numbers = np.arange(512, dtype=np.int32)
    source, out = device.upload(numbers), device.allocate(numbers.nbytes)
    launch(device, REVERSED, [source.address, out.address], 512, block=block)
    expected = numbers.reshape(-1, block)[:, ::-1].ravel()
    np.testing.assert_array_equal(out.read(np.zeros_like(numbers)), expected)


def test_a_module_is_taken_from_the_cards_cache(device):
    code = FLOATS.code(device.form)
    again = open_device(device.name).load(code)
    assert device.load(code).digest == again.digest == code.digest
    other = "spirv" if device.form == "ptx" else "ptx"
    with pytest.raises(ValueError, match=f"loads {device.form}, and .* is {other}"):
        device.load(FLOATS.code(other))


def test_launches_are_checked(device):
    module = device.load(ODDS.code(device.form))
    with pytest.raises(ValueError, match="takes 2 words"):
        device.launch(module, [0, 0, 0], 1)
    device.launch(module, [0, 0], 0)  # no thread, so no address is read
    device.synchronise()


def test_threads_share_a_device(device):
    n, wrong = 1024, []

    def work(seed):
        numbers = np.random.default_rng(seed).integers(0, 100, n, dtype=np.int32)
        for _ in range(5):
            source, total = device.upload(numbers), device.allocate(8)
            total.fill(0)
            launch(device, ODDS, [source.address, total.address], n)
            wrong.append(total.read(np.zeros(1, np.int64))[0] != (numbers & 1).sum())

    threads = [threading.Thread(target=work, args=(seed,)) for seed in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(wrong) == 20 and not any(wrong)
    gc.collect()
    assert device.used == 0


# Memory


def test_memory_is_written_read_and_filled_in_parts(device):
    memory = device.allocate(40)
    memory.fill(0)
    memory.write(np.array([7, 8], np.int64), offset=8)
    memory.fill(0xFF, offset=32)
    assert memory.read(np.zeros(5, np.int64)).tolist() == [0, 7, 8, 0, -1]
    assert memory.address % 128 == 0


@pytest.mark.parametrize("size", [0, 1, 1 << 20])
def test_arrays_of_any_size_come_back(device, size):
    numbers = np.random.default_rng(size).integers(0, 256, size, dtype=np.uint8)
    numbers.flags.writeable = False
    np.testing.assert_array_equal(device.upload(numbers).read(np.zeros(size, np.uint8)), numbers)


def test_copies_that_nobody_waits_for_are_done_once_the_queue_is(device):
    numbers, into = device.host_array(1000, np.int64), device.host_array(1000, np.int64)
    numbers[:], queue = np.arange(1000), device.new_queue()
    memory = device.allocate(8000)
    memory.write(numbers, queue=queue, wait=False)
    memory.read(into, queue=queue, wait=False)
    queue.synchronise()
    np.testing.assert_array_equal(into, numbers)


def test_a_queue_waits_for_an_event_of_another(device):
    numbers, queue = np.ones(1024, np.int32), device.new_queue()
    source, total = device.upload(numbers, queue=queue), device.allocate(8)
    total.fill(0, queue=queue)
    launch(device, ODDS, [source.address, total.address], 1024, queue=queue)
    device.queue.wait(queue.record())
    launch(device, ODDS, [source.address, total.address], 1024)
    assert total.read(np.zeros(1, np.int64))[0] == 2048


def test_events_follow_each_other_on_the_devices_clock(device):
    first = device.queue.record()
    memory = device.upload(np.zeros(1 << 20))
    second = device.queue.record()
    second.synchronise()
    assert first.is_done() and second.is_done() and memory.size == 8 << 20
    assert second.seconds_since(first) >= 0 and first.seconds_since(second) <= 0


@pytest.mark.parametrize("name", DEVICES)
def test_a_budget_is_kept_and_named(name):
    device = opened(name, max_memory=1000)
    kept = device.upload(np.zeros(100))
    assert (device.used, device.room()) == (800, 200)
    with pytest.raises(
        OutOfDeviceMemory, match=r"^the tree needs 300 bytes of memory on .*max_memory \(1\.0 kB\) leaves"
    ):
        device.allocate(300, "the tree")
    kept.free()
    with device.allocate(1000):
        assert device.room() == 0
    assert device.room() == 1000


def test_more_than_there_is_is_refused(device):
    with pytest.raises(OutOfDeviceMemory) as error:
        device.allocate(1 << 50)
    assert error.value.needed == 1 << 50 > error.value.left > 0
    with pytest.raises(OutOfDeviceMemory, match="the scene needs"):
        device.check_room(1 << 50, "the scene")
    device.check_room(1000, "the scene")
    assert device.used == 0


@pytest.mark.parametrize("name", DEVICES)
@pytest.mark.parametrize("value", [0, -1, 1.5, "2G"])
def test_a_budget_is_a_number_of_bytes(name, value):
    opened(name)
    with pytest.raises(ValueError, match="max_memory is"):
        open_device(name, max_memory=value)


# Processes


def test_a_pickled_device_is_opened_again_with_its_budget(device):
    copy = pickle.loads(pickle.dumps(open_device(device.name, max_memory=1000)))
    assert (copy.name, copy.max_memory, copy.used, str(copy)) == (device.name, 1000, 0, str(device))


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")
def test_a_forked_child_is_told_to_be_spawned(device):
    memory = device.upload(np.zeros(10))

    def refusals():
        works = (
            device.synchronise,
            lambda: device.allocate(10),
            lambda: memory.read(np.zeros(10)),
            lambda: memory.fill(0),
        )
        return [message_of(work) for work in works]

    found = in_child(refusals)
    assert all(str(device) in message and "get_context('spawn')" in message for message in found)


def message_of(work):
    try:
        work()
    except DeviceError as error:
        return str(error)
    return ""


def test_waiting_asks_again_until_it_is_done():
    answers = iter([False] * 40 + [True])
    wait_until(lambda: next(answers))
    assert next(answers, None) is None


def test_an_array_of_another_owner_of_the_card_is_borrowed_in_its_order(device):
    owner = open_device(device.name)
    array = DeviceArray(owner.upload(np.arange(6.0)), (2, 3), np.float64, owner.queue)
    found = borrow(array, device, "origins")
    assert (found.address, found.shape, found.dtype) == (array.memory.address, (2, 3), np.float64)
