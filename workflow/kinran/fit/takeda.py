"""The paper's four steps (Takeda2008, §3.2), to the letter, for all texels of a block at once."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinran import frames
from kinran.fit import separable

Array = NDArray[np.float64]

FLOOR = 0.05
"""Samples below this share of the peak do not enter the widths: their logarithm is noise."""
FLAT = 20.0
"""dp of a lobe without an azimuth, which is what a peak at the pole leaves."""


@dataclass(frozen=True)
class TakedaFit:
    """Eq. 3 of each texel: shapes (texel, 4) θ_n, φ_n, dt, dp and colours (texel, 2, 3) C_s, C_d."""

    shapes: Array
    colours: Array


def four_steps(T: NDArray[np.float32], lights: Array, polar_tolerance: float, azimuth_tolerance: float) -> TakedaFit:
    """Fit Eq. 3 to samples by the four steps of the paper.

    Step 1 is read as Eq. 3 needs it: the half vector of the brightest light is the normal. Taken word for
    word (the light itself is n) the lobe would land at twice its angle.

    Parameters
    ----------
    T : (texel, 3, light) float32
        Radiance samples.
    lights : (light, 3) float
        Unit directions.
    polar_tolerance, azimuth_tolerance : float
        Half widths, in radians, of what counts as the same θ_i and the same φ_i: half a step of a grid.
    """
    theta, phi = frames.angles(lights)
    cosine = np.cos(theta)
    luminance = T.mean(1, dtype=float)
    brightest = luminance.argmax(1)
    rows = np.arange(len(T))

    # 1. the brightest light gives n
    theta_n, phi_n = theta[brightest] / 2, phi[brightest]
    # 2. C_d where the azimuth is φ_n + π
    opposite = _near(phi, phi_n + np.pi, azimuth_tolerance) & (theta > 0)
    weight = opposite * cosine
    C_d = np.einsum("tcl,tl->tc", T, weight) / np.maximum((weight * cosine).sum(1), 1e-12)[:, None]
    C_d = np.maximum(C_d, 0)
    # 3. subtract it
    rest = luminance - C_d.mean(1)[:, None] * cosine
    # 4. C_s, dt and dp with n as the reference
    C_s = np.maximum(T[rows, :, brightest] - C_d * cosine[brightest][:, None], 0)
    ratio = rest / np.maximum(rest[rows, brightest], 1e-12)[:, None]
    usable = (ratio > FLOOR) & (ratio < 1)
    fall = -np.log(np.clip(ratio, 1e-12, 1))
    meridian = usable & _near(phi, phi_n, azimuth_tolerance)
    ring = usable & (np.abs(theta - theta[brightest][:, None]) <= polar_tolerance)
    dt = _width(theta / 2 - theta_n[:, None], fall, meridian, 0.01, 3.0, 0.05)
    dp = _width(frames.wrap(phi - phi_n[:, None]), fall, ring, 0.01, FLAT, FLAT)
    return TakedaFit(np.stack([theta_n, phi_n, dt, dp], 1), np.stack([C_s, C_d], 1))


def _near(phi: Array, centre: Array, tolerance: float) -> NDArray[np.bool_]:
    return np.asarray(np.abs(frames.wrap(phi - centre[:, None])) <= tolerance)


def _width(x: Array, fall: Array, used: NDArray[np.bool_], low: float, high: float, default: float) -> Array:
    """Least squares of fall = (x / width)² over the used samples of each texel; `default` without any."""
    square = np.where(used, x * x, 0)
    top, bottom = (square**2).sum(1), (square * fall).sum(1)
    width = np.sqrt(top / np.maximum(bottom, 1e-12))
    return np.where(bottom > 0, np.clip(width, low, high), default)


LOW, HIGH = np.array([-0.2, -1e3, np.log(0.01), np.log(0.02)]), np.array([1.2, 1e3, np.log(3.0), np.log(FLAT)])
"""Bounds of θ_n, φ_n, log dt and log dp in the joint fit."""


def joint(
    T: NDArray[np.float32], W: NDArray[np.float32], lights: Array, start: TakedaFit, wrap: bool = True
) -> TakedaFit:
    """Fit Eq. 3 by non-linear least squares over all samples, which the four steps only sample.

    Parameters
    ----------
    T, W : (texel, 3, light), (texel, light) float32
        Radiance samples and their weights.
    lights : (light, 3) float
        Unit directions.
    start
        From the four steps.
    wrap
        Whether φ_h − φ_n is wrapped to [−π, π]; the formula as printed does not say so.
    """
    half = frames.half_vector(lights)
    theta, phi = frames.angles(half)

    def lobe(p: Array) -> tuple[Array, Array]:
        theta_n, phi_n, dt, dp = p[:, :1], p[:, 1:2], np.exp(p[:, 2:3]), np.exp(p[:, 3:])
        turn = frames.wrap(phi - phi_n) if wrap else phi - phi_n
        a, b = (theta - theta_n) / dt, turn / dp
        G = np.exp(-a * a - b * b)
        return G, 2 * G[:, None] * np.stack([a / dt, b / dp, a * a, b * b], 1)

    first = np.concatenate([start.shapes[:, :2], np.log(start.shapes[:, 2:])], 1)
    found = separable.fit(lobe, first[:, None], T, W, lights[:, 2], LOW, HIGH)
    shapes = found.shapes[:, 0]
    return TakedaFit(np.concatenate([shapes[:, :2], np.exp(shapes[:, 2:])], 1), found.colours)
