"""What only devices have works on each of them: indices, lanes, meetings, memory and exact arithmetic."""

from fractions import Fraction

import numpy as np
import pytest

import device_kernels as sample
from devices import DEVICES, launch, opened


@pytest.fixture(params=DEVICES)
def device(request):
    return opened(request.param)


def run(device, kernel, arrays, threads, *numbers, **options):
    """Run a kernel with copies of arrays in the device's memory; what the arrays are afterwards."""
    blocks = [device.upload(array) for array in arrays]
    arguments = [block.address for block in blocks]
    if kernel is sample.FLOATS:
        arguments = [sample.Arrays(*arguments, *numbers)]
        numbers = ()
    launch(device, kernel, [*arguments, *numbers], threads, **options)
    return [block.read(np.empty_like(array)) for block, array in zip(blocks, arrays)]


def numbers(kind, exponents, n=10_000, seed=3):
    """Numbers of all magnitudes, subnormal ones and infinite results among them."""
    rng = np.random.default_rng(seed)
    with np.errstate(over="ignore"):
        return np.ldexp(rng.random((2, n)) - 0.5, rng.integers(-exponents, exponents, (2, n))).astype(kind)


@pytest.mark.parametrize("block", [32, 128])
def test_every_thread_has_a_place_of_its_own(device, block):
    (places,) = run(device, sample.PLACES, [np.zeros((4 * block, 6), np.int64)], 4 * block, block=block)
    thread, index, size, own, lane, lanes = places.T
    assert thread.tolist() == list(range(4 * block))
    assert index.tolist() == (thread // block).tolist() and own.tolist() == (thread % block).tolist()
    assert set(size) == {block}
    (width,) = set(lanes.tolist())
    assert width in (1, 2, 4, 8, 16, 32, 64) and lane.tolist() == (own % width).tolist()


def test_the_last_block_is_complete(device):
    (places,) = run(device, sample.PLACES, [np.full((256, 6), -1, np.int64)], 129, block=128)
    assert places[:, 0].tolist() == list(range(256))


def test_float32_operations_are_those_of_numpy(device):
    (a, b), scale = numbers(np.float32, 140), np.float32(0.3)
    got = run(device, sample.FLOATS, [a, b, np.zeros((len(a), 5), np.float32)], len(a), len(a), scale)[2]
    with np.errstate(all="ignore"):
        expected = np.stack([a + b, a - b, a * b, a / b], 1)
    assert (got[:, :4].view(np.int32) == expected.view(np.int32)).all()
    assert np.isinf(expected).any() and (expected == 0).any() and (np.abs(expected) < 1e-38).any()


def test_fused_float32_operations_round_once(device):
    """A fused result is the float32 nearest to the exact sum, so its neighbours are not nearer."""
    (a, b), scale = numbers(np.float32, 20, 500), np.float32(0.3)
    got = run(device, sample.FLOATS, [a, b, np.zeros((len(a), 5), np.float32)], len(a), len(a), scale)[2][:, 4]
    twice = a * b + scale
    for x, y, fused in zip(a, b, got):
        exact = Fraction(float(x)) * Fraction(float(y)) + Fraction(float(scale))
        near = [np.nextafter(fused, np.float32(to)) for to in (-np.inf, np.inf)]
        assert all(abs(Fraction(float(fused)) - exact) <= abs(Fraction(float(each)) - exact) for each in near)
    assert (got != twice).any()


def test_float64_operations_are_those_of_numpy(device):
    a, b = numbers(np.float64, 200)
    got = run(device, sample.DOUBLES, [a, b, np.zeros((len(a), 6))], len(a), len(a))[2]
    expected = np.stack([a + b, a - b, a * b, a / b, got[:, 4], np.sqrt(np.abs(a))], 1)
    assert (got.view(np.int64) == expected.view(np.int64)).all()
    for x, y, product, error in zip(a[:99], b[:99], got[:99, 2], got[:99, 4]):
        assert Fraction(x) * Fraction(y) == Fraction(product) + Fraction(error)


def test_stacks_vectors_bytes_and_atomics_work_together(device):
    """Each thread finds itself in a traversal, as the same traversal in Python does."""
    n = 60
    boxes = np.random.default_rng(4).random((n, 4), np.float32)
    memory = [device.upload(array) for array in (boxes, np.zeros(n, np.uint8), np.zeros(1, np.int64))]
    there, order, visits = memory
    launch(device, sample.LINKS, [there.address, order.address, n, visits.address], n)
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


def test_an_atomic_minimum_is_that_of_all_threads(device):
    numbers = np.random.default_rng(5).integers(-(2**31), 2**31, 5000).astype(np.int32)
    found = run(device, sample.LEAST, [numbers, np.full(7, 2**31 - 1, np.int32)], len(numbers), len(numbers), 7)[1]
    assert found.tolist() == [numbers[k::7].min() for k in range(7)]


@pytest.mark.parametrize("block", [32, 64, 256])
def test_a_barrier_shows_all_threads_what_others_wrote_before_it(device, block):
    numbers = np.arange(512, dtype=np.int32)
    out = run(device, sample.REVERSED, [numbers, np.zeros_like(numbers)], 512, block=block)[1]
    assert out.tolist() == numbers.reshape(-1, block)[:, ::-1].ravel().tolist()


@pytest.mark.parametrize("block", [32, 96])
def test_votes_and_shuffles_are_of_the_lanes_of_a_subgroup(device, block):
    numbers = np.random.default_rng(1).integers(0, 9, 4 * block).astype(np.int32)
    (places,) = run(device, sample.PLACES, [np.zeros((len(numbers), 6), np.int64)], len(numbers), block=block)
    lanes = places[0, 5]
    empty = np.zeros(len(numbers), np.int64), np.zeros_like(numbers)
    _, bits, neighbours = run(device, sample.VOTES, [numbers, *empty], len(numbers), block=block)
    for first in range(0, len(numbers), lanes):
        odd = [int(number) & 1 for number in numbers[first : first + lanes]]
        assert set(bits[first : first + lanes].tolist()) == {sum(bit << lane for lane, bit in enumerate(odd))}
        assert neighbours[first : first + lanes].tolist() == np.roll(numbers[first : first + lanes], -1).tolist()


def test_meetings_of_several_kinds_in_one_kernel(device):
    numbers = np.random.default_rng(2).integers(0, 99, 1024).astype(np.int32)
    total = run(device, sample.ODDS, [numbers, np.zeros(1, np.int64)], 1024)[1]
    assert total[0] == (numbers & 1).sum() > 0
