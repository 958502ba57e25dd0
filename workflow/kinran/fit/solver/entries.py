"""Every compiled function that is called from Python, called once for the types it is called with."""

import numpy as np

from kinran.fit.solver.facets import facets
from kinran.fit.solver.fused import fit_block
from kinran.fit.solver.hessian import covariances
from kinran.fit.solver.lobes import DIFFUSE_SIZE, GGX, LOBE_SIZE
from kinran.fit.solver.peaks import peaks
from kinran.fit.solver.rows import LANES
from kinran.fit.solver.start import pair
from kinran.fit.solver.sums import summed
from kinran.fit.solver.turn import SINGLE, turn

SIZE = LOBE_SIZE + DIFFUSE_SIZE


def compile_all() -> None:
    """Compile them into Numba's cache."""
    single, double = np.zeros((1, 3, 1), np.float32), np.zeros((1, 3))
    shapes, colours, weights = np.zeros((1, SIZE)), np.zeros((1, 2, 3)), np.ones((1, 1), np.float32)
    rows = np.zeros((6, LANES), np.float32)
    nothing, dark = np.zeros((1, SIZE)), np.zeros(1, bool)
    fit_block(
        GGX,
        1,
        True,
        single,
        weights,
        rows[:2],
        rows[2:5],
        rows[5],
        np.full(1, 0.02),
        2.0,
        nothing,
        nothing,
        dark,
        1,
        1,
        1e-3,
        False,
        shapes,
        colours,
        np.zeros(1),
    )
    facets(single, weights, np.zeros((3, 1)), np.zeros((1, 3)))
    summed(GGX, shapes, colours, np.zeros((1, 2)), double, single)
    one = np.zeros((1, 1))
    peaks(shapes, one, np.zeros((1, 2)), single, weights, weights, np.zeros(1), one, one)
    total = SIZE + 6
    covariances(GGX, shapes, colours, single, weights, np.zeros((1, 2)), double, nothing, np.zeros((1, total, total)))
    pair(np.zeros(2 * LOBE_SIZE + DIFFUSE_SIZE))
    words = np.zeros((1, 1), np.uint64)
    turn(words, words, SINGLE, np.zeros(256, np.float32), np.zeros((4, 1), np.float32), np.zeros((8, 1), np.float32))


if __name__ == "__main__":
    compile_all()
