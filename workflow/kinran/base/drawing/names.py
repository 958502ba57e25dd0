"""Placement of the names beside the dots of a plot, so that none covers another."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from kinran.base.drawing.canvas import Point

RINGS = (11, 16, 22, 30, 40, 52, 66, 82, 100)
"""Distances from a dot, in pixels, at which places for its name are tried."""
TURNS = 16
"""Places that are tried on each ring."""
CHARACTER, HEIGHT = 6.2, 14
"""Width and height of a character, in pixels."""
COVERED, OUTSIDE = 20, 1e5
"""Cost of a covered square pixel, and of a name outside the plot, where a pixel of distance costs 1: a choice."""

Box = tuple[float, float, float, float]
"""Left, top, right and bottom."""


def place(name: str, at: Point, taken: Sequence[Box], inside: Box) -> Box:
    """Return the box of a name near its dot: the place that covers least of the boxes `taken`, and is nearest then."""
    boxes = _around(at, CHARACTER * len(name))
    outside = (boxes[:, :2] < inside[:2]).any(1) | (boxes[:, 2:] > inside[2:]).any(1)
    distance = np.linalg.norm(np.clip(at, boxes[:, :2], boxes[:, 2:]) - at, axis=1)
    best = np.argmin(COVERED * covered(boxes, taken) + OUTSIDE * outside + distance)
    left, top, right, bottom = boxes[best].tolist()
    return left, top, right, bottom


def covered(boxes: NDArray[np.float64], taken: Sequence[Box]) -> NDArray[np.float64]:
    """Return the area (n,), in square pixels, that each of the boxes (n, 4) covers of those `taken`."""
    others = np.asarray(taken, float).reshape(-1, 4)
    sides = np.minimum(boxes[:, None, 2:], others[:, 2:]) - np.maximum(boxes[:, None, :2], others[:, :2])
    areas: NDArray[np.float64] = np.maximum(sides, 0).prod(-1).sum(1)
    return areas


def _around(at: Point, width: float) -> NDArray[np.float64]:
    """Return the boxes (n, 4) that are tried around a dot for a name of this width, the nearest first."""
    angle = np.linspace(0, 2 * np.pi, TURNS, endpoint=False)
    cosine, sine, radius = np.cos(angle), np.sin(angle), np.array(RINGS)[:, None]
    left = (at[0] + radius * cosine - width * (1 - cosine) / 2).ravel()
    top = (at[1] + radius * sine - HEIGHT / 2).ravel()
    return np.stack([left, top, left + width, top + HEIGHT], 1)
