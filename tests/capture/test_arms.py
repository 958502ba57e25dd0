"""The arms on their way to a shot."""

import itertools

import pytest

from kinran.capture.arms import go, shots_time, way
from kinran.data.capture_plan import Shot
from kinran.rig.errors import LimitError
from kinran.rig.firmware import Firmware
from kinran.rig.goniometer import check_path
from kinran.rig.motion import move_time
from kinran.rig.simulation import simulated_goniometer


def shot(theta: float, phi: float, camera: tuple[float, float] | None = None) -> Shot:
    return Shot("s", "view" if camera else "light", None if camera else 0, theta, phi, camera)


def test_the_camera_goes_back_to_the_normal() -> None:
    """A shot that says nothing of the camera is one along N; an axis within the encoder's noise stays."""
    assert way((0, 0, 30_000, 90_000), shot(40, 0)) == [(40_000, 0, 0, 0)]
    assert way((0, 0, 3, -2), shot(40, 0)) == [(40_000, 0, 3, -2)]
    assert way((40_000, 0, 0, 0), shot(40, 0, (30, 90))) == [(40_000, 0, 30_000, 90_000)]


def test_one_arm_waits_where_they_would_meet() -> None:
    """From N, where the lamp's arm stands over the camera's: it goes out of the way first, and comes back last."""
    out, back = (40_000, 0, 30_000, 90_000), (0, 0, 0, 0)
    with pytest.raises(LimitError):
        check_path(back, out)
    assert way(back, shot(40, 0, (30, 90))) == [(40_000, 0, 0, 0), out]
    assert way(out, shot(0, 0)) == [(40_000, 0, 0, 0), back]
    for a, b in itertools.pairwise([back, *way(back, shot(40, 0, (30, 90)))]):
        check_path(a, b)  # type: ignore[arg-type]


def test_arms_that_meet_on_every_way_are_refused() -> None:
    with pytest.raises(LimitError, match="meets the camera arm"):
        way((40_000, 0, 0, 0), shot(40, 0, (40, 0)))


def test_time_of_the_ways() -> None:
    """Rests count in each pose on the way; with play, going up takes one more pose than going down."""
    up, down = [shot(10, 0), shot(40, 0)], [shot(40, 0), shot(10, 0)]
    assert shots_time(up) == shots_time(down) == pytest.approx(move_time((0,), (30_000,)))
    assert shots_time(down, backlash=1_000) == shots_time(down)
    expected = move_time((0,), (31_000,)) + 0.2 + move_time((0,), (1_000,))
    assert shots_time(up, backlash=1_000) == pytest.approx(expected)


def test_going_there() -> None:
    """The simulated rig stands in the shot's pose, came to it from above, and moved its camera for a view alone."""
    rig = simulated_goniometer(Firmware())
    rig.hello()
    rig.home()
    asked: list[tuple[int, int, tuple[int, int] | None]] = []
    move = rig.move

    def spy(theta: int, phi: int, camera: tuple[int, int] | None = None) -> object:
        asked.append((theta, phi, camera))
        return move(theta, phi, camera)

    rig.move = spy  # type: ignore[method-assign, assignment]
    assert go(rig, shot(20, 5), 500)[:2] == pytest.approx((20_000, 5_000), abs=20)
    assert asked == [(20_500, 5_500, None), (20_000, 5_000, None)]
    asked.clear()
    go(rig, shot(20, 5, (30, 90)))
    assert [each[2] for each in asked] == [(30_000, 90_000)]
    asked.clear()
    go(rig, shot(20, 5))
    assert [each[2] for each in asked] == [(0, 0)]
    rig.close()
