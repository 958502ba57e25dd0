"""Variable projection in double precision, the reference of `kinran.fit.fused`.

Lobes and a diffuse term are fitted to one texel at a time:

T_c(light) = Σ_k C_k,c G_k(l; p_k) with C ≥ 0 (Takeda2008, Eq. 3, with its lobe in slope space). The linear C are
eliminated by non-negative least squares per channel, the shapes p found by Levenberg-Marquardt with Kaufman's
approximation of the projected Jacobian, under a Gaussian prior on p.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from kinran.fit.linear import RIDGE, cholesky_solve, nonnegative
from kinran.fit.lobes import DIFFUSE_SIZE, LOBE_SIZE, confine, diffuse, lobe

Array = NDArray[np.float64]

DAMPING_START, DAMPING_DOWN, DAMPING_UP = 1e-2, 0.2, 6.0
TRIES = 6
TOLERANCE = 1e-5


@njit(cache=True, nogil=True)
def project(
    tail: int,
    lobes: int,
    p: Array,
    Y: Array,
    w: Array,
    s: Array,
    light: Array,
    G: Array,
    D: Array,
    A: Array,
    C: Array,
) -> float:
    """Weighted squared residual of the best C for shapes p; fills G (n, m), D (n, K), A (m, m), C (m, 3)."""
    m = lobes + 1
    A[:] = 0.0
    b = np.zeros((3, m))
    total = 0.0
    for i in range(w.size):
        for k in range(lobes):
            at = LOBE_SIZE * k
            G[i, k] = lobe(tail, p[at : at + LOBE_SIZE], s[i, 0], s[i, 1], D[i, at : at + LOBE_SIZE])
        at = LOBE_SIZE * lobes
        G[i, lobes] = diffuse(p[at:], light[i, 0], light[i, 1], light[i, 2], D[i, at:])
        for a in range(m):
            weighted = w[i] * G[i, a]
            for c in range(a + 1):
                A[a, c] += weighted * G[i, c]
            for c in range(3):
                b[c, a] += weighted * Y[c, i]
        for c in range(3):
            total += w[i] * Y[c, i] * Y[c, i]
    for a in range(m):
        for c in range(a):
            A[c, a] = A[a, c]
    x, work = np.empty(m), np.empty((2 * m + 3, m))
    for c in range(3):
        total += nonnegative(A, b[c], m, x, work)
        for a in range(m):
            C[a, c] = x[a]
    return max(total, 0.0)


@njit(cache=True, nogil=True)
def normal_equations(
    lobes: int, Y: Array, w: Array, G: Array, D: Array, A: Array, C: Array, H: Array, g: Array
) -> None:
    """Kaufman's projected normal matrix H (K, K) and gradient g (K,) at the current shapes."""
    m, K = lobes + 1, g.size
    X = np.zeros((m, K))
    H[:] = 0.0
    g[:] = 0.0
    for i in range(w.size):
        for k in range(K):
            dk = w[i] * D[i, k]
            for a in range(m):
                X[a, k] += G[i, a] * dk
            for j in range(k + 1):
                H[k, j] += dk * D[i, j]
        for c in range(3):
            r = Y[c, i]
            for a in range(m):
                r -= G[i, a] * C[a, c]
            r *= w[i]
            for k in range(K):
                g[k] += C[min(k // LOBE_SIZE, lobes), c] * D[i, k] * r
    # columns that hold nothing are outside the active set: they do not take part in the projection
    active = np.zeros((m, m))
    for a in range(m):
        for c in range(m):
            active[a, c] = A[a, c]
        if C[a, 0] + C[a, 1] + C[a, 2] <= 0.0:
            active[a, :] = 0.0
            active[:, a] = 0.0
            active[a, a] = 1.0
            X[a, :] = 0.0
        active[a, a] = active[a, a] * (1.0 + RIDGE) + 1e-14
    Z, z, L = np.zeros((m, K)), np.empty(m), np.empty((m, m))
    for k in range(K):
        if cholesky_solve(active, np.ascontiguousarray(X[:, k]), m, L, z):
            Z[:, k] = z
    for k in range(K):
        for j in range(k + 1):
            value = H[k, j]
            for a in range(m):
                value -= X[a, k] * Z[a, j]
            colour = 0.0
            for c in range(3):
                colour += C[min(k // LOBE_SIZE, lobes), c] * C[min(j // LOBE_SIZE, lobes), c]
            H[k, j] = H[j, k] = value * colour


@njit(cache=True, nogil=True)
def penalty(p: Array, centre: Array, stiffness: Array) -> float:
    """Σ ρ_k (p_k - p̄_k)²."""
    total = 0.0
    for k in range(p.size):
        total += stiffness[k] * (p[k] - centre[k]) ** 2
    return total


@njit(cache=True, nogil=True)
def fit_texel(
    tail: int,
    lobes: int,
    p: Array,
    Y: Array,
    w: Array,
    s: Array,
    light: Array,
    narrow: float,
    wide: float,
    centre: Array,
    stiffness: Array,
    iterations: int,
    C: Array,
) -> float:
    """Fit one texel in place: shapes `p` (K,) from their start, colours `C` (m, 3); returns the cost."""
    n, K, m = w.size, p.size, lobes + 1
    G, D, A, H = np.empty((n, m)), np.empty((n, K)), np.empty((m, m)), np.empty((K, K))
    g, step, trial, damped, L = np.empty(K), np.empty(K), np.empty(K), np.empty((K, K)), np.empty((K, K))
    confine(p, lobes, narrow, wide)
    cost = project(tail, lobes, p, Y, w, s, light, G, D, A, C) + penalty(p, centre, stiffness)
    damping = DAMPING_START
    for _ in range(iterations):
        normal_equations(lobes, Y, w, G, D, A, C, H, g)
        for k in range(K):
            H[k, k] += stiffness[k]
            g[k] -= stiffness[k] * (p[k] - centre[k])
        accepted = False
        new = cost
        for _try in range(TRIES):
            damped[:] = H
            for k in range(K):
                damped[k, k] = H[k, k] * (1.0 + damping) + 1e-12 * (1.0 + H[k, k])
            if cholesky_solve(damped, g, K, L, step):
                for k in range(K):
                    trial[k] = p[k] + min(max(step[k], -1.0), 1.0)
                confine(trial, lobes, narrow, wide)
                new = project(tail, lobes, trial, Y, w, s, light, G, D, A, C) + penalty(trial, centre, stiffness)
                if new < cost:
                    accepted = True
                    break
            damping *= DAMPING_UP
        if not accepted:
            break
        gain = (cost - new) / max(cost, 1e-30)
        p[:] = trial
        cost = new
        damping = max(damping * DAMPING_DOWN, 1e-9)
        if gain < TOLERANCE:
            break
    return project(tail, lobes, p, Y, w, s, light, G, D, A, C)


@njit(cache=True, nogil=True)
def moment_start(tail: int, y: Array, s: Array, light: Array, w: Array, p: Array) -> None:
    """Start of one lobe from the moments, in slope space, of what stands above the diffuse floor.

    `y` (n,) is the luminance; the floor is the 20th percentile of y / cos θ_i, the threshold a quarter of the
    third largest sample above it. Fills p (5,).
    """
    n = y.size
    ratios = np.empty(n)
    count = 0
    for i in range(n):
        if light[i, 2] > 0.3 and w[i] > 0.0:
            ratios[count] = y[i] / light[i, 2]
            count += 1
    floor = np.sort(ratios[:count])[count // 5] if count else 0.0
    above = np.empty(n)
    for i in range(n):
        above[i] = max(y[i] - floor * light[i, 2], 0.0)
    threshold = 0.25 * np.sort(above)[max(n - 3, 0)]
    total, mx, my = 1e-12, 0.0, 0.0
    for i in range(n):
        # the solid angle that a direction of a polar grid stands for
        above[i] = max(above[i] - threshold, 0.0) * (math.sqrt(max(1.0 - light[i, 2] ** 2, 0.0)) + 0.02)
        total += above[i]
        mx += above[i] * s[i, 0]
        my += above[i] * s[i, 1]
    mx /= total
    my /= total
    vxx, vxy, vyy = 0.0, 0.0, 0.0
    for i in range(n):
        dx, dy = s[i, 0] - mx, s[i, 1] - my
        vxx += above[i] * dx * dx / total
        vxy += above[i] * dx * dy / total
        vyy += above[i] * dy * dy / total
    inflate = 1.6  # the threshold cut the tails off
    vxx = min(max(inflate * vxx, 5e-4), 0.3)
    vyy = min(max(inflate * vyy, 5e-4), 0.3)
    limit = 0.95 * math.sqrt(vxx * vyy)
    vxy = min(max(inflate * vxy, -limit), limit)
    scale = (2.0 if tail == 0 else 2.5) * (vxx * vyy - vxy * vxy)
    a, b, d = vyy / scale, -vxy / scale, vxx / scale
    p[0], p[1] = mx, my
    p[2] = 0.5 * math.log(a)
    p[3] = b / math.sqrt(a)
    p[4] = 0.5 * math.log(max(d - p[3] * p[3], 1e-3))


@njit(cache=True, nogil=True)
def fit_block(
    tail: int,
    lobes: int,
    T: NDArray[np.float32],
    W: NDArray[np.float32],
    s: Array,
    light: Array,
    narrow: float,
    wide: float,
    centre: Array,
    stiffness: Array,
    iterations: int,
    P: Array,
    C: Array,
    F: Array,
) -> None:
    """Fit a block of texels.

    Parameters
    ----------
    T : (texel, 3, light) float32
        Radiance, finite where its weight is positive.
    W : (texel, light) float32
        Weights; 0 leaves a sample out.
    s, light : (light, 2), (light, 3)
        Half-vector slopes and directions.
    narrow, wide
        Bounds of the lobes' widths.
    centre, stiffness : (texel, K)
        Prior: F + Σ ρ_k (p_k - p̄_k)².
    P, C, F
        Results: shapes (texel, K), colours (texel, m, 3), weighted squared residual (texel,).
    """
    n = s.shape[0]
    Y, w, y = np.empty((3, n)), np.empty(n), np.empty(n)
    for t in range(T.shape[0]):
        for i in range(n):
            w[i] = W[t, i]
            y[i] = 0.0
            for c in range(3):
                Y[c, i] = T[t, c, i] if w[i] > 0.0 else 0.0
                y[i] += Y[c, i] / 3.0
        p = P[t]
        moment_start(tail, y, s, light, w, p[:LOBE_SIZE])
        for k in range(1, lobes):
            # a second lobe starts around the first, wider
            at = LOBE_SIZE * k
            p[at : at + LOBE_SIZE] = p[:LOBE_SIZE]
            p[at : at + 2] *= 0.5
            p[at + 2] -= math.log(2.5)
            p[at + 3] /= 2.5
            p[at + 4] -= math.log(2.5)
        p[LOBE_SIZE * lobes :] = 0.0
        F[t] = fit_texel(tail, lobes, p, Y, w, s, light, narrow, wide, centre[t], stiffness[t], iterations, C[t])


def shape_count(lobes: int) -> int:
    """Number of shape parameters of a texel."""
    return LOBE_SIZE * lobes + DIFFUSE_SIZE
