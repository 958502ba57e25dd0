"""What methods are tried on: training samples that they see, and held-out samples that they are judged by."""

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from kinran import encoding, frames
from kinran.files import InputError
from kinran.labels import LabelMap
from kinran.radiance.value import HOT, SATURATED, SHIFTED
from kinran.stack import Stack

Samples = NDArray[np.float32]
Array = NDArray[np.float64]
Labels = NDArray[np.intp]
S = TypeVar("S", bound=np.generic)

SIDE = 128
"""Of larger maps the middle 128 × 128 texels are taken."""
SATURATED_WEIGHT = 0.2


@dataclass(frozen=True)
class Trial:
    """Samples of one fabric, texels first.

    Attributes
    ----------
    T, truth : (texel, 3, light) float32
        Under the training and the held-out lights, linear, in the stack's unit.
    W : (texel, light) float32
        Weights of the training samples, 0 for those not to be used.
    bounds : (texel, light) float32
        Weights of saturated samples, as the lower bounds that they are; 0 elsewhere.
    valid : (texel, 3, light) bool
        Held-out samples that can be judged by.
    lights, held_out : (light, 3)
    share : (light,)
        Of the sphere that each held-out light stands for.
    region, second : (texel,) int
        Region, and the one that shares the texel; the same where none does.
    grid : (light, 2) or None
        (iθ, iφ) of the training lights on a grid.
    shape
        (y, x).
    coder
        Encoding of photographs; None for radiance.
    peak
        99.9th percentile of the held-out samples.
    clips : tuple of (3,)
        Radiance at which each exposure of the bracket is full, longest first; empty for photographs.
    """

    T: Samples
    W: Samples
    bounds: Samples
    lights: Array
    truth: Samples
    valid: NDArray[np.bool_]
    held_out: Array
    share: Array
    region: Labels
    second: Labels
    grid: NDArray[np.intp] | None
    shape: tuple[int, int]
    coder: encoding.Encoding | None
    peak: float
    clips: tuple[Array, ...]
    to_rec709: Array

    @property
    def texels(self) -> int:
        """Number of texels."""
        return len(self.T)

    def encoded(self) -> Samples:
        """Training samples as the photographs hold them; radiance as it is."""
        return self.coder.encode(self.T) if self.coder else self.T

    def decoded(self, values: Samples) -> Samples:
        """Linear light of what a method says in the values of `encoded`."""
        return self.coder.decode(np.clip(values, 0, 1)) if self.coder else values

    def under(self, use: NDArray[np.intp]) -> "Trial":
        """The trial with these of the training lights alone."""
        grid = None if self.grid is None else self.grid[use]
        T, W, bounds = (np.ascontiguousarray(part[..., use]) for part in (self.T, self.W, self.bounds))
        return replace(self, T=T, W=W, bounds=bounds, lights=self.lights[use], grid=grid)

    def thinned(self, most: int) -> "Trial":
        """The trial with at most so many texels, evenly through the map; `shape` no longer holds."""
        use = np.linspace(0, self.texels - 1, min(most, self.texels)).astype(np.intp)
        names = ("T", "W", "bounds", "truth", "valid", "region", "second")
        return replace(self, **{name: getattr(self, name)[use] for name in names})

    def with_exposures(self, kept: int) -> "Trial":
        """The trial as if only the `kept` longest exposures had been taken: what is brighter is clipped."""
        clip = self.clips[kept - 1].astype(np.float32)[:, None]
        full = (clip <= self.T).any(1)
        W, bounds = np.where(full, 0, self.W), np.where(full & (self.W > 0), 1, self.bounds)
        return replace(self, T=np.minimum(self.T, clip), W=W.astype(np.float32), bounds=bounds.astype(np.float32))


def spread(lights: Array, count: int) -> NDArray[np.intp]:
    """Indices of `count` lights that lie apart: farthest points in the plane of half-vector slopes."""
    s = frames.slopes(lights)
    chosen = [int(np.linalg.norm(s, axis=1).argmin())]
    distance = np.linalg.norm(s - s[chosen[0]], axis=1)
    while len(chosen) < min(count, len(s)):
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(s - s[chosen[-1]], axis=1))
    return np.sort(np.array(chosen, np.intp))


def read(stack: Stack, labels: LabelMap, to_rec709: Array, second: LabelMap | None = None) -> Trial:
    """The trial of a stack's middle texels; `second` shares them, nobody by default.

    Raises
    ------
    InputError
        No light is held out, or the labels are not those of the stack.
    """
    if not stack.held_out.any():
        raise InputError(f"{stack.path}: no light is held out to judge by; set holdout in config.yaml")
    if labels.shape != (stack.height, stack.width):
        raise InputError(f"{stack.path}: its {stack.height} × {stack.width} texels are not those of the label map")
    height, width = min(stack.height, SIDE), min(stack.width, SIDE)
    y, x = (stack.height - height) // 2, (stack.width - width) // 2
    seen = stack.read_tile(y, y + height, x, x + width)
    radiance, flags = seen.value, seen.flags
    held = stack.held_out
    T = _texels(np.asarray(np.nan_to_num(radiance[~held], posinf=0, neginf=0), np.float32))
    truth, bits = _texels(radiance[held]), _texels(flags[held])
    coder = encoding.parse(stack.encoding) if stack.encoding else None
    bad = HOT | SHIFTED | (0 if coder else SATURATED)
    valid = ((bits & bad) == 0) & np.isfinite(truth)
    truth = np.where(valid, truth, 0).astype(np.float32)
    lights = [light for light in stack.lights if not light.held_out]
    on_grid = all(light.grid for light in stack.lights)
    directions = stack.directions
    return Trial(
        T=T,
        W=_weights(T, _texels(flags[~held]), coder),
        bounds=_bounds(T, _texels(flags[~held]), coder),
        lights=directions[~held],
        truth=truth,
        valid=valid,
        held_out=directions[held],
        share=np.sqrt(np.maximum(1 - directions[held, 2] ** 2, 0)) if on_grid else np.ones(int(held.sum())),
        region=labels[y : y + height, x : x + width].reshape(-1).astype(np.intp),
        second=(labels if second is None else second)[y : y + height, x : x + width].reshape(-1).astype(np.intp),
        grid=np.array([light.grid for light in lights], np.intp) if on_grid else None,
        shape=(height, width),
        coder=coder,
        peak=float(np.percentile(truth, 99.9)) or 1.0,
        clips=_clips(stack),
        to_rec709=to_rec709,
    )


def _texels(images: NDArray[S]) -> NDArray[S]:
    """(light, y, x, 3) as (texel, 3, light)."""
    n = len(images)
    return np.ascontiguousarray(images.reshape(n, -1, 3).transpose(1, 2, 0))


def _weights(T: Samples, flags: NDArray[np.uint8], coder: encoding.Encoding | None) -> Samples:
    """Weights as the fit's samples have them."""
    bits = np.bitwise_or.reduce(flags, axis=1)
    W = np.ones(bits.shape, np.float32)
    if coder:
        W = coder.weight(T.mean(1))
        W[(bits & SATURATED) > 0] *= SATURATED_WEIGHT
    else:
        W[(bits & SATURATED) > 0] = 0
    W[(bits & (HOT | SHIFTED)) > 0] = 0
    return W


def _bounds(T: Samples, flags: NDArray[np.uint8], coder: encoding.Encoding | None) -> Samples:
    """Weights of saturated samples as the fit's samples have them."""
    bits = np.bitwise_or.reduce(flags, axis=1)
    weight = coder.weight(T.mean(1)) if coder else np.float32(1)
    return np.where((bits & SATURATED > 0) & (bits & (HOT | SHIFTED) == 0), weight, 0).astype(np.float32)


def _clips(stack: Stack) -> tuple[Array, ...]:
    noise = stack.noise
    if noise.get("kind") != "raw":
        return ()
    white = np.asarray(noise["white_counts_per_second"], float)
    return tuple(0.99 * noise["saturation_counts"] / (s * white) for s in sorted(noise["seconds"], reverse=True))
