"""Arrays shared with other libraries, on a fake card whose memory is the host's: NumPy stands for PyTorch there."""

import ctypes
import gc

import numpy as np
import pytest

from antumbra.base.errors import InputError
from antumbra.devices import arrays
from antumbra.devices.arrays import DeviceArray, borrow, place_of
from antumbra.devices.cuda import Cuda


class Foreign:
    """An array of another library on a card, which speaks DLPack."""

    def __init__(self, array, place=(2, 0)):
        self.array, self.place, self.streams = array, place, []

    def __dlpack_device__(self):
        return self.place

    def __dlpack__(self, *, stream=None):
        self.streams.append(stream)
        return self.array.__dlpack__()


class Older:
    """An array that speaks the other protocol."""

    def __init__(self, array, stream=None):
        self.array = array
        self.__cuda_array_interface__ = {**array.__array_interface__, "stream": stream, "version": 3}


def host_view(array):
    """The memory of a borrowed array, which is the host's here."""
    size = int(np.prod(array.shape)) * array.dtype.itemsize
    return np.frombuffer((ctypes.c_char * size).from_address(array.address), array.dtype).reshape(array.shape)


ARRAYS = [
    np.arange(12, dtype=np.float32).reshape(4, 3),
    np.arange(5, dtype=np.int64)[2:],
    np.array([True, False]),
    np.zeros((0, 3)),
    np.arange(3, dtype=np.float32).reshape(1, 3).T[:, :1],
]


@pytest.mark.parametrize("array", ARRAYS, ids=lambda array: f"{array.dtype}{array.shape}")
@pytest.mark.parametrize("protocol", [Foreign, Older])
def test_a_borrowed_array_is_the_same_memory(fake_cuda, array, protocol):
    found = borrow(protocol(array), Cuda(), "origins")
    assert (found.shape, found.dtype) == (array.shape, array.dtype)
    if array.size:
        assert found.address == array.ctypes.data
        np.testing.assert_array_equal(host_view(found), array)


def test_the_producer_is_told_which_stream_will_use_its_array(fake_cuda):
    device, foreign = Cuda(), Foreign(ARRAYS[0])
    borrow(foreign, device, "origins")
    other = device.new_queue()
    borrow(foreign, device, "origins", other)
    assert foreign.streams == [device.queue.handle, other.handle] and len(set(foreign.streams)) == 2


def test_the_stream_of_an_interface_is_waited_for(fake_cuda, monkeypatch):
    device, waits = Cuda(), []
    monkeypatch.setattr(type(device.queue), "wait", lambda queue, event: waits.append(queue.handle))
    borrow(Older(ARRAYS[0], stream=None), device, "origins")
    assert waits == []
    borrow(Older(ARRAYS[0], stream=7), device, "origins")
    assert waits == [device.queue.handle]


def test_a_borrowed_array_lives_as_long_as_it_is_kept(fake_cuda):
    array = np.arange(1000.0)
    found = borrow(Foreign(array.copy()), Cuda(), "origins")
    gc.collect()
    np.testing.assert_array_equal(host_view(found), array)


@pytest.mark.parametrize(
    "value, message",
    [
        (Foreign(ARRAYS[0], (2, 1)), "origins is on cuda:1, and cuda:0 (Fake card) computes; move it, or choose"),
        (Foreign(ARRAYS[0], (10, 0)), "origins is on DLPack device 10:0, and"),
        (ARRAYS[0], "origins is on cpu:0, and"),
        (Foreign(ARRAYS[0].T), "origins is not contiguous; copy it first, in PyTorch by .contiguous()"),
        (Older(ARRAYS[0][:, ::2]), "origins is not contiguous"),
        (Foreign(np.zeros(2, np.complex64)), "origins has elements of a kind that NumPy lacks; convert it"),
    ],
    ids=range(6),
)
def test_an_array_that_cannot_be_used_is_refused_in_one_line(fake_cuda, value, message):
    with pytest.raises(InputError) as error:
        borrow(value, Cuda(), "origins")
    assert str(error.value).startswith(message)


def test_an_array_with_gradients_is_refused_with_the_reason_of_its_library(fake_cuda):
    class Differentiable(Foreign):
        def __dlpack__(self, *, stream=None):
            raise BufferError("Can't export tensors that require gradient, use tensor.detach()")

    with pytest.raises(InputError, match=r"origins cannot be shared: .* use tensor\.detach\(\)"):
        borrow(Differentiable(ARRAYS[0]), Cuda(), "origins")


def test_where_an_array_is(fake_cuda):
    assert place_of(Foreign(ARRAYS[0], (2, 3))) == "cuda:3"
    assert place_of(Older(ARRAYS[0])) == "cuda"
    assert place_of(ARRAYS[0]) is place_of([1.0, 2.0]) is place_of(None) is None


# Results


class Shared(DeviceArray):
    """A result that NumPy takes: it says that it is on the host, where the fake card's memory is."""

    def __dlpack_device__(self):
        return 1, 0


@pytest.mark.parametrize("array", ARRAYS, ids=lambda array: f"{array.dtype}{array.shape}")
def test_another_library_shares_a_result(fake_cuda, array):
    device = Cuda()
    result = Shared(device.upload(array), array.shape, array.dtype, device.queue)
    taken = np.from_dlpack(result)
    assert taken.dtype == array.dtype
    np.testing.assert_array_equal(taken, array)
    np.testing.assert_array_equal(result.numpy(), array)
    if array.size:
        assert taken.ctypes.data == result.memory.address


def test_a_result_lives_as_long_as_another_library_uses_it(fake_cuda):
    device = Cuda()
    taken = np.from_dlpack(Shared(device.upload(ARRAYS[0]), (4, 3), np.float32, device.queue))
    gc.collect()
    assert device.used == ARRAYS[0].nbytes and len(arrays._exported) == 1
    np.testing.assert_array_equal(taken, ARRAYS[0])
    del taken
    gc.collect()
    assert device.used == 0 and not arrays._exported


def test_a_capsule_that_nobody_takes_keeps_nothing(fake_cuda):
    device = Cuda()
    capsule = DeviceArray(device.allocate(12), (3,), np.float32, device.queue).__dlpack__()
    assert len(arrays._exported) == 1
    del capsule
    assert not arrays._exported and device.used == 0


@pytest.mark.parametrize("stream, expected", [(None, [1]), (1, [1]), (2, [2]), (0x55, [0x55]), (-1, [])])
def test_the_consumers_stream_waits_for_a_result(fake_cuda, monkeypatch, stream, expected):
    device, waits = Cuda(), []
    result = DeviceArray(device.allocate(12), (3,), np.float32, device.queue)
    monkeypatch.setattr(type(device.queue), "wait", lambda queue, event: waits.append(queue.handle))
    result.__dlpack__(stream=stream, max_version=(1, 0), dl_device=None, copy=None)
    assert waits == expected
    assert result.__dlpack_device__() == (2, 0)


def test_the_interface_of_a_result_is_given_once_it_is_there(fake_cuda):
    device = Cuda()
    result = DeviceArray(device.upload(ARRAYS[0]), (4, 3), np.float32, device.queue)
    fake_cuda.keep_busy(5)
    interface = result.__cuda_array_interface__
    assert result._queue.record().is_done()  # all five queries were made
    assert interface["data"] == (result.memory.address, False) and interface["typestr"] == "<f4"
    np.testing.assert_array_equal(host_view(borrow(result, device, "it")), ARRAYS[0])


def test_a_copy_is_refused_by_the_protocol(fake_cuda):
    device = Cuda()
    with pytest.raises(BufferError, match=r"shared, not copied; copy it: \.numpy\(\)"):
        DeviceArray(device.allocate(12), (3,), np.float32, device.queue).__dlpack__(copy=True)


def test_a_result_must_fit_in_its_memory(fake_cuda):
    device = Cuda()
    with pytest.raises(ValueError, match="do not fit in 12 bytes"):
        DeviceArray(device.allocate(12), (4,), np.float32, device.queue)
