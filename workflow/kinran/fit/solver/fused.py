"""The fast solver: variable projection in single precision, a few microseconds a texel.

What an iteration of variable projection needs are inner products over the lights: of the derivatives of the lobes, of
their values, and of what the last colours leave of the data. Those are the rows of one matrix R, all
weighted by the roots of the samples' weights, and R Rᵀ, in blocks of 4 × 4 that stay in registers, holds cost,
gradient and projected normal matrix at once. The residual, not the data, stands in R, so that the cost does not
come from a difference of large numbers. The small systems are solved in double precision.

A Gaussian lobe between lights is seen by nothing but its flanks: the fit could make it as bright as it likes. Where
asked, a prior on amplitudes, worth `UNSEEN` samples in which a lobe's peak is dark, makes it no brighter than it has
to be. The tail of a GGX lobe reaches the lights around it, and tells.

A lone lobe over an untilted diffuse term is fitted to one channel: the data along the colour of its highlight.
With that colour its optimum is that of the three channels.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from kinran.fit.solver.linear import RIDGE, cholesky_solve, invert, nonnegative, nonnegative2
from kinran.fit.solver.lobes import DIFFUSE_SIZE, GAUSSIAN, GGX, LOBE_SIZE, confine
from kinran.fit.solver.rows import along, diffuse_rows, gram, lobe_products, lobe_rows, remainder, take
from kinran.fit.solver.start import highlight, pair

Array = NDArray[np.float64]
Single = NDArray[np.float32]
f4 = np.float32

DAMPING_START, DAMPING_DOWN, DAMPING_UP = 5e-2, 0.5, 4.0
"""Damping of Levenberg-Marquardt at the start, and its factors after a step that gains, or does not. A choice."""
TRIES = 6
"""Dampings that are tried for one step."""
UNSEEN = 3e-4
"""Samples, of weight 1, that say that the peak of a Gaussian lobe is dark."""
SINGULAR = 1e-9
"""Share of the product of its diagonal under which the determinant of a matrix is noise."""


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
    shapes, columns, channels, first_rest, _ = layout(lobes, bent)
    for k in range(lobes):
        lobe_rows(tail, p, LOBE_SIZE * k, S, root, scale, R, shapes + k)
    if bent:
        diffuse_rows(p, LOBE_SIZE * lobes, L, root, R, shapes + lobes)
    for c in range(channels):
        remainder(Y, c, R, shapes, columns, C, first_rest + c)
    gram(R, M)


@njit(cache=True, nogil=True, error_model="numpy")
def colours(lobes: int, bent: bool, dark: float, M: Array, C: Array, out: Array, work: Array) -> float:
    """Best colours `out` for the shapes of M, whose residual is that of C; returns the cost without the prior.

    `dark` is the weight of the prior on amplitudes.
    """
    shapes, columns, channels, first_rest, _ = layout(lobes, bent)
    A, inverse, b, x, scratch = work[:3], work[3:6], work[6], work[7], work[8:]
    largest = 1.0
    for a in range(columns):
        for k in range(a + 1):
            A[a, k] = A[k, a] = M[shapes + a, shapes + k]
        largest *= A[a, a]
    for a in range(lobes):
        A[a, a] += dark
    clear = False
    if columns == 3:
        clear = invert(A, columns, inverse) > SINGULAR * largest
    cost = 0.0
    for c in range(channels):
        rest = first_rest + c
        for a in range(columns):
            b[a] = M[rest, shapes + a]
            for k in range(columns):
                b[a] += A[a, k] * C[k, c]
            if a < lobes:
                b[a] -= dark * C[a, c]
        if columns == 2:
            nonnegative2(A, b, x)
        else:
            positive = clear
            for a in range(columns):
                x[a] = inverse[a, 0] * b[0] + inverse[a, 1] * b[1] + inverse[a, 2] * b[2]
                positive &= x[a] >= 0.0
            if not positive:
                nonnegative(A, b, columns, x, scratch)
        cost += M[rest, rest]
        for a in range(columns):
            out[a, c] = x[a]
            step = x[a] - C[a, c]
            cost -= 2.0 * step * M[rest, shapes + a]
            for k in range(columns):
                cost += step * A[a, k] * (x[k] - C[k, c])
            if a < lobes:
                cost -= dark * step * step
    return max(cost, 0.0)


@njit(cache=True, nogil=True, error_model="numpy")
def normal_equations(
    lobes: int, bent: bool, dark: float, M: Array, before: Array, C: Array, H: Array, g: Array, work: Array
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
        A[a, a] = M[first_value + a, first_value + a] * (1.0 + RIDGE) + (dark if a < lobes else 0.0) + 1e-14
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
def penalty(p: Array, centre: Array, stiffness: Array, dark: float, C: Array, lobes: int, channels: int) -> float:
    """Cost of the priors on shapes and amplitudes."""
    total = 0.0
    for k in range(stiffness.size):
        total += stiffness[k] * (p[k] - centre[k]) ** 2
    for k in range(lobes):
        for c in range(channels):
            total += dark * C[k, c] * C[k, c]
    return total


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
    dark: float,
    iterations: int,
    tolerance: float,
    big: Array,
    small: Array,
) -> float:
    """Levenberg-Marquardt from the shapes p (in place); colours into C, the cost without the priors returned."""
    shapes, _, channels, _, _ = layout(lobes, bent)
    M, M_new = big[0], big[1]
    H, damped, F = big[2], big[3], big[4]
    g, step, trial = small[0], small[1], small[2, : p.size]
    work = big[5]
    before, new = big[6, :3, :3], big[7, :3, :3]
    before[:] = 0.0
    confine(p, lobes, narrow, wide)
    evaluate(tail, lobes, bent, p, before, S, L, root, Y, scale, R, M)
    data = colours(lobes, bent, dark, M, before, C, work)
    cost = data + penalty(p, centre, stiffness, dark, C, lobes, channels)
    damping = DAMPING_START
    for _ in range(iterations):
        normal_equations(lobes, bent, dark, M, before, C, H, g, work)
        largest = 0.0
        for k in range(shapes):
            H[k, k] += stiffness[k]
            largest = max(largest, H[k, k])
            g[k] -= stiffness[k] * (p[k] - centre[k])
        accepted, gain = False, 0.0
        for _try in range(TRIES):
            for k in range(shapes):
                for j in range(shapes):
                    damped[k, j] = H[k, j]
                damped[k, k] = H[k, k] * (1.0 + damping) + 1e-12 * largest
            if cholesky_solve(damped, g, shapes, F, step):
                expected = 0.0
                for k in range(shapes):
                    expected += step[k] * (g[k] + damping * H[k, k] * step[k])
                if expected < tolerance * cost:
                    break
                trial[:] = p
                for k in range(shapes):
                    trial[k] += min(max(step[k], -1.0), 1.0)
                confine(trial, lobes, narrow, wide)
                evaluate(tail, lobes, bent, trial, C, S, L, root, Y, scale, R, M_new)
                new_data = colours(lobes, bent, dark, M_new, C, new, work)
                new_cost = new_data + penalty(trial, centre, stiffness, dark, new, lobes, channels)
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
def lone(
    tail: int,
    p: Array,
    tint: Array,
    C: Array,
    S: Single,
    L: Single,
    root: Single,
    Y: Single,
    one: Single,
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
) -> None:
    """`descend` of one lobe over an untilted diffuse term, by the data along `tint`."""
    norm = math.sqrt(tint[0] ** 2 + tint[1] ** 2 + tint[2] ** 2)
    for c in range(3):
        tint[c] = tint[c] / norm if norm > 0.0 else math.sqrt(1.0 / 3.0)
    along(Y, tint, one)
    for i in range(root.size):
        R[LOBE_SIZE + 1, i] = L[2, i] * root[i]
    descend(
        tail, 1, False, p, C, S, L, root, one, R, scale, narrow, wide, centre, stiffness, 0.0, iterations,
        tolerance, big, small,
    )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def colour_lone(tail: int, p: Array, C: Array, S: Single, root: Single, Y: Single, m: Single, work: Array) -> float:
    """Colours C (2, 3) of the three channels for a shape and the diffuse row m; returns the cost."""
    A, B, b, x = work[:2], work[2:4], work[4], work[5]
    cost = lobe_products(tail, p, S, root, m, Y, A, B)
    for c in range(3):
        b[0], b[1] = B[0, c], B[1, c]
        cost += nonnegative2(A, b, x)
        C[0, c], C[1, c] = x[0], x[1]
    return max(cost, 0.0)


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
    dark: Array,
    iterations: int,
    scouts: int,
    tolerance: float,
    warm: bool,
    P: Array,
    C: Array,
    F: Array,
) -> None:
    """Fit a block of texels. Arguments stand alone: as members of named tuples they cost a lone lobe 7 % (docs/fit.md).

    Parameters
    ----------
    T, W : (texel, 3, light), (texel, light)
        Samples and weights; 0 leaves a sample out, as does NaN or infinity.
    S, L, solid : (2, row), (3, row), (row,)
        Half-vector slopes, directions, and the solid angle that a light stands for; zeros beyond the last light.
    narrow : (texel,)
        Smallest width of a lobe; `wide` is the largest.
    centre, stiffness : (texel, K)
        Prior: F + Σ ρ_k (p_k - p̄_k)².
    dark : (texel,) bool
        Whether a prior holds the amplitudes of Gaussian lobes, one of two or over a bent diffuse term.
    iterations, scouts
        At most; the scouts are those of the lone GGX lobe that two lobes start from.
    warm
        Whether the shapes P are the start.
    P, C, F
        Results: shapes (texel, K), colours (texel, columns, 3), weighted squared residual (texel,).
    """
    shapes, columns, _, _, rows = layout(lobes, bent)
    n = S.shape[1]
    root, y, scale, Y, one = (
        np.zeros(n, f4),
        np.zeros(n, f4),
        np.zeros(n, f4),
        np.zeros((3, n), f4),
        np.zeros((1, n), f4),
    )
    R, R1 = np.zeros((rows, n), f4), np.zeros((layout(1, False)[4], n), f4)
    side = max(rows, 20)
    big, small = np.zeros((8, side, side)), np.zeros((3, side))
    size = LOBE_SIZE * lobes + DIFFUSE_SIZE
    p, first, tint, free = np.zeros(size), np.zeros(size), np.zeros(3), np.zeros(size)
    best = np.zeros((3, 3))
    plain = lobes == 1 and not bent
    for t in range(len(T)):
        take(T, W, t, root, Y, y)
        if plain or not warm:
            first[:] = 0.0
            highlight(GGX if lobes == 2 else tail, y, S, L, solid, root, Y, first, tint)
        if lobes == 2 and not warm:
            lone(
                GGX, first, tint, best, S, L, root, Y, one, R1, scale, narrow[t], wide, free, free, scouts, tolerance,
                big, small,
            )  # fmt: skip
            pair(first)
        p[:] = P[t] if warm else first
        if plain:
            lone(
                tail, p, tint, best, S, L, root, Y, one, R, scale, narrow[t], wide, centre[t], stiffness[t],
                iterations, tolerance, big, small,
            )  # fmt: skip
            F[t] = colour_lone(tail, p, C[t], S, root, Y, R[LOBE_SIZE + 1], big[0])
        else:
            if not bent:
                for i in range(n):
                    R[shapes + lobes, i] = L[2, i] * root[i]
            F[t] = descend(
                tail, lobes, bent, p, best, S, L, root, Y, R, scale, narrow[t], wide, centre[t], stiffness[t],
                UNSEEN if dark[t] and tail == GAUSSIAN else 0.0, iterations, tolerance, big, small,
            )  # fmt: skip
            C[t] = best[:columns]
        P[t] = p
