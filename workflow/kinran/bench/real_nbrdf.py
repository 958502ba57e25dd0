"""Measured BRDFs on tilted facets under the paper's grid, by the neural codes of Neural-BRDF [Sztrajman2021]."""

import io
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinran import frames
from kinran.baselines import basis, interpolation
from kinran.files import InputError
from kinran.fit import learned, residual, slope, takeda
from kinran.fit.plates import plates
from kinran.fit.predict import predict
from kinran_bsdf.models import Takeda2008
from kinran_bsdf.residual import Residual, compress, expand

Array = NDArray[np.float64]
Single = NDArray[np.float32]
Net = list[tuple[Array, Array]]

MATERIALS = {
    "merl_nbrdf.zip": (
        *("gold-metallic-paint", "gold-metallic-paint2", "gold-metallic-paint3", "gold-paint", "two-layer-gold"),
        *("brass", "silver-paint", "red-fabric", "white-fabric"),
    ),
    "rgl-isotropic_nbrdf.zip": ("satin_gold_rgb", "vch_silk_blue_rgb", "vch_golden_yellow_rgb"),
}
TEXELS, FACETS = 48, 24
"""Texels of a material, and facets of each."""
TILT = np.radians(18.0)
"""Largest tilt of a texel, in radians."""
SPREAD = (0.12, 0.03)
"""Standard deviations of the slopes of a texel's facets along x and y: those of a thread that is ridged along it."""
NOISE = 0.01
"""Standard deviation of the noise, relative to a sample."""
UNRESOLVED = 0.25
"""Error of interpolation between neighbouring lights from which on the grid does not resolve a material."""


def measure(folder: Path) -> dict[str, Any]:
    """Median relative error of the texels on held-out lights, by material and method; printed as a table."""
    rows = {}
    rng = np.random.default_rng(0)
    for archive, names in MATERIALS.items():
        for name in names:
            rows[name] = row = _material(load(folder / archive, name), rng)
            if len(rows) == 1:
                print(f"\n{'':24s}" + "".join(f"{key:>14s}" for key in row))
            marked = name + (" *" if row["interpolation"] > UNRESOLVED else "")
            print(f"{marked:24s}" + "".join(f"{value:14.3f}" for value in row.values()), flush=True)
    medians = {key: round(float(np.median([row[key] for row in rows.values()])), 4) for key in row}
    unresolved = [name for name, row in rows.items() if row["interpolation"] > UNRESOLVED]
    print(f"{'median of all':24s}" + "".join(f"{value:14.3f}" for value in medians.values()))
    print(f"* not resolved by the grid: {', '.join(unresolved)}", flush=True)
    return {"materials": rows, "median": medians, "unresolved": unresolved}


def load(archive: Path, name: str) -> Net:
    """Weights of a material's network, 6-21-21-3.

    Raises
    ------
    InputError
        h5py, which only this benchmark needs, is not installed; or the archive lacks the material.
    """
    try:
        import h5py  # type: ignore[import-not-found, unused-ignore]
    except ImportError:
        raise InputError("nbrdf: reading its files takes h5py; install it, or name other --sets") from None
    with zipfile.ZipFile(archive) as files:
        paths = [path for path in files.namelist() if path.endswith(f"/{name}.h5")]
        if not paths:
            raise InputError(f"{archive}: has no {name}.h5; get the archive again")
        found: dict[str, Array] = {}
        with h5py.File(io.BytesIO(files.read(paths[0])), "r") as file:
            file.visititems(
                lambda path, item: found.update({path: np.array(item)}) if isinstance(item, h5py.Dataset) else None
            )
    kernels = [key for key in found if "kernel" in key and "optimizer" not in key]
    order = sorted(kernels, key=lambda key: (found[key].shape[0] != 6, found[key].shape[1] == 3))
    return [(found[key], found[key.replace("kernel", "bias")]) for key in order]


def brdf(net: Net, light: Array, view: Array) -> Array:
    """f_r (n, 3) of a network for unit vectors (n, 3): half and difference vectors in, exp(x) - 1 out."""
    half = light + view
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    theta, phi = frames.angles(half)
    x = np.cos(phi) * light[:, 0] + np.sin(phi) * light[:, 1]
    y = np.cos(phi) * light[:, 1] - np.sin(phi) * light[:, 0]
    difference = np.cos(theta) * x - np.sin(theta) * light[:, 2], y, np.sin(theta) * x + np.cos(theta) * light[:, 2]
    values = np.stack([np.sin(theta), np.zeros_like(theta), np.cos(theta), *difference], 1)
    for kernel, bias in net[:-1]:
        values = np.maximum(values @ kernel + bias, 0)
    return np.asarray(np.maximum(np.exp(values @ net[-1][0] + net[-1][1]) - 1, 0))


def grid() -> tuple[Array, NDArray[np.bool_], Array]:
    """The paper's directions (n, 3), θ = 0 once; which are held out, and the solid angle of each."""
    ring, azimuth = (a.ravel() for a in np.meshgrid(np.arange(1, 17), np.arange(72), indexing="ij"))
    ring, azimuth = np.r_[0, ring], np.r_[0, azimuth]
    lights = frames.direction(np.radians(5.0 * ring), np.radians(5.0 * azimuth))
    return lights, ((ring + azimuth) % 4 == 0) & (ring > 0), np.sin(np.radians(np.maximum(5.0 * ring, 1.25)))


def cloth(net: Net, lights: Array, rng: np.random.Generator) -> Single:
    """T (texel, 3, light) of texels that are made of facets of one material, seen from N."""
    T = np.zeros((TEXELS, 3, len(lights)))
    for texel in T:
        tilt, azimuth = rng.uniform(0, TILT), rng.uniform(-np.pi, np.pi)
        mean = np.tan(tilt) * np.array([np.cos(azimuth), np.sin(azimuth)])
        for slopes in mean + rng.normal(size=(FACETS, 2)) * SPREAD:
            n = np.array([*slopes, 1.0]) / np.sqrt(1 + slopes @ slopes)
            x = np.array([1.0, 0, 0]) - n[0] * n
            x /= np.linalg.norm(x)
            local = lights @ np.stack([x, np.cross(n, x), n]).T
            view = np.broadcast_to([x[2], np.cross(n, x)[2], n[2]], local.shape)
            seen = np.where(local[:, 2] > 0.02, local[:, 2], 0)
            texel += (brdf(net, local, view) * seen[:, None]).T / FACETS
    return T.astype(np.float32)


def _material(net: Net, rng: np.random.Generator) -> dict[str, float]:
    lights, held, weight = grid()
    clean = cloth(net, lights, rng)
    clean /= clean.max()
    noise = rng.standard_normal((2, *clean.shape))
    seen = (clean * (1 + NOISE * noise[0]) + 5e-5 * noise[1]).astype(np.float32)
    T, W = np.ascontiguousarray(seen[..., ~held]), np.ones((TEXELS, int((~held).sum())), np.float32)
    known, asked = lights[~held], lights[held]
    steps = takeda.four_steps(T, known, np.radians(2.5), np.radians(2.6))
    lobe = Takeda2008().value((0.0, 0.0, 1.0), tuple(asked.T), [steps.shapes[:, k, None] for k in range(4)])
    C = steps.colours[..., None]
    region = np.zeros(TEXELS, np.intp)

    def lobes(tail: str, count: int, at: Array) -> Single:
        priors = learned.learn_priors(T, W, known, region, 1, tail, count)
        return predict(slope.fit(T, W, known, tail, count, priors, region), at, tail)

    harmonics = basis.fit(T, known, basis.harmonics(16), 1e-6)
    predictions = {
        "four steps": C[:, 0] * lobe[:, None] + C[:, 1] * asked[:, 2],
        "one GGX": lobes("ggx", 1, asked),
        "two Gaussians": lobes("gaussian", 2, asked),
        "with residual": _with_residual(T, W, known, lobes("gaussian", 2, lights), ~held),
        "HSH16": basis.predict(harmonics, asked),
        "interpolation": interpolation.predict(interpolation.fit(T, known, interpolation.linear), asked),
    }
    w, truth = weight[held], clean[..., held]
    energy = (w * truth**2).sum((1, 2))
    errors = {name: np.sqrt((w * (p - truth) ** 2).sum((1, 2)) / energy) for name, p in predictions.items()}
    return {name: round(float(np.median(e)), 4) for name, e in errors.items()}


def _with_residual(T: Single, W: Single, lights: Array, lobes: Single, known: NDArray[np.bool_]) -> Single:
    """T (texel, 3, light) of two Gaussians and what is left of them, as `kinran residual` chooses it.

    Parameters
    ----------
    T, W, lights
        Samples, weights and directions of the known lights.
    lobes : (texel, 3, light) float32
        Prediction of the lobes under all lights.
    known : (light,) bool
    """
    domain, region = f"log:{np.percentile(T, 99.9):.6g}", np.zeros(len(T), np.intp)
    priors = learned.learn_priors(T, W, lights, region, 1, "gaussian", 2)
    choice = residual.cross_validate(T, W, lights, priors, region, domain, ("gaussian", 2))
    if not choice.components:
        return lobes[..., ~known]
    shown, fitted = (compress(a, domain).reshape(-1, a.shape[2]).T for a in (T, lobes))
    left = shown - choice.share * fitted[known]
    mean = left.mean(0)
    factors = residual.principal(left - mean, choice.components)
    kept = Residual(domain, choice.share, *plates(lights, factors, choice.smoothing))
    others = grid()[0][~known]
    picture = choice.share * fitted[~known] + kept.basis(others) @ np.vstack([mean, factors.T @ (left - mean)])
    return np.asarray(expand(picture, domain).T.reshape(len(T), 3, -1), np.float32)
