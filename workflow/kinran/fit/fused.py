"""The fast solver: variable projection in single precision, a few microseconds a texel.

What an iteration of `kinran.fit.varpro` needs are inner products over the lights: of the derivatives of the
lobes, of their values, and of what the last colours leave of the data. Those are the rows of one matrix R, all
weighted by the roots of the samples' weights, and R Rᵀ, in blocks of 4 × 4 that stay in registers, holds cost,
gradient and projected normal matrix at once. The residual, not the data, stands in R, so that the cost does not
come from a difference of large numbers. The small systems are solved in double precision.

A lone lobe over an untilted diffuse term is fitted to one channel: the data along the colour of its highlight.
With that colour its optimum is that of the three channels.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from kinran.fit.linear import RIDGE, cholesky_solve, invert, nonnegative, nonnegative2
from kinran.fit.lobes import DIFFUSE_SIZE, LOBE_SIZE, confine
from kinran.fit.rows import diffuse_rows, dot, gram, lobe_derivatives, lobe_values, remainder, scaled, take
from kinran.fit.start import highlight, wider

Array = NDArray[np.float64]
Single = NDArray[np.float32]
f4 = np.float32

DAMPING_START, DAMPING_DOWN, DAMPING_UP = 5e-2, 0.5, 4.0
TRIES = 6


@njit(cache=True, nogil=True, error_model="numpy")
def layout(lobes: int, bent: bool) -> tuple[int, int, int, int, int]:
    """Numbers of shapes, columns and channels, the row of the first residual, and rows in all, a multiple of 4."""
    shapes = LOBE_SIZE * lobes + (DIFFUSE_SIZE if bent else 0)
    channels = 1 if lobes == 1 and not bent else 3
    rest = shapes + lobes + 1
    return shapes, lobes + 1, channels, rest, (rest + channels + 3) // 4 * 4


@njit(cache=True, nogil=True, error_model="numpy")
def evaluate(
    tail: int,
    lobes: int,
    bent: bool,
    p: Array,
    C: Array,
    S: Single,
    L: Single,
    root: Single,
    Y: Single,
    scale: Single,
    R: Single,
    M: Array,
) -> None:
    """Products M of all rows for shapes p, with the residual of the colours C (columns, channels)."""
    shapes, _, channels, first_rest, _ = layout(lobes, bent)
    first_value = shapes
    diffuse_column = shapes + lobes
    for k in range(lobes):
        at = LOBE_SIZE * k
        lobe_values(tail, p[at : at + LOBE_SIZE], S, root, R[first_value + k], scale)
        lobe_derivatives(p[at : at + LOBE_SIZE], S, scale, R[at : at + LOBE_SIZE])
    if bent:
        at = LOBE_SIZE * lobes
        diffuse_rows(p[at], p[at + 1], L, root, R[at : at + DIFFUSE_SIZE], R[diffuse_column])
    for c in range(channels):
        rest = R[first_rest + c]
        remainder(Y[c], R[first_value], R[diffuse_column], C[0, c], C[lobes, c], rest)
        if lobes == 2:
            remainder(rest, R[first_value + 1], R[first_value + 1], C[1, c], 0.0, rest)
    gram(R, M)


@njit(cache=True, nogil=True, error_model="numpy")
def colours(lobes: int, bent: bool, M: Array, C: Array, out: Array, work: Array) -> float:
    """Best colours `out` for the shapes of M, whose residual is that of C; returns the cost."""
    shapes, columns, channels, first_rest, _ = layout(lobes, bent)
    first_value = shapes
    A, b, x, scratch = work[:columns], work[columns], work[columns + 1], work[columns + 2 :]
    for a in range(columns):
        for k in range(a + 1):
            A[a, k] = A[k, a] = M[first_value + a, first_value + k]
    cost = 0.0
    for c in range(channels):
        rest = M[first_rest + c]
        for a in range(columns):
            b[a] = rest[first_value + a]
            for k in range(columns):
                b[a] += A[a, k] * C[k, c]
        if lobes == 1:
            nonnegative2(A, b, x)
        else:
            nonnegative(A, b, columns, x, scratch)
        cost += rest[first_rest + c]
        for a in range(columns):
            out[a, c] = x[a]
            step = x[a] - C[a, c]
            cost -= 2.0 * step * rest[first_value + a]
            for k in range(columns):
                cost += step * A[a, k] * (x[k] - C[k, c])
    return max(cost, 0.0)


@njit(cache=True, nogil=True, error_model="numpy")
def normal_equations(
    lobes: int, bent: bool, M: Array, before: Array, C: Array, H: Array, g: Array, work: Array
) -> None:
    """Kaufman's projected normal matrix and gradient for colours C; the residual in M is that of `before`."""
    shapes, columns, channels, first_rest, _ = layout(lobes, bent)
    first_value = shapes
    A, inverse, x, X = work[:columns], work[columns : 2 * columns], work[2 * columns], work[2 * columns + 1 :]
    # a column that holds nothing is outside the active set and has no part in the projection
    for a in range(columns):
        total = 0.0
        for c in range(channels):
            total += C[a, c]
        x[a] = 1.0 if total > 0.0 else 0.0
    for a in range(columns):
        for k in range(a):
            A[a, k] = A[k, a] = M[first_value + a, first_value + k] * x[a] * x[k]
        A[a, a] = M[first_value + a, first_value + a] * (1.0 + RIDGE) + 1e-14
    invert(A, columns, inverse)
    for k in range(shapes):
        for a in range(columns):
            X[k, a] = M[first_value + a, k] * x[a]
        g[k] = 0.0
        for c in range(channels):
            r = M[first_rest + c, k]
            for a in range(columns):
                r -= M[first_value + a, k] * (C[a, c] - before[a, c])
            g[k] += C[min(k // LOBE_SIZE, lobes), c] * r
    for k in range(shapes):
        for a in range(columns):
            x[a] = 0.0
            for j in range(columns):
                x[a] += inverse[a, j] * X[k, j]
        for j in range(k + 1):
            value = M[k, j]
            for a in range(columns):
                value -= x[a] * X[j, a]
            colour = 0.0
            for c in range(channels):
                colour += C[min(k // LOBE_SIZE, lobes), c] * C[min(j // LOBE_SIZE, lobes), c]
            H[k, j] = H[j, k] = value * colour


@njit(cache=True, nogil=True, error_model="numpy")
def penalty(p: Array, centre: Array, stiffness: Array) -> float:
    total = 0.0
    for k in range(stiffness.size):
        total += stiffness[k] * (p[k] - centre[k]) ** 2
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def final(
    tail: int, p: Array, S: Single, L: Single, root: Single, Y: Single, R: Single, scale: Single, C: Array, work: Array
) -> float:
    """Colours of the three channels for fixed shapes; returns the cost."""
    first_value, diffuse_column, columns = LOBE_SIZE, LOBE_SIZE + 1, 2
    g, m = R[first_value], R[diffuse_column]
    lobe_values(tail, p[:LOBE_SIZE], S, root, g, scale)
    A, b, x = work[:columns], work[columns], work[columns + 1]
    A[0, 0], A[1, 1] = dot(g, g), dot(m, m)
    A[0, 1] = A[1, 0] = dot(g, m)
    cost = 0.0
    for c in range(3):
        b[0], b[1] = dot(g, Y[c]), dot(m, Y[c])
        cost += dot(Y[c], Y[c]) + nonnegative2(A, b, x)
        C[0, c], C[1, c] = x[0], x[1]
    return max(cost, 0.0)


@njit(cache=True, nogil=True, error_model="numpy")
def descend(
    tail: int,
    lobes: int,
    bent: bool,
    p: Array,
    C: Array,
    S: Single,
    L: Single,
    root: Single,
    Y: Single,
    R: Single,
    scale: Single,
    narrow: float,
    wide: float,
    centre: Array,
    stiffness: Array,
    iterations: int,
    tolerance: float,
    big: Array,
    small: Array,
) -> float:
    """Levenberg-Marquardt from the shapes p (in place); colours into C, the cost without the prior returned."""
    shapes, columns, channels, _, _ = layout(lobes, bent)
    M, M_new = big[0], big[1]
    H, damped, F = big[2, :shapes, :shapes], big[3, :shapes, :shapes], big[4, :shapes, :shapes]
    g, step, trial = small[0, :shapes], small[1, :shapes], small[2, : p.size]
    work = big[5, :, :columns]
    before, new = big[6, :columns, :channels], big[7, :columns, :channels]
    before[:] = 0.0
    confine(p, lobes, narrow, wide)
    evaluate(tail, lobes, bent, p, before, S, L, root, Y, scale, R, M)
    data = colours(lobes, bent, M, before, C, work)
    cost = data + penalty(p, centre, stiffness)
    damping = DAMPING_START
    for _ in range(iterations):
        normal_equations(lobes, bent, M, before, C, H, g, work)
        for k in range(shapes):
            H[k, k] += stiffness[k]
            g[k] -= stiffness[k] * (p[k] - centre[k])
        accepted, gain = False, 0.0
        for _try in range(TRIES):
            for k in range(shapes):
                for j in range(shapes):
                    damped[k, j] = H[k, j]
                damped[k, k] = H[k, k] * (1.0 + damping) + 1e-12 * (1.0 + H[k, k])
            if cholesky_solve(damped, g, shapes, F, step):
                trial[:] = p
                for k in range(shapes):
                    trial[k] += min(max(step[k], -1.0), 1.0)
                confine(trial, lobes, narrow, wide)
                evaluate(tail, lobes, bent, trial, C, S, L, root, Y, scale, R, M_new)
                new_data = colours(lobes, bent, M_new, C, new, work)
                new_cost = new_data + penalty(trial, centre, stiffness)
                if new_cost < cost:
                    accepted = True
                    gain = cost - new_cost
                    break
            damping *= DAMPING_UP
        if not accepted:
            break
        p[:] = trial
        before[:] = C
        C[:] = new
        M, M_new = M_new, M
        data, cost = new_data, new_cost
        damping = max(damping * DAMPING_DOWN, 1e-9)
        if gain < tolerance * (cost + gain):
            break
    return data


@njit(cache=True, nogil=True, error_model="numpy")
def fit_block(
    tail: int,
    lobes: int,
    bent: bool,
    T: Single,
    W: Single,
    S: Single,
    L: Single,
    solid: Single,
    narrow: Array,
    wide: float,
    centre: Array,
    stiffness: Array,
    iterations: int,
    tolerance: float,
    warm: bool,
    P: Array,
    C: Array,
    F: Array,
) -> None:
    """Fit a block of texels.

    Parameters
    ----------
    T, W : (texel, 3, light), (texel, light)
        Samples and weights; 0 leaves a sample out, as does NaN or infinity.
    S, L, solid : (2, light), (3, light), (light,)
        Half-vector slopes, directions, and the solid angle that a light stands for.
    narrow : (texel,)
        Smallest width of a lobe; `wide` is the largest.
    centre, stiffness : (texel, K)
        Prior: F + Σ ρ_k (p_k - p̄_k)².
    warm
        Whether the shapes P are the start.
    P, C, F
        Results: shapes (texel, K), colours (texel, columns, 3), weighted squared residual (texel,).
    """
    shapes, columns, channels, _, rows = layout(lobes, bent)
    diffuse_column = shapes + lobes
    n = W.shape[1]
    root, y, scale, Y, R = (
        np.empty(n, f4),
        np.empty(n, f4),
        np.empty(n, f4),
        np.empty((3, n), f4),
        np.zeros((rows, n), f4),
    )
    side = max(rows, 2 * columns + 1 + shapes, 3 * columns + 6)
    big, small = np.zeros((8, side, side)), np.zeros((3, side))
    best, one, zero = np.zeros((columns, channels)), np.zeros((1, n), f4), np.zeros(n, f4)
    p = np.zeros(LOBE_SIZE * lobes + DIFFUSE_SIZE)
    tint, work = np.zeros(3), np.zeros((2 * columns + 3 + columns, columns))
    for t in range(len(T)):
        take(T[t], W[t], root, Y, y)
        if not bent:
            scaled(L[2], root, R[diffuse_column])
        if warm:
            p[:] = P[t]
        else:
            p[:] = 0.0
            highlight(tail, y, S, L[2], root, solid, Y, p, tint)
            if lobes == 2:
                wider(p)
        if channels == 1:
            norm = math.sqrt(tint[0] ** 2 + tint[1] ** 2 + tint[2] ** 2)
            if norm > 0.0:
                tint /= -norm
            else:
                tint[:] = -1.0 / math.sqrt(3.0)
            remainder(zero, Y[0], Y[1], tint[0], tint[1], one[0])
            remainder(one[0], Y[2], Y[2], tint[2], 0.0, one[0])
            F[t] = descend(
                tail,
                lobes,
                bent,
                p,
                best,
                S,
                L,
                root,
                one,
                R,
                scale,
                narrow[t],
                wide,
                centre[t],
                stiffness[t],
                iterations,
                tolerance,
                big,
                small,
            )
        else:
            F[t] = descend(
                tail,
                lobes,
                bent,
                p,
                best,
                S,
                L,
                root,
                Y,
                R,
                scale,
                narrow[t],
                wide,
                centre[t],
                stiffness[t],
                iterations,
                tolerance,
                big,
                small,
            )
            C[t] = best
        P[t] = p
        if channels == 1:
            F[t] = final(tail, p, S, L, root, Y, R, scale, C[t], work)
