"""Every compiled function of the merge, called once for the types it is called with."""

import sys

import numpy as np

from kinran.bracket.estimator import estimate_rows, ratio_sums
from kinran.bracket.superpixels import combine, fill
from kinran.data.calibration import Response


def compile_all(exposures: int) -> None:
    """Compile them into Numba's cache, the loop over exposures for that number of frames in a bracket."""
    planes, black = np.zeros((max(exposures, 2), 4, 1, 1), np.uint16), np.zeros((max(exposures, 2), 4, 1))
    seconds = np.ones((len(planes), 1))
    sites = estimate_rows(planes[:exposures], black[:exposures], seconds[:exposures], Response(1000, 1, 1), 0, 1)
    rate, flags = np.zeros((1, 1, 3), np.float32), np.zeros((1, 1, 3), np.uint8)
    combine(*sites, rate, rate.copy(), flags)
    fill(rate, flags, np.zeros((0, 3), np.intp))
    ratio_sums(planes, black, 0, 1000.0)


if __name__ == "__main__":
    for word in sys.argv[1:]:
        compile_all(int(word))
