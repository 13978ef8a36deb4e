"""Parts on a device: those that are there come first, the least recently used ones leave, and the limit holds."""

import numpy as np
import pytest

from antumbra.bvh import binned_sah
from antumbra.bvh.block_tree import block_tree
from antumbra.bvh.compact_tree import compact, expand, expanded_bytes
from antumbra.bvh.nodes import aligned_empty
from antumbra.devices.device import OutOfDeviceMemory
from antumbra.techniques.chcrt import device_residency
from antumbra.techniques.chcrt.device_residency import DeviceResidency
from antumbra.trace.device.part_trees import part_bvh
from bvh_scenes import scattered
from devices import opened

PARTS, ROOM = 12, 4


def _tree(n):
    tree = compact(block_tree(binned_sah.build(scattered(n), 1), 1))
    return expand(tree, aligned_empty((expanded_bytes(len(tree.nodes)),), "u1"))


class HostParts:
    """Parts that come to the memory of the host in groups of five, if they are still needed."""

    def __init__(self):
        self.brought, self.questions, self.marks, self.held, self.asked = [], 0, set(), set(), []

    def __contains__(self, k):
        return k in self.held

    def begin_question(self):
        self.questions += 1

    def groups(self, parts, still, mark):
        self.marks.add(mark)
        self.asked.append(parts.tolist())
        for first in range(0, len(parts), 5):
            group = parts[first : first + 5]
            group = group[still(group)]
            if len(group):
                self.brought += group.tolist()
                yield group


@pytest.fixture
def cache():
    tree, host = _tree(200), HostParts()
    one = DeviceResidency(opened("host"), host, lambda k: tree, PARTS, 1 << 40)
    list(one.groups(np.array([0], np.int32), _all, None))
    size = one.used
    one.close()
    there = DeviceResidency(opened("host"), host, lambda k: tree, PARTS, ROOM * size)
    host.brought.clear()
    host.asked.clear()
    there.host = host
    yield there
    there.close()
    assert there.used == there.device.used == 0


def _all(parts):
    return np.ones(len(parts), bool)


def _asked(cache, parts, still=_all):
    """The groups in which parts come; in each, all of them are on the device, within the limit."""
    groups = []
    for group in cache.groups(np.array(parts, np.int32), still, None):
        assert all(k in cache and cache.trees[k].all() for k in group) and cache.used <= cache.budget
        groups.append(group.tolist())
    return groups


def test_parts_on_the_device_come_first_and_the_others_in_their_order(cache):
    assert _asked(cache, [3, 1, 2]) == [[3, 1, 2]]
    assert _asked(cache, [5, 2, 3]) == [[2, 3], [5]]
    assert cache.host.brought == [3, 1, 2, 5]
    assert cache.traffic[:4] == (6, 2, 4, 0) and cache.traffic.bytes > cache.traffic.bvh_bytes > 0


def test_the_least_recently_used_parts_leave(cache):
    _asked(cache, [0, 1, 2, 3])
    _asked(cache, [0, 2])
    _asked(cache, [7, 8])
    assert [k for k in range(PARTS) if k in cache] == [0, 2, 7, 8] and cache.traffic.evicted == 2
    assert not cache.trees[[1, 3]].any()


def test_more_parts_than_fit_come_in_several_groups(cache):
    groups = _asked(cache, list(range(PARTS)))
    assert [k for group in groups for k in group] == list(range(PARTS)) and max(map(len, groups)) == ROOM
    assert _asked(cache, list(range(PARTS)))[0] == [k for k in range(PARTS) if k >= PARTS - ROOM]


def test_parts_that_nothing_needs_any_more_are_not_uploaded(cache):
    assert _asked(cache, [0, 1, 2, 3], lambda parts: np.asarray(parts) % 2 == 1) == [[1, 3]]
    assert cache.traffic.uploaded == 2
    cache.begin_question()
    assert cache.host.questions == 1


def test_few_parts_are_read_ahead_after_those_in_the_memory_of_the_host(cache, monkeypatch):
    monkeypatch.setattr(device_residency, "_AHEAD", 3)
    cache.host.held = {6, 9}
    groups = _asked(cache, list(range(10)), lambda parts: ~np.isin(parts, [4, 7, 8]))
    assert cache.host.asked == [[6, 9, 0, 1, 2], [3, 5]]
    assert [k for group in groups for k in group] == [6, 9, 0, 1, 2, 3, 5]


def test_a_lower_limit_holds_from_the_next_frame_on(cache):
    _asked(cache, [0, 1, 2, 3])
    cache.budget //= 2
    cache.trim()
    assert [k for k in range(PARTS) if k in cache] == [2, 3]


def test_a_part_above_the_limit_is_refused(cache):
    cache.budget = 1000
    with pytest.raises(OutOfDeviceMemory, match=r"a part of the scene needs .* may take 1\.0 kB there; build"):
        _asked(cache, [0])
    assert cache.used == 0


def test_parts_leave_if_others_have_taken_the_memory(cache):
    _asked(cache, [0, 1, 2])
    size = cache.used // 3
    cache.device.max_memory = cache.device.used + size // 2
    assert _asked(cache, [5]) == [[5]] and 0 not in cache and 1 in cache
    cache.close()
    cache.device.max_memory = size // 2
    with pytest.raises(OutOfDeviceMemory, match=r"a part of the scene needs .* max_memory"):
        _asked(cache, [6])


def test_parts_leave_for_other_memory_but_those_that_are_being_traced_stay(cache):
    _asked(cache, [0, 1, 2, 3])
    size, groups = cache.used // 4, cache.groups(np.array([1, 2, 7], np.int32), _all, None)
    assert next(groups).tolist() == [1, 2]
    assert cache.evict(size) and [k for k in range(4) if k in cache] == [1, 2, 3]
    assert cache.evict(9 * size) and [k for k in range(4) if k in cache] == [1, 2]
    assert not cache.evict(1) and cache.traffic.evicted == 2
    assert next(groups).tolist() == [7] and not cache.evict(0)
    assert cache.evict(size) and 7 in cache and 1 not in cache
    groups.close()
    assert cache.evict(9 * size) and not cache.used


def test_empty_and_tiny_parts_are_trees_too():
    trees = {0: _tree(0), 1: _tree(1), 2: _tree(17)}
    cache = DeviceResidency(opened("host"), HostParts(), trees.__getitem__, 3, 1 << 20)
    list(cache.groups(np.arange(3, dtype=np.int32), _all, None))
    for k, tree in trees.items():
        bvh = part_bvh(cache.trees[k], cache.device)
        assert len(bvh.prim_ids) == len(tree.prim_ids)
        np.testing.assert_array_equal(bvh.corners, tree.corners)
    cache.close()
