"""Directions that lie apart."""

import numpy as np

from kinran.base import frames
from kinran.base.apart import spread

LIGHTS = frames.direction(*np.radians(np.mgrid[10:81:10, 0:360:30].reshape(2, -1)))


def nearest(use: np.ndarray) -> float:
    s = frames.slopes(LIGHTS[use])
    return float((np.linalg.norm(s[:, None] - s, axis=-1) + 9 * np.eye(len(use))).min())


def test_farther_apart_than_as_they_come() -> None:
    few, more = spread(LIGHTS, 8), spread(LIGHTS, 16)
    np.testing.assert_array_equal(more[:8], few)
    assert len(set(more)) == 16
    assert nearest(more) > 1.5 * nearest(np.arange(16))
    assert len(spread(LIGHTS, 1000)) == len(LIGHTS)


def test_apart_from_what_is_taken() -> None:
    """What goes on from the first eight is what sixteen would have been."""
    more = spread(LIGHTS, 16)
    np.testing.assert_array_equal(spread(LIGHTS, 8, LIGHTS[more[:8]]), more[8:])
