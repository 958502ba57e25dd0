"""Mirror spheres found beside cloth, and circles on cloth that are none."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from kinran.base.files import InputError
from kinran.capture.circles import Circle
from kinran.capture.find_spheres import find_spheres
from kinran.capture.lamp_spots import NoLampError, lamp_spot

WIDTH, HEIGHT = 420, 300
BALL = Circle(60.2, 222.7, 33.1)
LAMPS = np.radians([[20.0, 10], [35, 95], [50, 170], [62, 250], [40, 330], [25, 220]])


def photographs(folder: Path, ball: Circle | None, glints: bool = False, chrome: bool = False) -> list[Path]:
    """Photographs of a cloth with printed discs and noise, lit from six sides, with a black glossy ball or none.

    The ball throws a shadow away from each lamp, and mirrors it at half its angle. `glints` are on the cloth, at other
    places in each photograph. Chrome mirrors the cloth around a black middle of 0.79 of its radius.
    """
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    cloth = 0.3 * rng.uniform(0.7, 1.3, (HEIGHT, WIDTH))
    for cx in range(40, WIDTH, 90):
        for cy in range(40, HEIGHT, 90):
            cloth[np.hypot(x - cx, y - cy) < 30] *= 1.8
            cloth[np.hypot(x - cx, y - cy) < 18] *= 0.4
    paths = []
    for k, (theta, phi) in enumerate(LAMPS):
        lamp = np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi)])
        light = cloth * np.cos(theta) * (1 + 0.2 * (lamp[0] * (x / WIDTH - 0.5) - lamp[1] * (y / HEIGHT - 0.5)))
        if ball:
            away = ball.radius * np.tan(theta)
            light[np.hypot(x - ball.x + away * np.cos(phi), y - ball.y - away * np.sin(phi)) < ball.radius] = 0.02
            light[np.hypot(x - ball.x, y - ball.y) < ball.radius] = 0.2 * np.cos(theta) if chrome else 0.03
            light[np.hypot(x - ball.x, y - ball.y) < 0.79 * ball.radius] = 0.03
            at = ball.radius * np.sin(theta / 2)
            light += np.exp(-0.5 * (np.hypot(x - ball.x - at * np.cos(phi), y - ball.y + at * np.sin(phi)) / 1.5) ** 2)
        if glints:
            light[rng.integers(0, HEIGHT, 400), rng.integers(0, WIDTH, 400)] = 1
        codes = np.clip(light, 0, 1) ** (1 / 2.2) + rng.normal(0, 0.01, light.shape)
        paths.append(folder / f"{k}.jpg")
        Image.fromarray((255 * np.clip(codes, 0, 1)).astype(np.uint8)).save(paths[-1], quality=90)
    return paths


def test_a_black_ball_among_printed_discs(tmp_path: Path) -> None:
    """To 0.1 pixels; the discs of the cloth are clearer circles, but mirror no lamp."""
    found = find_spheres(photographs(tmp_path, BALL))

    assert len(found) == 1
    np.testing.assert_allclose([found[0].x, found[0].y, found[0].radius], [BALL.x, BALL.y, BALL.radius], atol=0.1)


def test_the_outline_of_a_chrome_ball_is_the_outermost_circle(tmp_path: Path) -> None:
    """To 0.5 pixels, though the black middle that it mirrors is the clearer circle."""
    (found,) = find_spheres(photographs(tmp_path, BALL, chrome=True))
    np.testing.assert_allclose([found.x, found.y, found.radius], [BALL.x, BALL.y, BALL.radius], atol=0.5)


@pytest.mark.parametrize("glints", [False, True])
def test_printed_discs_are_no_spheres(tmp_path: Path, glints: bool) -> None:
    with pytest.raises(InputError, match="shows no mirror sphere whose outline and highlights are sure; give it by"):
        find_spheres(photographs(tmp_path, None, glints))


def spot(*marks: tuple[float, float, float], level: float = 0.1) -> tuple[float, float]:
    """Highlight on a sphere of 40 pixels in which these (x, y, radius) are white, over others at 0.1."""
    y, x = np.mgrid[:90, :90] + 0.5
    picture = np.full(x.shape, level, np.float32)
    for mark_x, mark_y, radius in marks:
        picture[np.hypot(x - mark_x, y - mark_y) < radius] = 1
    return lamp_spot(picture, np.full(x.shape, 0.1, np.float32), Circle(45, 45, 40))


def test_a_highlight_is_one_compact_spot() -> None:
    assert spot((50.5, 30.5, 2)) == pytest.approx((50.5, 30.5))
    assert spot((50.5, 30.5, 4), (30.5, 30.5, 2)) == pytest.approx((50.5, 30.5))  # its mirror image in another sphere


@pytest.mark.parametrize(
    ("marks", "level", "says"),
    [
        ([], 0.1, "has no highlight"),
        ([(45, 80, 3)], 0.1, "has no highlight"),  # at the rim, where a sphere mirrors what lies behind it
        ([(45, 45, 14)], 0.1, "has no compact highlight"),
        ([(45, 45, 60)], 0.1, "has no compact highlight"),
        ([(30, 30, 3), (60, 30, 3), (45, 60, 3)], 0.1, "has several highlights"),
    ],
)
def test_what_is_no_lamp(marks: list[tuple[float, float, float]], level: float, says: str) -> None:
    with pytest.raises(NoLampError, match=says):
        spot(*marks, level=level)
