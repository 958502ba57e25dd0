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
from kinran.fit.solver.values import Data, Fit, Found, Given, Known, Light, Model, Search, System, Texels, Work

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
def layout(model: Model) -> tuple[int, int, int, int, int]:
    """Numbers of shapes, columns and channels, the row of the first residual, and rows in all, a multiple of 4."""
    shapes = LOBE_SIZE * model.lobes + (DIFFUSE_SIZE if model.bent else 0)
    channels = 1 if model.lobes == 1 and not model.bent else 3
    rest = shapes + model.lobes + 1
    return shapes, model.lobes + 1, channels, rest, (rest + channels + 3) // 4 * 4


@njit(cache=True, nogil=True, error_model="numpy")
def evaluate(model: Model, fit: Fit, light: Light, data: Data, work: Work, M: Array) -> None:
    """Products M of all rows for the shapes, with the residual of the colours (columns, channels)."""
    shapes, columns, channels, first_rest, _ = layout(model)
    for k in range(model.lobes):
        lobe_rows(model.tail, fit.p, LOBE_SIZE * k, light.S, data.root, work.scale, work.R, shapes + k)
    if model.bent:
        diffuse_rows(fit.p, LOBE_SIZE * model.lobes, light.L, data.root, work.R, shapes + model.lobes)
    for c in range(channels):
        remainder(data.Y, c, work.R, shapes, columns, fit.C, first_rest + c)
    gram(work.R, M)


@njit(cache=True, nogil=True, error_model="numpy")
def colours(model: Model, dark: float, M: Array, C: Array, out: Array, work: Array) -> float:
    """Best colours `out` for the shapes of M, whose residual is that of C; returns the cost without the prior.

    `dark` is the weight of the prior on amplitudes.
    """
    shapes, columns, channels, first_rest, _ = layout(model)
    lobes = model.lobes
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
def normal_equations(model: Model, dark: float, M: Array, before: Array, C: Array, system: System, work: Array) -> None:
    """Kaufman's projected normal matrix and gradient for colours C; the residual in M is that of `before`."""
    shapes, columns, channels, first_rest, _ = layout(model)
    lobes, H, g = model.lobes, system.H, system.g
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
def penalty(model: Model, known: Known, fit: Fit) -> float:
    """Cost of the priors on shapes and amplitudes."""
    total = 0.0
    for k in range(known.stiffness.size):
        total += known.stiffness[k] * (fit.p[k] - known.centre[k]) ** 2
    for k in range(model.lobes):
        for c in range(layout(model)[2]):
            total += known.dark * fit.C[k, c] * fit.C[k, c]
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def descend(model: Model, fit: Fit, light: Light, data: Data, known: Known, search: Search, work: Work) -> float:
    """Levenberg-Marquardt from the shapes of `fit`, which it changes; returns the cost without the priors."""
    shapes = layout(model)[0]
    p, C, lobes = fit.p, fit.C, model.lobes
    big, small = work.big, work.small
    M, M_new = big[0], big[1]
    H, damped, F = big[2], big[3], big[4]
    g, step, trial = small[0], small[1], small[2, : p.size]
    before, new = big[6, :3, :3], big[7, :3, :3]
    before[:] = 0.0
    confine(p, lobes, known.narrow, known.wide)
    evaluate(model, Fit(p, before), light, data, work, M)
    cost_of_data = colours(model, known.dark, M, before, C, big[5])
    cost = cost_of_data + penalty(model, known, fit)
    damping = DAMPING_START
    for _ in range(search.iterations):
        normal_equations(model, known.dark, M, before, C, System(H, g), big[5])
        largest = 0.0
        for k in range(shapes):
            H[k, k] += known.stiffness[k]
            largest = max(largest, H[k, k])
            g[k] -= known.stiffness[k] * (p[k] - known.centre[k])
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
                if expected < search.tolerance * cost:
                    break
                trial[:] = p
                for k in range(shapes):
                    trial[k] += min(max(step[k], -1.0), 1.0)
                confine(trial, lobes, known.narrow, known.wide)
                evaluate(model, Fit(trial, C), light, data, work, M_new)
                new_data = colours(model, known.dark, M_new, C, new, big[5])
                new_cost = new_data + penalty(model, known, Fit(trial, new))
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
        cost_of_data, cost = new_data, new_cost
        damping = max(damping * DAMPING_DOWN, 1e-9)
        if gain < search.tolerance * (cost + gain):
            break
    return cost_of_data


@njit(cache=True, nogil=True, error_model="numpy")
def lone(tail: int, fit: Fit, tint: Array, light: Light, data: Data, known: Known, search: Search, work: Work) -> None:
    """`descend` of one lobe over an untilted diffuse term, by the data along `tint`."""
    norm = math.sqrt(tint[0] ** 2 + tint[1] ** 2 + tint[2] ** 2)
    for c in range(3):
        tint[c] = tint[c] / norm if norm > 0.0 else math.sqrt(1.0 / 3.0)
    one = np.empty((1, data.root.size), f4)
    along(data.Y, tint, one)
    for i in range(data.root.size):
        work.R[LOBE_SIZE + 1, i] = light.L[2, i] * data.root[i]
    descend(Model(tail, 1, False), fit, light, Data(data.root, one), known, search, work)


@njit(cache=True, nogil=True, error_model="numpy")
def colour_lone(tail: int, fit: Fit, light: Light, data: Data, m: Single, work: Array) -> float:
    """Colours (2, 3) of the three channels for the shape of `fit` and the diffuse row m; returns the cost."""
    A, B, b, x = work[:2], work[2:4], work[4], work[5]
    cost = lobe_products(tail, fit.p, light.S, data.root, m, data.Y, A, B)
    for c in range(3):
        b[0], b[1] = B[0, c], B[1, c]
        cost += nonnegative2(A, b, x)
        fit.C[0, c], fit.C[1, c] = x[0], x[1]
    return max(cost, 0.0)


@njit(cache=True, nogil=True, error_model="numpy")
def fit_block(model: Model, texels: Texels, light: Light, given: Given, search: Search, found: Found) -> None:
    """Fit a block of texels; the shapes of `found` are the start of a warm search."""
    shapes, columns, _, _, rows = layout(model)
    tail, lobes = model.tail, model.lobes
    n = light.S.shape[1]
    data, y, scale = Data(np.zeros(n, f4), np.zeros((3, n), f4)), np.zeros(n, f4), np.zeros(n, f4)
    side = max(rows, 20)
    big, small = np.zeros((8, side, side)), np.zeros((3, side))
    work = Work(np.zeros((rows, n), f4), scale, big, small)
    scout = Work(np.zeros((layout(Model(tail, 1, False))[4], n), f4), scale, big, small)
    size = LOBE_SIZE * lobes + DIFFUSE_SIZE
    p, first, tint, free = np.zeros(size), np.zeros(size), np.zeros(3), np.zeros(size)
    best = np.zeros((3, 3))
    plain = lobes == 1 and not model.bent
    for t in range(len(texels.T)):
        take(texels.T, texels.W, t, data.root, data.Y, y)
        if plain or not search.warm:
            first[:] = 0.0
            highlight(GGX if lobes == 2 else tail, y, light.S, light.L, light.solid, data.root, data.Y, first, tint)
        if lobes == 2 and not search.warm:
            nothing = Known(given.narrow[t], given.wide, free, free, 0.0)
            few = Search(search.scouts, 0, search.tolerance, False)
            lone(GGX, Fit(first, best), tint, light, data, nothing, few, scout)
            pair(first)
        p[:] = found.P[t] if search.warm else first
        dark = UNSEEN if given.dark[t] and tail == GAUSSIAN else 0.0
        known = Known(given.narrow[t], given.wide, given.centre[t], given.stiffness[t], 0.0 if plain else dark)
        if plain:
            lone(tail, Fit(p, best), tint, light, data, known, search, work)
            found.F[t] = colour_lone(tail, Fit(p, found.C[t]), light, data, work.R[LOBE_SIZE + 1], big[0])
        else:
            if not model.bent:
                for i in range(n):
                    work.R[shapes + lobes, i] = light.L[2, i] * data.root[i]
            found.F[t] = descend(model, Fit(p, best), light, data, known, search, work)
            found.C[t] = best[:columns]
        found.P[t] = p
