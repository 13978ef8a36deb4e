"""Rays as the kernels of devices read them, and packed receivers."""

import numpy as np
import pytest

from antumbra.kernels.parallel import new_ticket
from antumbra.query.receivers import FREE, NOTHING
from antumbra.trace.device.device_rays import AGAIN, BLOCKED, CLEAR, SIDE, TRACED, pack_receivers


@pytest.mark.parametrize("side", [-1, NOTHING, 1, FREE])
def test_a_receiver_takes_16_bytes_with_its_side_and_its_face(side):
    faces, origins = np.array([[-1, 0, 1, (1 << 29) - 1]], np.int32), np.arange(12, dtype=np.float32).reshape(1, 4, 3)
    out = np.empty((4, 4), np.float32)
    pack_receivers(new_ticket(4, 4), origins, faces, np.full((1, 4), side, np.int8), out)
    tags = out.view(np.int32)[:, 3]
    np.testing.assert_array_equal(out[:, :3], origins[0])
    np.testing.assert_array_equal(tags >> 2, faces[0])
    np.testing.assert_array_equal((tags & SIDE) - 1, side)


def test_states_and_slots_do_not_collide():
    assert len({CLEAR, BLOCKED, TRACED, AGAIN}) == 4 and AGAIN < -1  # slots of hits are not negative; no hit is -1
