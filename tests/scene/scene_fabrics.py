"""What the tests of scene and render share."""

from pathlib import Path

import numpy as np

TEMPLATE = Path(__file__).parents[2] / "scenes/drape.xml"
F = np.array(
    [
        [0, 0, 0, 0, 0, 0],
        [0, 1, 1, 1, 1, 0],
        [0, 1, 0, 0, 0, 0],
        [0, 1, 1, 1, 0, 0],
        [0, 1, 0, 0, 0, 0],
        [0, 1, 0, 0, 0, 0],
        [0, 1, 0, 0, 0, 0],
        [0, 1, 0, 0, 0, 0],
        [0, 0, 0, 0, 0, 0],
    ]
)[::-1]  # as read: row 0 of a map is the bottom
