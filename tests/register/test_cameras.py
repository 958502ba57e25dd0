"""Cameras from corners: recovered to a stated bound, and refused where they cannot be known."""

from pathlib import Path

import cv2
import numpy as np
import plate
import pycolmap
import pytest
from register_session import Session

from kinran.base.files import InputError
from kinran.register import cameras, target


def calibrate(session: Session, corners: list[target.Corners]) -> cameras.JudgedCameras:
    return cameras.calibrate(session.board.points, corners, plate.WIDTH, plate.HEIGHT)


def exact(session: Session, views: list[plate.View], sigma: float = 0.0) -> list[target.Corners]:
    """All corners of the frame in each view, with Gaussian noise."""
    ids, rng = np.flatnonzero(session.board.usable), np.random.default_rng(1)
    pixels = [plate.project(view, session.board.points[ids]) for view in views]
    return [
        target.Corners(v.name, ids, p + sigma * rng.normal(size=p.shape)) for v, p in zip(views, pixels, strict=True)
    ]


def test_cameras_are_recovered(session: Session) -> None:
    """From detected corners: direction to 0.05°, rotation to 0.1°, and what they see to 0.15 px.

    600 mm off a plate of 80 mm, the distance (0.3 %) is hardly told from the focal length, nor a turn of the camera
    from the principal point; that cancels in what is seen.
    """
    found = calibrate(session, session.corners)
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(-24, 24, 9), np.linspace(-24, 24, 9)))
    fabric = np.stack([x, y, plate.height(x, y)], -1)
    for n, view in enumerate(session.views):
        turn = found.cameras.rotations[n] @ view.rotation.T
        assert np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1))) < 0.1
        here, there = found.cameras.centres[n], view.centre
        distance, true_distance = np.linalg.norm(here), np.linalg.norm(there)
        assert np.degrees(np.linalg.norm(here / distance - there / true_distance)) < 0.05
        assert distance == pytest.approx(true_distance, rel=3e-3)
        assert np.abs(found.cameras.project(n, fabric) - plate.project(view, fabric)).max() < 0.15
    assert found.rms.max() < 0.25
    assert found.cameras.lens[0] == pytest.approx(plate.FOCAL, rel=3e-3)


def test_exact_corners_give_the_exact_camera(session: Session) -> None:
    found = calibrate(session, exact(session, session.views))
    # c_x, c_y in pixels from the corner of the picture
    np.testing.assert_allclose(found.cameras.lens[:4], plate.LENS[[0, 1, 0, 1], [0, 1, 2, 2]], rtol=1e-6)
    assert found.rms.max() < 1e-4


def test_rays_pass_through_what_is_projected(session: Session) -> None:
    found = calibrate(session, exact(session, session.views)).cameras
    point = np.array([[12.0, -7.0, 1.2]])
    for view in range(len(session.views)):
        ray = found.rays(view, found.project(view, point))[0]
        off = np.cross(ray / np.linalg.norm(ray), point[0] - found.centres[view])
        assert np.linalg.norm(off) < 1e-5


def test_a_wrong_corner_is_left_out(session: Session) -> None:
    views = exact(session, session.views, 0.1)
    views[4].pixels[17] += 6.0
    found = calibrate(session, views)
    assert found.left_out.tolist() == [0, 0, 0, 0, 1, 0]
    assert found.rms.max() < 0.2


def test_a_view_of_wrong_corners_is_refused_by_name(session: Session) -> None:
    """A robust loss would have hidden it in a plausible solution."""
    views = exact(session, session.views, 0.1)
    views[4].pixels[::2] += np.random.default_rng(3).normal(size=views[4].pixels[::2].shape) * 4
    with pytest.raises(InputError, match=r"t60p140: .* of its 104 corners miss"):
        calibrate(session, views)


@pytest.mark.parametrize("kind", ["same", "turned", "nearer"])
def test_views_from_one_place(session: Session, kind: str) -> None:
    front, rng = session.views[0], np.random.default_rng(5)
    views = []
    for k in range(4):
        rotation, translation = front.rotation, front.translation
        if kind == "turned":  # about the camera's own centre
            turn = cv2.Rodrigues(0.01 * rng.normal(size=3))[0]
            rotation, translation = turn @ rotation, turn @ translation
        if kind == "nearer":
            translation = translation * (1 - 0.02 * k)
        views.append(plate.View(f"v{k}", 0.0, rotation, translation))
    with pytest.raises(InputError, match="all views look from one place"):
        calibrate(session, exact(session, views, 0.1))


def test_two_views_are_too_few(session: Session) -> None:
    with pytest.raises(InputError, match="2 views: a lens needs at least 3"):
        calibrate(session, session.corners[:2])


def test_a_bent_board_shows_itself(session: Session) -> None:
    """Freed corners tell how far the plate is from its description; a scale alone they cannot tell."""
    ids, points = np.flatnonzero(session.board.usable), session.board.points.copy()
    points[:, 2] += 0.3 * (points[:, 0] / 40) ** 2
    views = [target.Corners(v.name, ids, plate.project(v, points[ids])) for v in session.views]
    found = calibrate(session, views)
    assert found.free_rms.max() < 0.01 < 0.1 < found.rms.max()
    assert 0.04 < found.bend[1] < 0.2


def test_similarity_of_points_in_a_plane() -> None:
    rng = np.random.default_rng(2)
    flat = np.c_[rng.normal(size=(30, 2)), np.zeros(30)]
    turn = cv2.Rodrigues(np.array([0.3, -0.7, 1.1]))[0]
    moved = 1.7 * flat @ turn.T + [1.0, 2.0, 3.0]
    assert pycolmap.estimate_sim3d(flat, moved) is None  # why there is one of our own
    np.testing.assert_allclose(cameras.similarity(flat, moved), moved, atol=1e-9)


@pytest.mark.real
def test_photographs_of_a_printed_board(real_data: Path) -> None:
    """42 photographs: OpenCV's calibration has 0.4625 px and c = (318.27, 240.57), counted from 0."""
    spec = {
        "kind": "aruco",
        "dictionary": "DICT_6X6_1000",
        "columns": 4,
        "rows": 5,
        "marker_mm": 37.5,
        "pitch_mm": 42.5,
    }
    board = target.make_board(spec)
    files = sorted((real_data / "sfm_aruco_board").glob("*.jpg"))
    views = [target.detect(board, cv2.imread(str(f), cv2.IMREAD_GRAYSCALE), f.stem) for f in files]
    assert (len(views), sum(len(view.ids) for view in views)) == (42, 3352)
    fitted, _ = cameras.adjust(board.points, views, cameras.initial(board.points, views, 640, 480))
    misses = np.concatenate(cameras.misses(board.points, views, fitted))
    assert np.sqrt((misses**2).sum(1).mean()) == pytest.approx(0.4625, rel=0.01)
    np.testing.assert_allclose(fitted.lens[:4], [810.97, 810.66, 318.77, 241.07], atol=0.02)
    whole = cameras.calibrate(board.points, views, 640, 480)
    assert whole.free_rms.mean() < 0.6 * whole.rms.mean()  # the printed board is not what it should be
    assert 0.1 < whole.bend[1] < 0.4
