"""Rectification: what a plane leaves, and what the height leaves."""

import json
from pathlib import Path

import cv2
import numpy as np
import plate
import pytest
from register_session import Session
from scipy.ndimage import fourier_shift

from kinran.base.exr import read_exr
from kinran.base.files import InputError
from kinran.register import cameras, rectify
from kinran.register.rectify import Grid


@pytest.fixture(scope="module")
def found(session: Session) -> cameras.Cameras:
    return cameras.calibrate(session.board.points, session.corners, plate.WIDTH, plate.HEIGHT).cameras


def surface_of(folder: Path) -> tuple[Grid, np.ndarray]:
    height = read_exr(folder / "height.exr")["height"]
    texel = json.loads((folder / "register.json").read_text())["texel_mm"]
    return Grid(height.shape[1], height.shape[0], texel), height


def misplaced(session: Session, found: cameras.Cameras, view: int, grid: Grid, height: np.ndarray) -> np.ndarray:
    """Distance in mm between each texel and the place of the fabric that the view is read at for it."""
    texels = grid.surface(height)[::8, ::8].reshape(-1, 3)
    there = plate.see(session.views[view], found.project(view, texels))
    return np.linalg.norm((there - texels)[:, :2], axis=1)


def test_a_plane_leaves_millimetres_at_60_degrees(session: Session, registered: Path) -> None:
    """Takeda2008, §2.3: a homography from the frame, which is exact for the frame, is over 1 mm off on the fabric."""
    grid, _ = surface_of(registered)
    x, y = (a.ravel() for a in np.meshgrid(grid.x[::8], grid.y[::8]))
    fabric = np.stack([x, y, plate.height(x, y)], -1)
    for view in (3, 4, 5):
        corners = session.corners[view]
        matrix, _ = cv2.findHomography(corners.pixels, session.board.points[corners.ids, :2])
        flat = cv2.perspectiveTransform(plate.project(session.views[view], fabric)[:, None], matrix)[:, 0]
        error = np.linalg.norm(flat - fabric[:, :2], axis=1)
        assert error.mean() > 1.0
        assert np.percentile(error, 95) > 2.0


def test_calibrated_cameras_alone_do_not_cure_it(session: Session, found: cameras.Cameras, registered: Path) -> None:
    grid, height = surface_of(registered)
    for view in (3, 4, 5):
        assert misplaced(session, found, view, grid, np.zeros_like(height)).mean() > 1.0


def test_height_cures_it(session: Session, found: cameras.Cameras, registered: Path) -> None:
    """At 60°: mean under 0.03 mm, p95 under 0.1 mm, with a camera of 0.1 mm a pixel."""
    grid, height = surface_of(registered)
    for view in range(len(session.views)):
        error = misplaced(session, found, view, grid, height)
        assert error.mean() < 0.03
        assert np.percentile(error, 95) < 0.1


def test_a_picture_is_read_where_its_pixels_are(session: Session, found: cameras.Cameras) -> None:
    """A picture whose values are its own pixel positions comes back as the projection, to the pixel's centre."""
    grid = Grid(40, 30, 1.0)
    height = plate.height(*np.meshgrid(grid.x, grid.y))
    rows, columns = np.mgrid[0 : plate.HEIGHT, 0 : plate.WIDTH].astype(np.float32) + 0.5
    for view in (0, 4):
        ramp = rectify.rectify(found, view, np.stack([columns, rows], -1), grid, height)
        expected = plate.project(session.views[view], grid.surface(height)).reshape(30, 40, 2)
        assert np.abs((ramp - expected).mean((0, 1))).max() < 0.06  # half a pixel is what a wrong convention costs
    assert expected[0, 0, 1] > expected[-1, 0, 1]  # row 0 is the lowest, lower pixels count higher


@pytest.mark.parametrize(("shift", "bound"), [((0.3, -0.4), 0.05), ((3.4, -1.3), 0.15)])
def test_a_known_shift_is_measured(shift: tuple[float, float], bound: float) -> None:
    """To a twentieth of a texel where it is small; OpenCV's estimate, fully whitened, is off by more than a tenth."""
    rng = np.random.default_rng(9)
    texture = cv2.GaussianBlur(rng.standard_normal((400, 400)).astype(np.float32), (0, 0), 0.8)
    moved = np.fft.ifft2(fourier_shift(np.fft.fft2(texture), shift[::-1])).real.astype(np.float32)
    one, other = (a + 0.01 * rng.standard_normal(a.shape).astype(np.float32) for a in (texture, moved))
    lengths = rectify.shifts(one, other, 1.0)
    assert len(lengths) == 64
    np.testing.assert_allclose(lengths, np.hypot(*shift), atol=bound)
    window = cv2.createHanningWindow((64, 64), cv2.CV_32F)
    misses = []
    for y in range(0, 336, 48):
        p, q = (
            np.ascontiguousarray(a[y : y + 64, y : y + 64] - a[y : y + 64, y : y + 64].mean()) for a in (one, other)
        )
        misses.append(abs(np.hypot(*cv2.phaseCorrelate(p, q, window)[0]) - np.hypot(*shift)))
    assert np.median(misses) > 0.1


def test_patches_with_nothing_in_common_are_not_measured() -> None:
    rng = np.random.default_rng(9)
    one, other = (cv2.GaussianBlur(rng.standard_normal((200, 200)), (0, 0), 0.8).astype(np.float32) for _ in range(2))
    assert np.isnan(rectify.shifts(one, other, 0.1)).all()
    assert np.isnan(rectify.shifts(one, np.zeros_like(one), 0.1)).all()


def test_field_outside_a_view(found: cameras.Cameras) -> None:
    with pytest.raises(InputError, match="front: does not show the whole field of 200"):
        rectify.check_inside(found, Grid(200, 100, 1.0))
