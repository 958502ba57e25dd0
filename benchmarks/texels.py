"""Texels with known lobes, their radiance, and methods that fit it."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinran.base import frames
from kinran.compare.baselines import takeda_joint
from kinran.data.texel_directions import Under
from kinran.fit import slope, takeda
from kinran.fit.fitted_model import Fitted
from kinran.fit.samples import Samples
from kinran.fit.slope_lobes import Lobes
from kinran.fit.solver.lobes import squared_widths
from kinran_bsdf.models import Slope
from kinran_bsdf.models.lambert import diffuse

Array = NDArray[np.float64]
Single = NDArray[np.float32]
Method = Callable[[Samples], Fitted]


def grid(step_theta: float = 5.0, azimuths: int = 24) -> Array:
    """The paper's grid of lights with fewer azimuths; θ = 0 once."""
    thetas = np.radians(np.arange(step_theta, 80.1, step_theta))
    phis = np.arange(azimuths) * 2 * np.pi / azimuths
    t, p = np.meshgrid(thetas, phis, indexing="ij")
    return np.concatenate([[[0, 0, 1]], frames.direction(t.ravel(), p.ravel())])


def radiance(shapes: Array, colours: Array, lights: Array, tail: str = "ggx") -> Single:
    """T (texel, 3, light) of one lobe (texel, 7) and colours (texel, 2, 3), by the plugin's definition."""
    s = frames.slopes(lights)
    x, y, nx, ny = (shapes[:, k, None] for k in (0, 1, 5, 6))
    xx, xy, yy = (w[:, None] for w in squared_widths(shapes[:, :5]))
    G = Slope(tail).of_slopes(s[:, 0], s[:, 1], x, y, xx, xy, yy)
    D = diffuse(lights.T, nx, ny)
    return np.asarray(colours[:, 0, :, None] * G[:, None] + colours[:, 1, :, None] * D[:, None], np.float32)


def microfacets(shapes: Array, colours: Array, lights: Array) -> Single:
    """T of a model that no fit assumes: shadowed GGX microfacets [Walter2007] on a tilted normal; see `radiance`."""
    n = np.concatenate([shapes[:, :2], np.ones((len(shapes), 1))], 1)
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    t = np.array([1.0, 0, 0]) - n[:, :1] * n
    t /= np.linalg.norm(t, axis=1, keepdims=True)
    frame = np.stack([t, np.cross(n, t), n], 1)
    h, towards = (np.einsum("tki,li->tkl", frame, v) for v in (frames.half_vector(lights), lights))
    ea, b, ec = np.exp(shapes[:, 2, None]), shapes[:, 3, None], np.exp(shapes[:, 4, None])
    cosine = np.maximum(h[:, 2], 1e-3)
    x, y = h[:, 0] / cosine, h[:, 1] / cosine
    D = ((1 + (ea * x + b * y) ** 2 + (ec * y) ** 2) * cosine**2) ** -2
    width = 1 / np.sqrt(ea * ec)
    shadowed = _smith(width, towards[:, 2]) * _smith(width, n[:, 2:]) * (towards[:, 2] > 0) / n[:, 2:]
    cos_n = diffuse(lights.T, shapes[:, 5, None], shapes[:, 6, None])
    return np.asarray(colours[:, 0, :, None] * (D * shadowed)[:, None] + colours[:, 1, :, None] * cos_n[:, None], "f4")


def _smith(width: Array, cosine: Array) -> Array:
    """Share of microfacets of an isotropic GGX that are seen at an angle."""
    c = np.clip(cosine, 1e-3, 1)
    return np.asarray(2 / (1 + np.sqrt(1 + width**2 * (1 / c**2 - 1))))


def texels(count: int, seed: int = 0) -> tuple[Array, Array]:
    """Shapes (texel, 7) and colours (texel, 2, 3) of facets of gold over silk."""
    rng = np.random.default_rng(seed)
    shapes = np.zeros((count, 7))
    shapes[:, :2] = rng.normal(0, 0.2, (count, 2))
    shapes[:, 2] = -np.log(rng.uniform(0.1, 0.3, count))
    shapes[:, 3] = rng.normal(0, 2, count)
    shapes[:, 4] = -np.log(rng.uniform(0.1, 0.3, count))
    shapes[:, 5:] = rng.normal(0, 0.1, (count, 2))
    colours = np.stack(
        [rng.uniform(1, 3, (count, 1)) * [1, 0.75, 0.35], rng.uniform(0.05, 0.2, (count, 1)) * [1, 0.1, 0.1]], 1
    )
    return shapes, colours


def facets(tilt: float, count: int = 40, width: float = 0.12) -> tuple[Array, Array]:
    """Round lobes of facets of one tilt in degrees, all around."""
    shapes, colours = texels(count)
    azimuth = np.linspace(0, 2 * np.pi, count)
    shapes[:, :2] = np.tan(np.radians(tilt)) * np.stack([np.cos(azimuth), np.sin(azimuth)], 1)
    shapes[:, 2:5] = -np.log(width), 0, -np.log(width)
    shapes[:, 5:] = 0
    return shapes, colours


def noisy(clean: NDArray[np.floating], seed: int = 1, share: float = 0.01, floor: float = 0.003) -> Single:
    """Samples with noise whose standard deviation is a share of each and a floor."""
    rng = np.random.default_rng(seed)
    noise = share * clean * rng.normal(size=clean.shape) + floor * rng.normal(size=clean.shape)
    return (clean + noise).astype(np.float32)


def ones(T: Single) -> Single:
    """Weights (texel, light) of samples that all count alike."""
    return np.ones((len(T), T.shape[2]), np.float32)


def relative(predicted: Single, truth: Single) -> Array:
    """√(Σ (m - g)² / Σ g²) of each texel."""
    error, energy = ((predicted.astype(float) - truth) ** 2).sum((1, 2)), (truth.astype(float) ** 2).sum((1, 2))
    return np.asarray(np.sqrt(error / np.maximum(energy, 1e-30)))


def spread(lights: Array, count: int) -> NDArray[np.intp]:
    """Indices of lights spread over slopes by farthest points."""
    s = frames.slopes(lights)
    chosen = [0]
    distance = np.linalg.norm(s - s[0], axis=1)
    while len(chosen) < count:
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(s - s[chosen[-1]], axis=1))
    return np.array(chosen)


@dataclass(frozen=True)
class Split:
    """Lights for the fit and lights to judge by: every fourth of a ring, staggered, is held out."""

    lights: Array
    held: NDArray[np.bool_]

    @classmethod
    def of_grid(cls, azimuths: int = 24) -> "Split":
        """Split the lights of `grid`."""
        lights = grid(azimuths=azimuths)
        ring, azimuth = np.divmod(np.arange(len(lights) - 1), azimuths)
        return cls(lights, np.r_[False, (ring + 1 + azimuth) % 4 == 0])

    def error(self, method: Method, clean: Single, seen: Single, W: Single | None = None) -> Array:
        """Relative error of each texel on the lights held out; infinite where the prediction is no number."""
        train = ~self.held
        T = np.ascontiguousarray(seen[..., train])
        weights = ones(T) if W is None else np.ascontiguousarray(W[:, train])
        with np.errstate(all="ignore"):
            fitted = method(Samples.far(T, weights, self.lights[train]))
            error = relative(fitted.predict(Under.far(self.lights[self.held], len(T))), clean[..., self.held])
        return np.where(np.isfinite(error), error, np.inf)


def lobes(tail: str = "ggx", count: int = 1, narrow: float | None = None) -> Method:
    """Method that fits lobes by `kinran.fit.slope`."""
    return lambda samples: slope.fit(samples, Lobes(tail, count), narrow=narrow)


def four_steps(samples: Samples) -> takeda.TakedaFit:
    """Fit by the four steps of the paper, with half a step of the grid as the tolerance of θ and φ."""
    phi = np.unique(np.round(frames.angles(samples.under.directions)[1], 6))
    return takeda.four_steps(samples, np.radians(2.5), float(0.51 * np.median(np.diff(phi))))


def joint(wrap: bool = True) -> Method:
    """Method that fits Eq. 3 by non-linear least squares, its azimuth wrapped or as printed."""
    return lambda samples: takeda_joint.fit(samples, four_steps(samples), wrap)
