"""A query traced window by window, so that the tests of ray bundles belong to a part of the picture."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np

from ..engine.accelerator import Accelerated, Accelerator
from ..query.shadow_query import ShadowQuery, with_receivers
from ..trace.counters import BOX_TESTS, TRIANGLE_TESTS, new_counters

WINDOW = 16  # pixels; no ray bundle crosses the border of a window


def trace_windows(
    accelerator: Accelerator, accelerated: Accelerated, query: ShadowQuery
) -> tuple[np.ndarray, np.ndarray]:
    """Trace a query window by window: (bits, tests); tests: (rows, columns, 2) int64, box and triangle tests.

    Windows begin at multiples of 16 pixels, so they contain whole 4 x 4 blocks of interleaved samples. The bits
    therefore equal the bits of the query traced as a whole.
    """
    h, w = query.sides.shape
    rows, columns = -(-h // WINDOW), -(-w // WINDOW)
    bits = np.zeros((h, w, -(-query.samples.shape[1] // 64)), np.uint64)
    tests, alone = np.zeros((rows, columns, 2), np.int64), Accelerator(accelerator.plan, 1)

    def trace(window):
        y, x = divmod(window, columns)
        part = slice(y * WINDOW, (y + 1) * WINDOW), slice(x * WINDOW, (x + 1) * WINDOW)
        tally = new_counters()
        bits[part] = alone.answer(accelerated, with_receivers(query, lambda array: array[part]), tally)
        tests[y, x] = tally[[BOX_TESTS, TRIANGLE_TESTS]]

    with ThreadPoolExecutor(accelerator.threads) as pool:
        list(pool.map(trace, range(rows * columns)))
    return bits, tests
