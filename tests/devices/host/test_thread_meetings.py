"""Threads of the host device meet at shuffles, votes and barriers; a thread that misses a meeting is an error."""

import numpy as np
import pytest

from antumbra.devices.device import DeviceError
from antumbra.devices.host.host_device import HostDevice
from ptx_snippets import run_snippet


@pytest.fixture(scope="module")
def device():
    return HostDevice()


def test_a_thread_that_ends_before_a_meeting_is_an_error(device):
    code = """
    setp.eq.s32 %p1, %r9, 5;
    @%p1 ret;
    bar.sync 0;"""
    with pytest.raises(DeviceError, match=r"63 threads, such as 0, wait at bar.sync 0;") as raised:
        run_snippet(device, code, np.zeros(64))
    assert "1 threads, such as 5, have ended" in str(raised.value)


def test_threads_of_a_warp_that_meet_at_different_places_are_an_error(device):
    code = """
    setp.lt.s32 %p1, %r9, 7;
    @%p1 bra $left;
    shfl.sync.idx.b32 %r1, %r9, 0, 31, -1;
    bra.uni $done;
    $left:
    shfl.sync.idx.b32 %r2, %r9, 0, 31, -1;
    $done:"""
    with pytest.raises(DeviceError, match=r"do not meet: 25 threads, such as 7, .* 7 threads, such as 0"):
        run_snippet(device, code, np.zeros(32))


def test_a_warp_that_waits_for_a_barrier_does_not_stop_the_others(device):
    code = """
    mov.b64 %rd4, 0;
    setp.ge.s32 %p1, %r9, 32;
    @%p1 bra $wait;
    setp.eq.s32 %p2, %r9, 3;
    vote.sync.ballot.b32 %r1, %p2, -1;
    st.shared.b32 [block], %r1;
    $wait:
    bar.sync 0;
    ld.shared.u32 %rd4, [block];
    st.global.b64 [%rd2], %rd4;"""
    assert set(run_snippet(device, code, np.zeros(64)).tolist()) == {8}


def test_a_missing_barrier_is_noticed(device):
    """Threads go on in another order after each meeting, so a race has another result than the intended one."""
    code = """
    mul.wide.u32 %rd4, %r9, 4;
    mov.b64 %rd5, block;
    add.s64 %rd5, %rd5, %rd4;
    bar.sync 0;
    st.shared.b32 [%rd5], %r9;
    ld.shared.u32 %rd6, [block+252];
    st.global.b64 [%rd2], %rd6;"""
    assert set(run_snippet(device, code, np.zeros(64)).tolist()) != {63}
