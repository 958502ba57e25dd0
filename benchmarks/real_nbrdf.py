"""Error of the fit on measured BRDFs on tilted facets, given by the networks of Neural-BRDF [Sztrajman2021]."""

import io
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinran.base import frames
from kinran.base.files import InputError
from kinran.compare.baselines import basis, interpolation
from kinran.compare.lobes_and_residual import left_by
from kinran.data.texel_directions import Under
from kinran.fit import learned_priors, residual, slope, takeda
from kinran.fit.fitted_model import Fitted
from kinran.fit.harmonics import harmonics
from kinran.fit.region_priors import Prior
from kinran.fit.samples import Samples
from kinran.fit.slope import SlopeFit
from kinran.fit.slope_lobes import Lobes

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
PAIR = Lobes("gaussian", 2)
TEXELS, FACETS = 48, 24
"""Texels of a material, and facets of each texel. Choices."""
TILT = np.radians(18.0)
"""Largest tilt of a texel, in radians. A choice."""
SPREAD = (0.12, 0.03)
"""Standard deviations of the slopes of a texel's facets along x and y. A choice: a thread that is ridged along it."""
NOISE = 0.01
"""Standard deviation of the noise, relative to a sample. A choice."""
UNRESOLVED = 0.25
"""Error of interpolation between neighbouring lights from which on the grid does not resolve a material. A choice."""


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
    T = np.ascontiguousarray(seen[..., ~held])
    samples = Samples.far(T, np.ones((TEXELS, T.shape[2]), np.float32), lights[~held])
    fits: dict[str, Fitted] = {
        "four steps": takeda.four_steps(samples, np.radians(2.5), np.radians(2.6)),
        "one GGX": _lobes(samples, Lobes("ggx", 1))[0],
        "two Gaussians": _lobes(samples, PAIR)[0],
        "with residual": _with_residual(samples),
        "HSH16": basis.fit(samples, harmonics(16), basis.RIDGE),
        "interpolation": interpolation.fit(samples, interpolation.linear),
    }
    w, truth, asked = weight[held], clean[..., held], Under.far(lights[held], TEXELS)
    energy = (w * truth**2).sum((1, 2))
    errors = {name: np.sqrt((w * (f.predict(asked) - truth) ** 2).sum((1, 2)) / energy) for name, f in fits.items()}
    return {name: round(float(np.median(e)), 4) for name, e in errors.items()}


def _lobes(samples: Samples, lobes: Lobes) -> tuple[SlopeFit, list[Prior]]:
    """Fit lobes under the prior of one region, and return the fit and the prior."""
    priors = learned_priors.learn_priors(samples, 1, lobes)
    return slope.fit(samples, lobes, priors), priors


def _with_residual(samples: Samples) -> Fitted:
    """Fit two Gaussian lobes and the residual that `kinran residual` chooses."""
    fitted, priors = _lobes(samples, PAIR)
    domain = f"log:{np.percentile(samples.T, 99.9):.6g}"
    choice = residual.cross_validate(samples, PAIR, priors, domain)
    if not choice.components:
        return fitted
    return left_by(fitted, samples, domain, choice.components, choice.share, choice.smoothing)
