"""Where the names of the dots of a plot stand, so that none covers another."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from kinran.base.drawing.canvas import Point

RINGS = (11, 16, 22, 30, 40, 52, 66, 82, 100)
"""Distances from a dot, in pixels, at which a place for its name is looked for."""
TURNS = 16
"""Places on each ring."""
CHARACTER, HEIGHT = 6.2, 14
"""Width and height of a character, in pixels."""
COVERED, OUTSIDE = 20, 1e5
"""What a square pixel that is covered, and a name outside the plot, cost beside a pixel of distance from the dot."""

Box = tuple[float, float, float, float]
"""Left, top, right and bottom."""


def place(name: str, at: Point, taken: Sequence[Box], inside: Box) -> Box:
    """Box for a name near its dot: where it covers least of what is `taken`, and then where it is nearest."""
    boxes = _around(at, CHARACTER * len(name))
    outside = (boxes[:, :2] < inside[:2]).any(1) | (boxes[:, 2:] > inside[2:]).any(1)
    distance = np.linalg.norm(np.clip(at, boxes[:, :2], boxes[:, 2:]) - at, axis=1)
    best = np.argmin(COVERED * covered(boxes, taken) + OUTSIDE * outside + distance)
    left, top, right, bottom = boxes[best].tolist()
    return left, top, right, bottom


def covered(boxes: NDArray[np.float64], taken: Sequence[Box]) -> NDArray[np.float64]:
    """Square pixels that each of the boxes (n, 4) covers of those that are taken."""
    others = np.asarray(taken, float).reshape(-1, 4)
    sides = np.minimum(boxes[:, None, 2:], others[:, 2:]) - np.maximum(boxes[:, None, :2], others[:, :2])
    areas: NDArray[np.float64] = np.maximum(sides, 0).prod(-1).sum(1)
    return areas


def _around(at: Point, width: float) -> NDArray[np.float64]:
    """Boxes (n, 4) around a dot in which a name of this width may stand, the nearest first."""
    angle = np.linspace(0, 2 * np.pi, TURNS, endpoint=False)
    cosine, sine, radius = np.cos(angle), np.sin(angle), np.array(RINGS)[:, None]
    left = (at[0] + radius * cosine - width * (1 - cosine) / 2).ravel()
    top = (at[1] + radius * sine - HEIGHT / 2).ravel()
    return np.stack([left, top, left + width, top + HEIGHT], 1)
