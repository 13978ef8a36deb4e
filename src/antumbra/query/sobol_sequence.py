"""The scrambled Sobol sequence in up to four dimensions, with the points of ``scipy.stats.qmc.Sobol``.

Direction numbers: the first lines of ``new-joe-kuo-6.21201`` [Joe and Kuo 2008], whose licence is at the end of this
file. Scrambling: a random lower triangular matrix and a digital shift for each dimension [Matousek 1998].
"""

import numpy as np
from numpy.typing import NDArray

_BITS = 30  # of a coordinate
_POLYNOMIALS = (1, 0, (1,)), (2, 1, (1, 3)), (3, 1, (1, 3, 1))
"""Of the second dimension and later ones: degree, coefficients, and the first direction numbers m."""

DIMENSIONS = 1 + len(_POLYNOMIALS)


def scrambled_sobol(n: int, dimensions: int, seed: int) -> NDArray[np.float64]:
    """The first n points of a scrambled Sobol sequence, in Gray-code order: (n, dimensions) float64 in [0, 1).

    n : at most 2**30; dimensions : 1 to `DIMENSIONS`; seed : of the scrambling, int >= 0
    """
    generator = np.random.default_rng(seed).spawn(1)[0]  # as scipy does
    shifts = generator.integers(2, size=(dimensions, _BITS), dtype=np.uint32) @ _powers()
    matrices = np.tril(generator.integers(2, size=(dimensions, _BITS, _BITS), dtype=np.uint32), -1)
    matrices += np.eye(_BITS, dtype=np.uint32)
    i = np.arange(n, dtype=np.uint32)
    gray = i ^ i >> 1
    points = np.empty((n, dimensions))
    for axis, (matrix, shift) in enumerate(zip(matrices, shifts)):
        coordinate = np.full(n, shift, np.uint32)
        for k, column in enumerate(_scrambled(_direction_numbers(axis), matrix)):
            coordinate ^= np.where(gray >> k & 1, column, np.uint32(0))
        points[:, axis] = coordinate / 2.0**_BITS
    return points


def _powers() -> NDArray[np.uint32]:
    return np.uint32(1) << np.arange(_BITS, dtype=np.uint32)


def _direction_numbers(axis: int) -> NDArray[np.uint32]:
    """(30,) uint32: the columns of the generator matrix of a dimension, their first row in bit 29."""
    if axis == 0:  # the van der Corput sequence
        return _powers()[::-1]
    degree, coefficients, initial = _POLYNOMIALS[axis - 1]
    m = list(initial)
    for k in range(degree, _BITS):
        number = m[k - degree] ^ m[k - degree] << degree
        for i in range(1, degree):
            if coefficients >> (degree - 1 - i) & 1:
                number ^= m[k - i] << i
        m.append(number)
    return np.array(m, np.uint32) << np.arange(_BITS, dtype=np.uint32)[::-1]


def _scrambled(columns: NDArray[np.uint32], matrix: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """The columns of the product of a scrambling matrix and a generator matrix, modulo 2."""
    rows = np.arange(_BITS, dtype=np.uint32)[::-1]
    bits = columns >> rows[:, None] & 1  # (row, column)
    return np.asarray(((matrix @ bits & 1) << rows[:, None]).sum(0, dtype=np.uint32))


# The licence of the direction numbers:
#
# Copyright (c) 2008, Frances Y. Kuo and Stephen Joe
# All rights reserved.
#
# Redistribution and use in source and binary forms, with or without modification, are permitted provided that the
# following conditions are met:
#
#   - Redistributions of source code must retain the above copyright notice, this list of conditions and the
#     following disclaimer.
#   - Redistributions in binary form must reproduce the above copyright notice, this list of conditions and the
#     following disclaimer in the documentation and/or other materials provided with the distribution.
#   - Neither the names of the copyright holders nor the names of the University of New South Wales and the
#     University of Waikato and its contributors may be used to endorse or promote products derived from this software
#     without specific prior written permission.
#
# THIS SOFTWARE IS PROVIDED BY THE COPYRIGHT HOLDERS "AS IS" AND ANY EXPRESS OR IMPLIED WARRANTIES, INCLUDING, BUT NOT
# LIMITED TO, THE IMPLIED WARRANTIES OF MERCHANTABILITY AND FITNESS FOR A PARTICULAR PURPOSE ARE DISCLAIMED. IN NO EVENT
# SHALL THE COPYRIGHT HOLDERS BE LIABLE FOR ANY DIRECT, INDIRECT, INCIDENTAL, SPECIAL, EXEMPLARY, OR CONSEQUENTIAL
# DAMAGES (INCLUDING, BUT NOT LIMITED TO, PROCUREMENT OF SUBSTITUTE GOODS OR SERVICES; LOSS OF USE, DATA, OR PROFITS; OR
# BUSINESS INTERRUPTION) HOWEVER CAUSED AND ON ANY THEORY OF LIABILITY, WHETHER IN CONTRACT, STRICT LIABILITY, OR TORT
# (INCLUDING NEGLIGENCE OR OTHERWISE) ARISING IN ANY WAY OUT OF THE USE OF THIS SOFTWARE, EVEN IF ADVISED OF THE
# POSSIBILITY OF SUCH DAMAGE.
