"""Rays as the kernels of devices read them, and the tags of receivers."""

import numpy as np
import pytest

from antumbra.query.receivers import FREE, NOTHING
from antumbra.trace.device.device_rays import AGAIN, BLOCKED, CLEAR, SIDE, TRACED
from antumbra.trace.device.device_tracer import receiver_tags


@pytest.mark.parametrize("side", [-1, NOTHING, 1, FREE])
def test_a_tag_holds_the_side_and_the_face_of_a_receiver(side):
    faces = np.array([-1, 0, 1, (1 << 29) - 1], np.int32)
    tags = receiver_tags(faces, np.full(4, side, np.int8))
    assert tags.dtype == np.int32
    np.testing.assert_array_equal(tags >> 2, faces)
    np.testing.assert_array_equal((tags & SIDE) - 1, side)


def test_states_and_slots_do_not_collide():
    assert len({CLEAR, BLOCKED, TRACED, AGAIN}) == 4 and AGAIN < -1  # slots of hits are not negative; no hit is -1
