"""The reflection models: the one definition that the fit, the relighting and the renderer share.

Every function takes NumPy arrays or Dr.Jit arrays alike; `xp` is the module of their mathematics (``numpy``
or ``drjit``). The modelled quantity is T = f_r cos θ_i in 1/sr, and a lobe is 1 at its centre.
At the measured view V = N:

    T = Σ amplitude · colour · G(h) + amplitude_d · colour_d · max(0, l_z + x l_x + y l_y)

What other views show is extrapolation: see `lobe_lift` and `diffuse_lift`.
"""

from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from kinran_bsdf.colours import TO_REC709
from kinran_bsdf.material import Material
from kinran_bsdf.residual import relit

PI = float(np.pi)
GRAZING = float(np.cos(np.radians(85.0)))


def slope_lobe(
    hx_over_hz: Any,
    hy_over_hz: Any,
    x: Any,
    y: Any,
    xx: Any,
    xy: Any,
    yy: Any,
    tail: str,
    *,
    xp: ModuleType = np,
) -> Any:
    """Elliptical lobe in slope space.

    Parameters
    ----------
    hx_over_hz, hy_over_hz
        Slopes of the half vector.
    x, y
        Mean slope μ.
    xx, xy, yy
        Squared-width matrix S, positive definite; q = dᵀ S⁻¹ d with d = slope − μ.
    tail
        ``gaussian``: exp(−q); ``ggx``: (1 + q)⁻². Both integrate to π √|S| over slopes.
    """
    dx, dy = hx_over_hz - x, hy_over_hz - y
    q = (yy * dx * dx - 2 * xy * dx * dy + xx * dy * dy) / (xx * yy - xy * xy)
    if tail == "gaussian":
        return xp.exp(-q)
    root = 1 / (1 + q)
    return root * root


def takeda_lobe(theta_h: Any, phi_h: Any, theta_n: Any, phi_n: Any, dt: Any, dp: Any, *, xp: ModuleType = np) -> Any:
    """Lobe of Takeda2008, Eq. 3; all in radians.

    The difference of azimuths is wrapped to [−π, π]: the paper does not say so, but without it a lobe at 350°
    is not seen from 10°.
    """
    turn = phi_h - phi_n
    turn = turn - 2 * PI * xp.round(turn / (2 * PI))
    a, b = (theta_h - theta_n) / dt, turn / dp
    return xp.exp(-a * a - b * b)


def diffuse(light: Any, x: Any, y: Any, *, xp: ModuleType = np) -> Any:
    """max(0, l_z + x l_x + y l_y): what a Lambertian facet of slopes (x, y) shows at V = N."""
    lx, ly, lz = light
    return xp.maximum(lz + x * lx + y * ly, 0.0)


def half_slopes(view: Any, light: Any) -> tuple[Any, Any]:
    """Slopes (h_x / h_z, h_y / h_z) of the half vector of two unit vectors, given as triples."""
    z = view[2] + light[2]
    return (view[0] + light[0]) / z, (view[1] + light[1]) / z


def half_angles(view: Any, light: Any, *, xp: ModuleType = np) -> tuple[Any, Any]:
    """Polar angles (θ_h, φ_h) of the half vector of two unit vectors, given as triples; φ_h = 0 at N."""
    x, y, z = view[0] + light[0], view[1] + light[1], view[2] + light[2]
    return xp.atan2(xp.sqrt(x * x + y * y), z), xp.atan2(y, x)


def release(view: Any, light: Any, *, xp: ModuleType = np) -> Any:
    """1 where view or light is N, falling to 0.32 at 30° and 0.004 at 60°: how far data speak there."""
    c = xp.maximum(view[2], light[2])
    c = c * c
    c = c * c
    return c * c


def lobe_lift(view: Any, light: Any, floor: float, *, xp: ModuleType = np) -> Any:
    """What takes a slope lobe from the measured view to another: T = amplitude · colour · G(h) · lift.

    The lobe is read as a distribution of facets, D = G: f_r = D W / (cos θ_v cos θ_l), with V-cavity masking
    [Cook & Torrance 1982, without its factor of 2] released towards the measured view, where masking is in
    the data already: W = min(1, h_z / (v·h) · m), m the larger of min(cos θ_v, cos θ_l) and
    max(cos θ_v, cos θ_l)⁸. Symmetric in v and l; 1 at V = N down to `floor`, the cosine of the lowest
    measured light, from which T fades to 0 at the horizon.
    """
    cv, cl = view[2], light[2]
    z = cv + cl
    x, y = view[0] + light[0], view[1] + light[1]
    tilt = 2 * z / (x * x + y * y + z * z)  # h_z / (v·h)
    masking = xp.minimum(1.0, tilt * xp.maximum(release(view, light, xp=xp), xp.minimum(cv, cl)))
    return masking * cl / (xp.maximum(cv, floor) * xp.maximum(cl, floor))


def diffuse_lift(view: Any, light: Any, x: Any, y: Any, floor: float, *, xp: ModuleType = np) -> Any:
    """Diffuse shape for any view: T = amplitude · colour · this; `diffuse` at V = N.

    f_r = r(v) r(l) with r(w) = 1 + (x w_x + y w_y) / w_z, the projected area of a facet of slopes (x, y) over
    that of the fabric, which is exact for facets that do not shadow each other. r is limited to [0, 2] by
    V-cavity masking, released towards the measured view. Symmetric in v and l.
    """
    cap = 2 / xp.maximum(1 - release(view, light, xp=xp), 1e-4)

    def area(w: Any) -> Any:
        r = 1 + (x * w[0] + y * w[1]) / xp.maximum(w[2], floor)
        return xp.minimum(xp.maximum(r, 0.0), cap)

    return area(view) * area(light) * light[2]


def grazing(theta_max: float) -> float:
    """Cosine from which T fades to the horizon: of 85°, or of the lowest measured light if that is lower."""
    return float(min(GRAZING, max(np.cos(theta_max), 1e-3)))


def diffuse_albedo(x: Any, y: Any, *, xp: ModuleType = np) -> Any:
    """Albedo at V = N of the diffuse shape: ∫ max(0, l_z + x l_x + y l_y) dω = π (1 + √(1 + x² + y²)) / 2."""
    return 0.5 * PI * (1 + xp.sqrt(1 + x * x + y * y))


def slope_albedo(x: Any, y: Any, xx: Any, xy: Any, yy: Any, *, xp: ModuleType = np) -> Any:
    """Albedo at V = N of a slope lobe, nearly: 4 ∫ G h_z⁴ dx dy ≈ 4π √|S| / (1 + |μ|² + tr S / 2)²."""
    z = 1 / (1 + x * x + y * y + 0.5 * (xx + yy))
    return 4 * PI * xp.sqrt(xp.maximum(xx * yy - xy * xy, 0.0)) * z * z


def takeda_albedo(theta: Any, dt: Any, dp: Any, *, xp: ModuleType = np) -> Any:
    """Albedo at V = N of Eq. 3's lobe, in closed form: ≈ 2π dt dp sin 2θ_n away from the pole."""
    sine = xp.maximum(xp.sin(theta), 0.5 * dt)
    return 4 * PI * dt * xp.minimum(dp, 2 * PI**0.5) * sine * xp.maximum(xp.cos(theta), 0.05)


def relight(material: Material, lights: ArrayLike) -> NDArray[np.float32]:
    """The fabric at the measured view V = N under directional lights.

    The albedo clamp `bound` is not applied: this is what was fitted.

    Parameters
    ----------
    material
        Maps of the fabric.
    lights : (n, 3) float
        Unit directions, away from the surface.

    Returns
    -------
    (n, H, W, 3) float32
        π T in the RGB of the radiance stack (by the inverse of `from_stack`); row 0 is v = 0.
    """
    directions = np.atleast_2d(np.asarray(lights, np.float64))
    height, width = material.size
    images = np.empty((len(directions), height, width, 3), np.float32)
    rows = max(1, (1 << 16) // width)  # a block stays in the cache while all lights pass over it
    for top in range(0, height, rows):
        block = slice(top, min(top + rows, height))
        terms = _terms(material, block)
        for k, light in enumerate(directions):
            images[k, block] = _radiance(material, terms, light)
        if material.residual is not None:
            maps = material.residual_maps(block)
            for k, factors in enumerate(material.residual.basis(directions)):
                images[k, block] = relit(images[k, block], material.residual, maps, factors)
    return images


def relight_texels(material: Material, lights: ArrayLike, view: ArrayLike) -> NDArray[np.float32]:
    """The lobes of a fabric as they were measured, each texel under its own lights and seen from its own direction.

    Near N these are what the lobes were fitted to; nothing of `lobe_lift` is in them, which is of other views.

    Parameters
    ----------
    material
        Maps of the fabric; its residual is left out.
    lights : (n, H, W, 3) float
        Unit directions towards the lights.
    view : (H, W, 3) float
        Unit directions towards the camera.

    Returns
    -------
    (n, H, W, 3) float32
        As of `relight`.
    """
    (colour, (x, y)), *lobes = _terms(material, slice(None))
    towards = np.moveaxis(np.asarray(view, np.float32), -1, 0)
    images = np.empty((len(np.asarray(lights)), *material.size, 3), np.float32)
    for k, light in enumerate(np.moveaxis(np.asarray(lights, np.float32), -1, 1)):
        images[k] = colour * diffuse(tuple(light), x, y)[..., None]
        for strength, shape in lobes:
            if material.model == "takeda2008":
                value = takeda_lobe(*half_angles(towards, light), *shape)
            else:
                mx, my, xx, xy, yy = shape
                value = slope_lobe(*half_slopes(towards, light), mx, my, xx, xy, yy, material.tail)
            images[k] += strength * value[..., None]
    return images


def _terms(material: Material, rows: slice) -> list[tuple[NDArray[np.float32], NDArray[np.float32]]]:
    """Colours in the RGB of the stack, and shapes (n, h, W)."""
    back = np.linalg.inv(material.from_stack).T.astype(np.float32) * np.float32(np.pi)
    return [(c @ back, np.ascontiguousarray(np.moveaxis(s, -1, 0))) for c, s in material.terms(rows)]


def _radiance(
    material: Material,
    terms: list[tuple[NDArray[np.float32], NDArray[np.float32]]],
    light: NDArray[np.float64],
) -> NDArray[np.float32]:
    view, l = (0.0, 0.0, 1.0), tuple(float(v) for v in light)  # noqa: E741 (the field's letter)
    if l[2] <= 0:
        return np.zeros_like(terms[0][0])
    floor = grazing(material.theta_max)
    (colour, (x, y)), *lobes = terms
    result = colour * diffuse_lift(view, l, x, y, floor)[..., None]
    for colour, shape in lobes:
        result += colour * lobe(material.model, material.tail, view, l, list(shape), floor)[..., None]
    return result


def lobe(model: str, tail: str, view: Any, light: Any, shape: list[Any], floor: float, *, xp: ModuleType = np) -> Any:
    """Lobe of a model for a view and a light: T / (amplitude · colour).

    `takeda2008` is Eq. 3 to the letter at every view: the half vector alone.

    Parameters
    ----------
    shape
        slope: x, y, xx, xy, yy; takeda2008: theta, phi, dt, dp.
    """
    if model == "takeda2008":
        return takeda_lobe(*half_angles(view, light, xp=xp), *shape, xp=xp)
    x, y, xx, xy, yy = shape
    value = slope_lobe(*half_slopes(view, light), x, y, xx, xy, yy, tail, xp=xp)
    return value * lobe_lift(view, light, floor, xp=xp)


def albedo(material: Material, nodes: int = 24) -> NDArray[np.float32]:
    """Albedo at V = N of each texel: ∫ T dω over the lights above the horizon.

    Parameters
    ----------
    nodes
        Number of quadrature nodes per dimension, placed where the lobe is.

    Returns
    -------
    (H, W, 3) float32, ACEScg
    """
    (colour, slopes), *lobes = material.terms()
    total = colour * diffuse_albedo(slopes[..., 0], slopes[..., 1])[..., None]
    integral = _takeda_integral if material.model == "takeda2008" else _slope_integral
    for colour, shape in lobes:
        total += colour * integral(np.moveaxis(shape, -1, 0), material.tail, nodes)[..., None]
    return total.astype(np.float32)


def clamp(material: Material) -> NDArray[np.float32]:
    """The channel `bound`: factor (H, W) in (0, 1] that brings the albedo at V = N to at most 1.

    In each band of ACEScg, and of Rec.709, where a saturated colour has more.
    """
    there = albedo(material)
    peak = np.maximum(there.max(-1), (there @ TO_REC709.T).max(-1))
    return (1 / np.maximum(peak, 1)).astype(np.float32)


def _slope_integral(shape: NDArray[np.float32], tail: str, nodes: int) -> NDArray[np.float32]:
    """4 ∫ G h_z⁴ dx dy over slopes under 1 (lights above the horizon), by equal-energy nodes of the lobe."""
    x, y, xx, xy, yy = shape
    a = np.sqrt(xx)
    b, c = xy / a, np.sqrt(np.maximum(yy - xy * xy / xx, 0))
    total = np.zeros_like(x)
    for i in range(nodes):
        u = (i + 0.5) / nodes
        r = np.sqrt(-np.log1p(-u) if tail == "gaussian" else u / (1 - u))
        for j in range(nodes):
            turn = 2 * PI * (j + 0.5 * (i % 2)) / nodes
            p, q = float(r * np.cos(turn)), float(r * np.sin(turn))
            square = (x + a * p) ** 2 + (y + b * p + c * q) ** 2
            total += (square < 1) / (1 + square) ** 2
    return total * a * c * np.float32(4 * PI / nodes**2)


def _takeda_integral(shape: NDArray[np.float32], tail: str, nodes: int) -> NDArray[np.float32]:
    """∫ G 2 sin 2θ_h dθ_h dφ_h over θ_h < 45° (lights above the horizon): a product of two integrals."""
    theta, _, dt, dp = shape
    low, high = np.clip(theta - 4 * dt, 0, PI / 4), np.clip(theta + 4 * dt, 0, PI / 4)
    reach = np.minimum(PI, 4 * dp)
    polar, azimuthal = np.zeros_like(theta), np.zeros_like(theta)
    for i in range(nodes):
        u = (i + 0.5) / nodes
        angle = low + (high - low) * u
        polar += np.exp(-(((angle - theta) / dt) ** 2)) * 2 * np.sin(2 * angle)
        azimuthal += np.exp(-((reach * u / dp) ** 2))
    return polar * (high - low) * azimuthal * 2 * reach * np.float32(1 / nodes**2)
