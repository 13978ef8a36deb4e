"""The CUDA driver, over a fake libcuda whose memory and kernels are the host's."""

import _thread
import ctypes
import gc
import os
import pickle
import signal
import threading

import numpy as np
import pytest

from antumbra.devices.cuda import Cuda
from antumbra.devices.cuda_driver import CudaDriver, cuda_cards
from antumbra.devices.device import DeviceError, OutOfDeviceMemory
from fake_cuda import Code, built
from forked import in_child

ADD = Code("ptx", "add_five", 3, b".version 6.3", "digest of add_five")
forks = pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")


@pytest.fixture
def fake(fake_cuda):
    """A card with one kernel."""
    fake_cuda.launches = []
    fake_cuda.register(ADD, lambda words, blocks, block: add_five(fake_cuda, words, blocks, block))
    return fake_cuda


def add_five(driver, words, blocks, block):
    source, target, n = words
    driver.launches.append((blocks, block))
    at = lambda address: np.ctypeslib.as_array((ctypes.c_int64 * n).from_address(address))
    at(target)[:] = at(source) + 5


# Work


def test_a_kernel_reads_what_was_uploaded_and_its_results_are_downloaded(fake):
    device = Cuda()
    numbers = np.arange(1000)
    source, target = device.upload(numbers), device.allocate(numbers.nbytes)
    device.launch(device.load(ADD), [source.address, target.address, 1000], 1000)
    assert (target.read(np.zeros_like(numbers)) == numbers + 5).all()
    assert fake.launches == [(8, 128)]  # 1024 threads


def test_no_threads_launch_nothing(fake):
    device = Cuda()
    device.launch(device.load(ADD), [0, 0, 0], 0)
    assert fake.launches == []


def test_a_wrong_number_of_words_is_refused(fake):
    device = Cuda()
    with pytest.raises(ValueError, match="add_five takes 3 words"):
        device.launch(device.load(ADD), [0, 0], 1)


def test_parts_of_a_block_are_written_read_and_filled(fake):
    memory = Cuda().allocate(40)
    memory.fill(0)
    memory.write(np.array([7, 8], np.int64), offset=8)
    memory.fill(0xFF, offset=32)
    assert memory.read(np.zeros(5, np.int64)).tolist() == [0, 7, 8, 0, -1]
    with pytest.raises(ValueError, match="bytes 32 to 48 are not within a block of 40 bytes"):
        memory.write(np.zeros(2, np.int64), offset=32)


def test_an_array_that_is_not_contiguous_is_uploaded_in_its_own_order(fake):
    array = np.arange(12).reshape(3, 4).T
    assert (Cuda().upload(array).read(np.zeros_like(array, order="C")) == array).all()


def test_page_locked_arrays_are_copied_without_waiting(fake):
    device = Cuda()
    array, memory = device.host_array((10, 3), np.float32), device.allocate(120)
    assert array.shape == (10, 3) and array.dtype == np.float32
    array[:] = 2.5
    fake.keep_busy(-1)  # waiting would not end
    memory.write(array, wait=False)
    array[:] = 0
    memory.read(array, wait=False)
    fake.keep_busy(0)
    device.synchronise()
    assert (array == 2.5).all()


def test_a_module_is_loaded_once_per_card(fake):
    assert Cuda().load(ADD) is Cuda().load(ADD)
    fake.machine(cards=2)
    assert Cuda(1).load(ADD) is not Cuda(0).load(ADD)


def test_a_module_reports_registers_and_local_memory(fake):
    module = Cuda().load(ADD)
    assert (module.registers, module.local_bytes) == (4, 3)  # the fake returns the attribute's number


def test_events_measure_time_and_queues_wait_for_each_other(fake):
    device = Cuda()
    queue = device.new_queue()
    first, second = device.queue.record(), device.queue.record()
    queue.wait(second)
    fake.keep_busy(3)
    assert not second.is_done()
    second.synchronise()
    assert second.seconds_since(first) == pytest.approx(1e-3)
    assert queue.handle != device.queue.handle != 0


def test_everything_is_freed_when_nothing_refers_to_it(fake):
    device = Cuda()
    gc.collect()  # what other tests have left
    before = fake.counts()
    array, memory, queue, event = (
        device.host_array(3, int),
        device.allocate(8),
        device.new_queue(),
        device.queue.record(),
    )
    alive = fake.counts()
    assert (alive.memory, alive.pinned, alive.events) == (before.memory + 1, before.pinned + 1, before.events + 1)
    assert alive.streams == before.streams + 2  # with the default queue
    view = array[1:]
    del array, memory, queue, event
    gc.collect()
    after = fake.counts()
    assert after._replace(streams=0, pinned=0) == before._replace(streams=0, pinned=0)
    assert (after.streams, after.pinned) == (before.streams + 1, before.pinned + 1)
    del view
    assert fake.counts().pinned == before.pinned
    assert device.used == 0


def test_a_stream_of_another_library_is_used_and_left_to_it(fake):
    device = Cuda()
    queue = device.foreign_queue(0x1234)
    assert queue.handle == 0x1234
    queue.synchronise()
    before = fake.counts()
    del queue
    assert fake.counts().streams == before.streams


def test_threads_leave_no_context_behind(fake):
    device, wrong = Cuda(), []

    def work():
        for k in range(50):
            numbers = np.arange(k, k + 10)
            source, target = device.upload(numbers), device.allocate(80)
            device.launch(device.load(ADD), [source.address, target.address, 10], 10)
            if (target.read(np.zeros(10, int)) != numbers + 5).any() or fake.counts().contexts:
                wrong.append(k)

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong and len(fake.launches) == 200 and device.used == 0


# Memory


def test_an_allocation_beyond_the_budget_says_how_much_it_needs(fake):
    device = Cuda(max_memory=1 << 20)
    kept = device.allocate(600_000)
    with pytest.raises(OutOfDeviceMemory) as error:
        device.allocate(500_000, "the tree")
    assert str(error.value) == (
        "the tree needs 500.0 kB of memory on cuda:0 (Fake card), but max_memory (1.0 MB) leaves 448.6 kB; "
        "raise max_memory, for example --max-memory 2M"
    )
    assert (error.value.needed, error.value.left) == (500_000, (1 << 20) - 600_000)
    with pytest.raises(OutOfDeviceMemory, match="the scene needs"):
        device.check_room(500_000, "the scene")
    kept.free()
    device.check_room(500_000, "the scene")
    assert device.allocate(500_000).size == device.used == 500_000


def test_a_full_card_says_how_much_is_free(fake):
    device = Cuda()
    with pytest.raises(OutOfDeviceMemory) as error:
        device.allocate(1 << 31, "the tree")
    assert str(error.value) == (
        "the tree needs 2.1 GB of memory on cuda:0 (Fake card), but 1.1 GB are free; close other programs that use it, "
        "or compute on the CPU"
    )
    assert device.used == 0


def test_two_owners_of_a_card_have_budgets_of_their_own(fake):
    one, other = Cuda(max_memory=100), Cuda(max_memory=100)
    kept = one.allocate(100)
    assert (one.room(), other.room()) == (0, 100)
    other.allocate(100)
    assert kept.size == 100


def test_freed_memory_is_not_used_any_more(fake):
    with Cuda().allocate(8) as memory:
        pass
    with pytest.raises(ValueError, match="this device memory is freed"):
        memory.fill()


# Errors


def test_a_missing_driver_is_named(fake, monkeypatch):
    monkeypatch.setattr("antumbra.devices.cuda_driver.LIBRARY", "libno_such_driver.so.1")
    with pytest.raises(
        DeviceError, match=r"^CUDA: there is no NVIDIA driver \(libno_such_driver\.so\.1 cannot be loaded\)"
    ):
        cuda_cards()


def test_a_driver_without_a_function_is_too_old(tmp_path):
    (tmp_path / "old.c").write_text("int cuInit(unsigned flags) { return 0; }")
    with pytest.raises(DeviceError, match="too old, it lacks cuDriverGetVersion; update it"):
        CudaDriver(built(tmp_path, tmp_path / "old.c"))


def test_a_driver_of_an_old_cuda_is_refused(fake):
    fake.machine(version=9020)
    with pytest.raises(DeviceError, match=r"supports CUDA 9\.2, and kernels need 10\.0; update it"):
        Cuda()


@pytest.mark.parametrize(
    "function, status, message",
    [
        ("cuInit", 100, "CUDA: cuInit: CUDA_ERROR_NO_DEVICE; no card was found; check that nvidia-smi lists it"),
        ("cuInit", 803, "CUDA: cuInit: CUDA_ERROR_SYSTEM_DRIVER_MISMATCH; the driver was updated; restart"),
        ("cuInit", 3, "CUDA: cuInit: CUDA_ERROR_NOT_INITIALIZED; start processes with multiprocessing"),
        ("cuDevicePrimaryCtxRetain", 46, "CUDA_ERROR_DEVICE_UNAVAILABLE; another program has the card for itself"),
        ("cuDevicePrimaryCtxRetain", 2, "CUDA_ERROR_OUT_OF_MEMORY; close other programs that use the card"),
        ("cuInit", 12345, "CUDA: cuInit: CUDA error 12345; if it happens again, please report it"),
    ],
)
def test_a_card_that_cannot_be_opened_is_explained_in_one_line(fake, function, status, message):
    fake.fail(function, status)
    with pytest.raises(DeviceError) as error:
        Cuda()
    assert message in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    "machine, ordinal, message",
    [
        ({"cards": 0}, 0, "there is no cuda:0; the driver lists no card"),
        ({"cards": 2}, 2, "there is no cuda:2; the last card is cuda:1"),
        ({"capability": 61}, 0, "cuda:0 (Fake card): its compute capability is 6.1, and kernels need 7.5"),
        ({"mode": 2}, 0, "cuda:0 (Fake card): its compute mode forbids programs; an administrator allows them"),
    ],
)
def test_a_card_that_is_missing_or_cannot_run_kernels_is_refused(fake, machine, ordinal, message):
    fake.machine(**machine)
    with pytest.raises(DeviceError) as error:
        Cuda(ordinal)
    assert str(error.value).startswith(message)


def test_code_that_the_driver_does_not_take_comes_with_its_log(fake):
    fake.fail("cuModuleLoadDataEx", 218)
    with pytest.raises(DeviceError) as error:
        Cuda().load(ADD)
    assert str(error.value) == (
        "cuda:0 (Fake card): the driver does not take add_five: CUDA_ERROR_INVALID_PTX; "
        "ptxas error: line 7: syntax error"
    )


def test_code_without_the_entry_is_refused(fake):
    with pytest.raises(DeviceError, match="cuModuleGetFunction: CUDA_ERROR_NOT_FOUND"):
        Cuda().load(ADD._replace(entry="other", digest="other"))


def test_code_of_another_form_is_refused(fake):
    with pytest.raises(ValueError, match=r"cuda:0 \(Fake card\) loads ptx, and add_five is spirv"):
        Cuda().load(ADD._replace(form="spirv"))


def test_a_launch_that_fails_names_the_error(fake):
    device = Cuda()
    fake.fail("cuLaunchKernel", 1)
    with pytest.raises(DeviceError, match=r"^cuda:0 \(Fake card\): cuLaunchKernel: CUDA_ERROR_INVALID_VALUE"):
        device.launch(device.load(ADD), [0, 0, 0], 1)


@pytest.mark.parametrize("status, name", [(700, "ILLEGAL_ADDRESS"), (702, "LAUNCH_TIMEOUT")])
def test_a_kernel_that_fails_later_is_reported_by_the_next_wait(fake, status, name):
    device = Cuda()
    memory = device.allocate(8)
    fake.fail("cuEventQuery", status)
    with pytest.raises(DeviceError, match=f"a kernel failed: CUDA_ERROR_{name}"):
        device.synchronise()
    with pytest.raises(DeviceError, match=f"a kernel failed: CUDA_ERROR_{name}"):
        memory.read(np.zeros(1))


def test_ctrl_c_interrupts_waiting(fake):
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in background jobs of shells
    device = Cuda()
    fake.keep_busy(-1)
    timer = threading.Timer(0.2, _thread.interrupt_main)
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        device.synchronise()
    timer.join()
    signal.signal(signal.SIGINT, before)


# Processes


@forks
def test_a_forked_child_is_told_to_be_spawned(fake):
    device = Cuda()
    memory, module = device.allocate(8), device.load(ADD)

    def refusals():
        works = [
            lambda: device.allocate(8),
            lambda: device.launch(module, [0, 0, 0], 1),
            lambda: memory.read(np.zeros(1)),
            lambda: device.synchronise(),
            lambda: Cuda(),
            lambda: cuda_cards(),
        ]
        return [message_of(work) for work in works]

    assert all("multiprocessing.get_context('spawn')" in message for message in in_child(refusals))


def message_of(work):
    try:
        work()
    except DeviceError as error:
        return str(error)
    return ""


@forks
def test_a_forked_child_frees_nothing_of_its_parent(fake):
    device = Cuda()
    memory = device.allocate(8)

    def left():
        nonlocal memory
        del memory
        gc.collect()
        return fake.counts().memory

    assert in_child(left) == fake.counts().memory


@forks
def test_a_child_that_was_forked_before_may_open_the_card(fake):
    assert in_child(lambda: Cuda().allocate(8).size) == 8


def test_a_pickled_device_opens_the_card_again(fake):
    fake.machine(cards=2)
    device = pickle.loads(pickle.dumps(Cuda(1, max_memory=1000)))
    assert (device.name, device.max_memory, device.used) == ("cuda:1", 1000, 0)


def test_errors_are_pickled(fake):
    with pytest.raises(OutOfDeviceMemory) as error:
        Cuda(max_memory=10).allocate(20)
    copy = pickle.loads(pickle.dumps(error.value))
    assert (str(copy), copy.needed, copy.left) == (str(error.value), 20, 10)
