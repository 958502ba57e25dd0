"""A simulated session: a curved fabric in the opening of a ChArUco plate, photographed from all sides.

Written with OpenCV and NumPy alone, from the pin-hole and Brown's equations, so that nothing of the stage is used to
make what the stage is judged by. Board coordinates; pixels with the first one's middle at (0.5, 0.5).
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SPEC = {
    "kind": "charuco",
    "dictionary": "DICT_4X4_250",
    "columns": 16,
    "rows": 16,
    "pitch_mm": 5.0,
    "marker_mm": 3.75,
    "aperture_mm": [50.0, 50.0],
}
SIDE, OPENING = 80.0, 50.0
SAG = 1.5
DENSE = 0.05  # mm, of the texture
WIDTH, HEIGHT, FOCAL = 960, 800, 5800.0  # 0.103 mm a pixel at 600 mm
LENS = np.array([[FOCAL, 0, WIDTH / 2 + 6.3], [0, FOCAL, HEIGHT / 2 - 4.1], [0, 0, 1]])
BROWN = np.array([-0.15, 0.30, 4e-4, -3e-4])


@dataclass(frozen=True)
class View:
    """A camera: rotation and translation from board to camera."""

    name: str
    theta: float
    rotation: Array
    translation: Array

    @property
    def centre(self) -> Array:
        return np.asarray(-self.rotation.T @ self.translation)


def height(x: Array, y: Array) -> Array:
    """Sag, and a wrinkle that tells left from right and up from down; 0 at the opening's edge."""
    edge = np.clip(np.cos(np.pi * x / OPENING), 0, None) * np.clip(np.cos(np.pi * y / OPENING), 0, None)
    return np.asarray(edge * (SAG + 0.3 * np.sin(2 * np.pi * (x + 0.3 * y) / 30) + 0.01 * (x + 2 * y)))


def view(name: str, theta: float, phi: float, rng: np.random.Generator) -> View:
    """A camera on the goniometer's arc, 600 mm away, with a rig's errors of 0.3° and 1 mm."""
    t, p, roll = np.radians([theta, phi, 0.0]) + np.radians(rng.normal(size=3) * [0.3, 0.3, 1.0])
    target = rng.normal(size=3)
    out = np.array([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)])
    right = np.cross(-out, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    down = np.cross(-out, right)
    right, down = np.cos(roll) * right + np.sin(roll) * down, np.cos(roll) * down - np.sin(roll) * right
    rotation = np.stack([right, down, -out])
    return View(name, theta, rotation, -rotation @ (target + 600 * out))


def project(camera: View, points: Array) -> Array:
    """Pixels (n, 2) of points (n, 3)."""
    seen = points.reshape(-1, 3) @ camera.rotation.T + camera.translation
    return np.asarray(cv2.projectPoints(seen, np.zeros(3), np.zeros(3), LENS, BROWN)[0][:, 0])


def see(camera: View, pixels: Array) -> Array:
    """Points (n, 3) of the plate or the fabric that pixels (n, 2) see."""
    criteria = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 30, 1e-9)
    normal = cv2.undistortPoints(pixels.reshape(-1, 1, 2), LENS, BROWN, criteria=criteria)[:, 0]
    rays = np.c_[normal, np.ones(len(normal))] @ camera.rotation
    z = np.zeros(len(rays))
    for _ in range(9):
        points = camera.centre + rays * ((z - camera.centre[2]) / rays[:, 2])[:, None]
        z = height(points[:, 0], points[:, 1])
    return np.asarray(camera.centre + rays * ((z - camera.centre[2]) / rays[:, 2])[:, None])


def _noise(rng: np.random.Generator, n: int, sigma: float) -> NDArray[np.float32]:
    """Smooth noise (n, n) of deviation 1; `sigma` in mm. Coarse noise is made coarse, which is faster."""
    every = max(int(sigma / DENSE / 3), 1)
    small = rng.standard_normal((n // every + 1, n // every + 1)).astype(np.float32)
    small = cv2.GaussianBlur(small, (0, 0), sigma / DENSE / every)
    return np.asarray(cv2.resize(small / small.std(), (n, n), interpolation=cv2.INTER_CUBIC), np.float32)


def texture(rng: np.random.Generator) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Reflectance of the plate and fabric, and where gold lies; (y, x), row 0 at the bottom, `DENSE` mm a texel."""
    n = round(SIDE / DENSE)
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, str(SPEC["dictionary"])))
    board = cv2.aruco.CharucoBoard((16, 16), 5.0, 3.75, dictionary).generateImage((n, n))[::-1]
    plate = (0.04 + 0.8 * (board > 127)).astype(np.float32)
    y = np.arange(n, dtype=np.float32)[:, None] * DENSE
    cloth = np.full((n, n), 0.18, np.float32)
    for sigma in (0.08, 0.2, 0.6):
        cloth *= 1 + 0.17 * _noise(rng, n, sigma)
    strips = (np.abs((y + 0.15 * _noise(rng, n, 1.5)) % 2.2 - 1.1) < 0.5).astype(np.float32)
    gold = strips * (_noise(rng, n, 0.3) > -1.2)
    inside = np.zeros((n, n), np.float32)
    a, b = round((SIDE - OPENING) / 2 / DENSE), round((SIDE + OPENING) / 2 / DENSE)
    inside[a:b, a:b] = 1
    return np.where(inside > 0, np.clip(cloth, 0.02, 0.9), plate), gold * inside


def photograph(
    camera: View, layers: tuple[NDArray[np.float32], NDArray[np.float32]], rng: np.random.Generator
) -> NDArray[np.uint8]:
    """8-bit sRGB-like picture (y, x), top row first: 3×3 samples a pixel, gold that changes with the view, noise."""
    y, x = np.mgrid[0:HEIGHT:2, 0:WIDTH:2] + 1.0  # what is seen is smooth: every second pixel will do
    points = see(camera, np.stack([x.ravel(), y.ravel()], -1))[:, :2].reshape(*x.shape, 2).astype(np.float32)
    fine = cv2.resize((points + SIDE / 2) / DENSE - 0.5, (3 * WIDTH, 3 * HEIGHT), interpolation=cv2.INTER_CUBIC)
    ground, gold = layers
    shine = 0.25 + 0.35 * np.cos(np.radians(camera.theta)) ** 4
    light = ground * (1 - gold) + shine * gold
    light = cv2.remap(
        light, fine[..., 0], fine[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0.3
    )
    light = cv2.resize(light, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
    light = light + rng.normal(size=light.shape) * np.sqrt(0.002**2 + 0.006**2 * light)
    coded = np.where(light <= 0.0031308, 12.92 * light, 1.055 * np.clip(light, 1e-9, None) ** (1 / 2.4) - 0.055)
    return np.round(255 * np.clip(coded, 0, 1)).astype(np.uint8)
