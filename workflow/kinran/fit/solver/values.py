"""What the compiled solver takes and gives, as named tuples: Numba passes their members on as if each stood alone."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Single = NDArray[np.float32]


class Model(NamedTuple):
    """What is solved for: the tail of the lobes, their number, and whether the diffuse term has a normal of its own."""

    tail: int
    lobes: int
    bent: bool


class Texels(NamedTuple):
    """Samples (texel, 3, light) and weights (texel, light); 0 leaves a sample out, as does NaN or infinity."""

    T: Single
    W: Single


class Light(NamedTuple):
    """Half-vector slopes (2, row), directions (3, row) and the solid angle (row,) that a light stands for.

    Rows are as long as a multiple of `rows.LANES`, with zeros beyond the last light.
    """

    S: Single
    L: Single
    solid: Single


class Given(NamedTuple):
    """Bounds and priors of texels.

    Attributes
    ----------
    narrow : (texel,)
        Smallest width of a lobe; `wide` is the largest.
    centre, stiffness : (texel, K)
        Prior: F + Σ ρ_k (p_k - p̄_k)².
    dark : (texel,) bool
        Whether a prior holds the amplitudes of Gaussian lobes, one of two or over a bent diffuse term.
    """

    narrow: Array
    wide: float
    centre: Array
    stiffness: Array
    dark: NDArray[np.bool_]


class Known(NamedTuple):
    """Bounds and prior of one texel; `dark` is the weight of the prior on amplitudes."""

    narrow: float
    wide: float
    centre: Array
    stiffness: Array
    dark: float


class Search(NamedTuple):
    """Iterations, at most; the scouts are those of the lone GGX lobe that two lobes start from.

    A step has to promise and to gain `tolerance` of the cost. `warm` says that the search starts from given shapes.
    """

    iterations: int
    scouts: int
    tolerance: float
    warm: bool


class Data(NamedTuple):
    """Roots (row,) of the weights of one texel's samples, and the samples (channel, row) times these."""

    root: Single
    Y: Single


class Fit(NamedTuple):
    """Shapes (K,) and colours (column, channel) of one texel."""

    p: Array
    C: Array


class Found(NamedTuple):
    """Shapes (texel, K), colours (texel, column, 3) and weighted squared residual (texel,): the results."""

    P: Array
    C: Array
    F: Array


class System(NamedTuple):
    """Normal matrix (shape, shape) and gradient (shape,)."""

    H: Array
    g: Array


class Work(NamedTuple):
    """Scratch: the rows R (row, light), the factors (light,) of their derivatives, and small matrices."""

    R: Single
    scale: Single
    big: Array
    small: Array
