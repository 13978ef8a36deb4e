"""The warm-ups of studies, which `work.warm_ups` lists with all others."""

import numpy as np

from ..engine.precompilation import WarmUp, fixed_warm_up
from ..query.receivers import Receivers
from .sight.least_heights import least_heights_warm_up
from .sight.mutual_horizons import hidden_by_horizons
from .skyline.skyline import skyline_warm_up
from .sun.sun_tally import tally_warm_up
from .tables.bit_matrices import reorder_bits


def matrices_warm_up() -> WarmUp:
    """The warm-up of visibility matrices, without tracing."""

    def work() -> None:
        up = np.array([[0.0, 1.0, 0.0]])
        ends = Receivers.on_surface(np.zeros((1, 3)), up, np.zeros(3))
        hidden_by_horizons(ends, ends, 1)
        reorder_bits(np.zeros((1, 1), np.uint64), np.zeros(1, np.int64), 1)

    return fixed_warm_up("visibility matrices", work)


WARM_UPS = tally_warm_up, skyline_warm_up, least_heights_warm_up, matrices_warm_up
"""Functions that return them."""
