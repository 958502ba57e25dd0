"""Samples turned from images to texels, compiled."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

RUN = 128
"""Lights that the reordering takes at a time: what it reads of their images, it finds in the cache again."""
SINGLE = np.arange(2**16, dtype=np.uint16).view(np.float16).astype(np.float32)
"""Single precision of each float16, by its bits."""


@njit(cache=True, nogil=True, error_model="numpy")
def turn(
    values: NDArray[np.uint64],
    bits: NDArray[np.uint64],
    single: NDArray[np.float32],
    weight_of: NDArray[np.float32],
    T: NDArray[np.float32],
    W: NDArray[np.float32],
) -> None:
    """Turn samples, four in a word of `values` (light, word), and flags, eight in one of `bits`, round.

    A word is read once, as reading down the lights is what costs: each is a page away from the last.
    """
    two, one = np.uint64(0xFFFF), np.uint64(0xFF)
    for first in range(0, len(values), RUN):
        last = min(first + RUN, len(values))
        for word in range(values.shape[1]):
            a, b, c, d = T[4 * word], T[4 * word + 1], T[4 * word + 2], T[4 * word + 3]
            for i in range(first, last):
                v = values[i, word]
                a[i], b[i] = single[v & two], single[(v >> np.uint64(16)) & two]
                c[i], d[i] = single[(v >> np.uint64(32)) & two], single[v >> np.uint64(48)]
        for word in range(bits.shape[1]):
            for k in range(0, 8, 4):
                a, b, c, d = W[8 * word + k], W[8 * word + k + 1], W[8 * word + k + 2], W[8 * word + k + 3]
                for i in range(first, last):
                    v = bits[i, word] >> np.uint64(8 * k)
                    a[i], b[i] = weight_of[v & one], weight_of[(v >> np.uint64(8)) & one]
                    c[i], d[i] = weight_of[(v >> np.uint64(16)) & one], weight_of[(v >> np.uint64(24)) & one]
