"""The place of a colour chart in a picture: its corners, in four orientations, and the colours of its patches."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinran.base.files import InputError
from kinran.calibrate.colour_chart import COLUMNS, INSIDE, ROWS

Image = NDArray[np.float32]
Array = NDArray[np.float64]

LEAST_PIXELS = 1
"""Fewest pixels in the middle of a patch; with fewer, the nearest ones are used."""
LEAST_USABLE = 0.9
"""Least share of a patch's middle that is neither saturated nor on a defect: every large patch has some hot pixels, and
one that has a tenth of them is no patch any more. A choice."""
DISPLAY = 2.2
"""Gamma of the picture for the detector, which was made for photographs."""


@dataclass(frozen=True)
class Place:
    """Place of a chart in a picture.

    Attributes
    ----------
    corners : (4, 2)
        x, y in pixels from the bottom left of the picture: the corner at the first patch (dark skin), then on along its
        row and around the chart.
    """

    corners: tuple[tuple[float, float], ...]

    def turned(self, quarters: int) -> "Place":
        """Return the place turned by quarters: corner `quarters` becomes the first."""
        return Place((*self.corners[quarters:], *self.corners[:quarters]))

    @property
    def mirrored(self) -> bool:
        """Whether the corners go around in the opposite sense to those of a chart."""
        (ax, ay), (bx, by), (cx, cy), _ = self.corners
        return (bx - ax) * (cy - by) - (by - ay) * (cx - bx) > 0


def whole(height: int, width: int) -> Place:
    """Return the place of a chart that fills the picture, dark skin at the top left."""
    return Place(((0.0, height), (width, height), (width, 0.0), (0.0, 0.0)))


def parse_corners(text: str, height: int) -> Place:
    """Parse a place ``x,y,x,y,x,y,x,y`` in pixels from the top left: dark skin's corner, then around along its row.

    Raises
    ------
    InputError
        The text is not eight numbers, or they are not a convex quadrilateral.
    """
    try:
        values = [float(word) for word in text.split(",")]
    except ValueError:
        values = []
    if len(values) != 8:
        raise InputError(
            f"corners '{text}': give x,y of four corners from the top left, dark skin's first: eight numbers"
        )
    points = np.array(values).reshape(4, 2)
    points[:, 1] = height - points[:, 1]
    sides = np.roll(points, -1, 0) - points
    turns = sides[:, 0] * np.roll(sides, -1, 0)[:, 1] - sides[:, 1] * np.roll(sides, -1, 0)[:, 0]
    if not ((turns > 0).all() or (turns < 0).all()):
        raise InputError(f"corners '{text}': are not those of a quadrilateral; give them in order around the chart")
    return Place(tuple((float(x), float(y)) for x, y in points))


def find(image: Image) -> Place | None:
    """Find a 24-patch chart in an image (y, x, 3; row 0 at the bottom) by OpenCV's detector, in any orientation.

    The result is None where there is none.
    """
    import cv2

    scale = max(1, round(1000 / max(image.shape[:2])))
    bright = np.clip(image / max(float(np.percentile(image, 99.5)), 1e-12), 0, 1) ** (1 / DISPLAY)
    picture = np.ascontiguousarray((bright[::-1, :, ::-1] * 255).astype(np.uint8))
    picture = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    detector = cv2.mcc.CCheckerDetector.create()
    detector.setColorChartType(cv2.mcc.MCC24)
    if not detector.process(picture, 1):
        return None
    box = np.asarray(detector.getBestColorChecker().getBox(), float).reshape(4, 2) / scale
    return Place(tuple((float(x), float(image.shape[0] - y)) for x, y in box))


def patches(image: Image, usable: NDArray[np.bool_], place: Place) -> tuple[Array, NDArray[np.bool_]]:
    """Return the mean colours of the patches of a chart.

    Parameters
    ----------
    image : (y, x, 3) float32
        Picture; row 0 is the bottom.
    usable : (y, x) bool
        Pixels that can be used.
    place
        Place of the chart.

    Returns
    -------
    colours : (24, 3) float
        Mean colour of the usable pixels in the middle of each patch.
    seen : (24,) bool
        Whether the middle of each patch is in the picture and, but for a tenth, usable.
    """
    height, width = usable.shape
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    homography = _homography(
        np.array([[0, 0], [COLUMNS, 0], [COLUMNS, ROWS], [0, ROWS]], float), np.array(place.corners)
    )
    back = np.linalg.inv(homography) @ np.stack([x.ravel(), y.ravel(), np.ones(x.size)])
    column, row = (back[:2] / back[2]).reshape(2, height, width)
    colours, seen = np.zeros((ROWS * COLUMNS, 3)), np.zeros(ROWS * COLUMNS, bool)
    for k in range(ROWS * COLUMNS):
        r, c = divmod(k, COLUMNS)
        distance = np.maximum(np.abs(row - r - 0.5), np.abs(column - c - 0.5))
        inside = distance <= INSIDE / 2
        if inside.sum() < LEAST_PIXELS:  # a patch of a few pixels: its nearest ones
            inside = distance <= distance.min() + 1e-9
            if distance.min() > 0.5:
                continue
        good = inside & usable
        seen[k] = good.sum() >= LEAST_USABLE * inside.sum()
        colours[k] = image[good if seen[k] else inside].mean(0, dtype=float)
    return colours, seen


def _homography(source: Array, target: Array) -> Array:
    """Return the homography (3, 3) that maps four points (4, 2) to four others (Hartley2004, Eq. 4.1)."""
    rows: list[Sequence[float]] = []
    for (x, y), (u, v) in zip(source, target, strict=True):
        rows.append([x, y, 1, 0, 0, 0, -u * x, -u * y, -u])
        rows.append([0, 0, 0, x, y, 1, -v * x, -v * y, -v])
    return np.asarray(np.linalg.svd(np.array(rows))[2][-1].reshape(3, 3))
