"""The board: where its corners are found, and what is refused."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import plate
import pytest
import yaml
from register_session import Session

from kinran.base.files import InputError
from kinran.register import target


def detection_errors(session: Session, view: int, pixels: np.ndarray) -> np.ndarray:
    truth = plate.project(session.views[view], session.board.points[session.corners[view].ids])
    return np.linalg.norm(pixels - truth, axis=1)


def rms(values: np.ndarray) -> float:
    return float(np.sqrt((values**2).mean()))


def test_corners_are_found_at_all_angles(session: Session) -> None:
    for view, corners in enumerate(session.corners):
        assert len(corners.ids) >= 0.7 * session.board.usable.sum()
        assert rms(detection_errors(session, view, corners.pixels)) < 0.25


def test_second_refinement_would_move_corners_by_pixels(session: Session) -> None:
    """The failure: a window of fixed size reaches over the margin of a marker that is foreshortened at 60°."""
    for view in (3, 4):
        corners = session.corners[view]
        start = np.ascontiguousarray((corners.pixels - 0.5)[:, None], np.float32)
        again = cv2.cornerSubPix(session.pictures[view], start, (10, 10), (-1, -1), (3, 50, 1e-4))[:, 0] + 0.5
        wrong = detection_errors(session, view, again)
        assert wrong.max() > 1.5
        assert rms(wrong) > 2.5 * rms(detection_errors(session, view, corners.pixels))


def test_first_pixel_is_centred_at_one_half(session: Session) -> None:
    """OpenCV counts from 0: its numbers would be off by half a pixel in both directions."""
    for view, corners in enumerate(session.corners):
        truth = plate.project(session.views[view], session.board.points[corners.ids])
        assert np.abs((corners.pixels - truth).mean(0)).max() < 0.05


def test_board_is_centred_with_y_up(session: Session) -> None:
    points = session.board.points
    np.testing.assert_allclose(points.mean(0), 0, atol=1e-6)
    assert points[0, 0] < 0 < points[0, 1]  # OpenCV's first corner is the upper left
    assert not session.board.usable[(np.abs(points[:, :2]) <= 25).all(1)].any()
    assert session.board.usable.sum() == 15**2 - 11**2


def test_picture_without_a_board(session: Session) -> None:
    with pytest.raises(InputError, match=r"dark\.png: the board is not found"):
        target.detect(session.board, np.full((200, 300), 40, np.uint8), "dark.png")


def test_board_of_another_dictionary(session: Session) -> None:
    board = target.make_board({**plate.SPEC, "dictionary": "DICT_6X6_250"})
    with pytest.raises(InputError, match="the board is not found"):
        target.detect(board, session.pictures[0], "front")


@pytest.mark.parametrize("row", [False, True], ids=["few", "one row"])
def test_too_little_of_the_board(session: Session, row: bool) -> None:
    picture = session.pictures[0].copy()
    picture[:, : 790 if row else 720] = 120
    if not row:
        picture[280:] = 120
    with pytest.raises(InputError, match=r"front: only \d+ corners of the board .* over \d+ % of its side"):
        target.detect(session.board, picture, "front")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"pages": 1}, "'pages'"),
        ({"kind": "dots"}, "kind: 'dots'"),
        ({"columns": 1}, "columns"),
        ({"dictionary": "DICT_NONE"}, "DICT_NONE"),
        ({"dictionary": "DICT_4X4_50"}, "needs 128 markers, but DICT_4X4_50 has 50"),
        ({"marker_mm": 6.0}, "marker_mm 6 leaves no gap in pitch_mm 5"),
        ({"pitch_mm": -1.0}, "pitch_mm: -1"),
        ({"aperture_mm": [50.0]}, "aperture_mm"),
    ],
)
def test_wrong_board_file(tmp_path: Path, change: dict[str, Any], message: str) -> None:
    path = tmp_path / "board.yaml"
    path.write_text(yaml.safe_dump({**plate.SPEC, **change}))
    with pytest.raises(InputError, match=message) as error:
        target.read_board(path)
    assert str(path) in str(error.value)


@pytest.mark.parametrize("text", ["{", "just words", ""])
def test_board_file_that_is_no_mapping(tmp_path: Path, text: str) -> None:
    path = tmp_path / "board.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=r"board\.yaml"):
        target.read_board(path)


def test_no_board_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.yaml"):
        target.read_board(tmp_path / "none.yaml")
