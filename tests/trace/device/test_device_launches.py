"""Memory for launches: blocks that are kept, and caches that leave for them."""

import numpy as np
import pytest

from antumbra.devices.device import OutOfDeviceMemory
from antumbra.trace.device.device_launches import DeviceLaunches
from devices import DEVICES, opened


@pytest.fixture(params=DEVICES)
def device(request):
    return opened(request.param, 1 << 20)


def test_a_cache_leaves_for_blocks_and_uploads_until_it_is_empty(device):
    launches, cache, freed = DeviceLaunches(device), [device.allocate(1 << 18) for _ in range(4)], []

    def evict(size):
        freed.append(size)
        if cache:
            cache.pop().free()
            return True
        return False

    launches.evict = evict
    first = launches.block("first", 1000, "a block")
    assert freed == [1000] and len(cache) == 3 and first.size == 1000
    array = np.arange(100_000, dtype=np.float32)
    upload = launches.upload(array, "an array")
    assert len(cache) == 2 and freed[1:] == [400_000 + 1000 - (1 << 18)]
    np.testing.assert_array_equal(upload.read(np.empty_like(array)), array)
    with pytest.raises(OutOfDeviceMemory, match="a large block needs"):
        launches.block("large", 1 << 20, "a large block")
    assert not cache and launches.block("first", 1000, "a block") is first


def test_without_a_cache_memory_ends_at_the_limit(device):
    launches = DeviceLaunches(device)
    with pytest.raises(OutOfDeviceMemory, match="a block needs"):
        launches.block("a", (1 << 20) + 1, "a block")
    assert launches.block("a", 1 << 20, "a block").size == 1 << 20


def test_freed_blocks_are_made_again_and_triangles_sent_again(device):
    launches, triangles = DeviceLaunches(device), np.arange(18, dtype=np.float32).reshape(2, 9)
    launches.kept_triangles(triangles)
    used = device.used
    launches.block("more", 1000, "a block")
    launches.free_blocks()
    assert device.used == used - triangles.nbytes
    launches.kept_triangles(triangles)
    found = launches.block("triangles of the scene", 0, "").read(np.empty((2, 9), np.float32))
    np.testing.assert_array_equal(found, triangles)
