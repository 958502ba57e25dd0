"""A field of 60 mm under a lamp at 600 mm: normals bend towards the edges unless each texel has its own lights."""

import numpy as np
from synthetic_texels import grid, radiance

from kinran.fit import near, slope

SIDE, TEXEL, LAMP = 9, 60 / 9, 600.0


def flat_field() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Samples of one flat material everywhere, each texel under the lights that it has; lamps; points."""
    positions = LAMP * grid(10, 24)
    points = near.texel_points(SIDE, SIDE, TEXEL)
    directions, factor = near.illumination(positions, points)
    shapes = np.array([[0, 0, -np.log(0.12), 0, -np.log(0.12), 0, 0.0]])
    colours = np.array([[[2, 1.5, 0.7], [0.1, 0.02, 0.02]]])
    T = np.concatenate([radiance(shapes, colours, d) * f for d, f in zip(directions, factor, strict=True)])
    return T.astype(np.float32), positions, points


def test_normals_and_brightness_over_the_field() -> None:
    T, positions, points = flat_field()
    W = np.ones((len(T), len(positions)), np.float32)
    far = slope.fit(T, W, positions / LAMP)
    known = near.fit(T, W, positions, points)
    bent, straight = (np.degrees(np.arctan(np.linalg.norm(f.shapes[:, :2], axis=1))) for f in (far, known))
    assert bent.max() > 1.5
    assert straight.max() < 0.1
    assert np.ptp(known.colours[:, 0, 0]) < 0.02
    assert near.matters(positions, points)


def test_a_small_field_does_not_matter() -> None:
    assert not near.matters(LAMP * grid(10, 24), near.texel_points(16, 16, 0.05))


def test_irradiance_falls_with_the_square_of_the_distance() -> None:
    _, factor = near.illumination(np.array([[0.0, 0.0, 100.0]]), np.array([[0.0, 0.0], [100.0, 0.0]]))
    np.testing.assert_allclose(factor[:, 0], [1, 0.5])
