"""The diffuse term alone: what a texture shows, and what is left for regions without a lobe."""

import numpy as np
from numpy.typing import NDArray


def fit(T: NDArray[np.float32], W: NDArray[np.float32], lights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Weighted least squares of T = C_d cos θ_i, C_d ≥ 0; (texel, 3).

    Parameters
    ----------
    T, W : (texel, 3, light), (texel, light) float32
        Samples and weights; samples that are not finite are left out.
    lights : (light, 3) float
        Unit directions.
    """
    cosine = lights[:, 2]
    weight = np.where(np.isfinite(T).all(1), W, 0) * cosine
    top = np.einsum("tcl,tl->tc", np.where(np.isfinite(T), T, 0), weight)
    return np.maximum(top / np.maximum(weight @ cosine, 1e-12)[:, None], 0)
