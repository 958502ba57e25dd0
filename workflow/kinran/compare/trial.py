"""Trials of methods: training samples that they see, and held-out photographs that they are judged by."""

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from kinran.base import encoding
from kinran.base.files import InputError
from kinran.data.fabric import Fabric
from kinran.data.held_out_photographs import HeldOut
from kinran.data.radiance_stack import Box, Light, Stack
from kinran.data.texel_directions import Index, Under, under
from kinran.fit.fitted_model import Fitted
from kinran.fit.samples import Samples, read_samples, training_lights
from kinran_bsdf.colours import TO_REC709

T_ = TypeVar("T_", bound=np.generic)
Single = NDArray[np.float32]
Array = NDArray[np.float64]

SIDE = 128
"""Most texels along each side of a trial, from the middle of the map. A choice: a chart then takes minutes."""
FULL = 0.99
"""Share of a sensor's full well that an exposure of the bracket is taken to hold. A choice: with it the chart's errors
under three exposures are those of frames of three exposures that were merged for real (docs/chart.md)."""


@dataclass(frozen=True)
class Trial:
    """Texels of one fabric, under lights that methods see and under others that they are judged by.

    Attributes
    ----------
    samples
        Training samples.
    lights
        Training lights, as the stack names them.
    held
        Directions of the held-out lights.
    truth : (texel, 3, light) float32
        Radiance under the held-out lights as measured, in the stack's unit.
    valid : (texel, 3, light) bool
        Whether a held-out sample is valid, so that predictions can be judged by it.
    full : (texel, 3, light) bool
        Whether a held-out sample of a photograph is saturated, so that its light was that or more.
    share : (light,)
        Share of the sphere that each held-out light stands for.
    regions
        Names of the fabric's regions.
    shape
        Rows and columns of the texels.
    coder
        Encoding of photographs; None for radiance.
    peak
        99.9th percentile of the held-out samples.
    clips : tuple of (3,)
        Radiance at which each exposure of the bracket is full, longest first; empty for photographs.
    to_rec709 : (3, 3)
        Stack RGB (column) to linear Rec. 709.
    """

    samples: Samples
    lights: tuple[Light, ...]
    held: Under
    truth: Single
    valid: NDArray[np.bool_]
    full: NDArray[np.bool_]
    share: Array
    regions: tuple[str, ...]
    shape: tuple[int, int]
    coder: encoding.Encoding | None
    peak: float
    clips: tuple[Array, ...]
    to_rec709: Array

    @property
    def texels(self) -> int:
        """Number of texels."""
        return len(self.samples)

    def measured(self, fitted: Fitted) -> Single:
        """Prediction (texel, 3, light) of a fit under the held-out lights, with falloff, in the unit of the stack."""
        return self.held.reaching(fitted.predict(self.held))

    def allowed(self, predicted: Single) -> Single:
        """Prediction (texel, 3, light) with what exceeds a saturated sample lowered to it."""
        return np.where(self.full, np.minimum(predicted, self.truth), predicted)

    def encoded(self) -> Samples:
        """Training samples as the photographs hold them; radiance as it is."""
        return replace(self.samples, T=self.coder.encode(self.samples.T)) if self.coder else self.samples

    def decoded(self, values: Single) -> Single:
        """Linear light of predictions that are in the values of `encoded`."""
        return self.coder.decode(np.clip(values, 0, 1)) if self.coder else values

    def under(self, use: NDArray[np.intp]) -> "Trial":
        """The trial with these of the training lights alone."""
        return replace(self, samples=self.samples.only(use), lights=tuple(self.lights[i] for i in use))

    def of(self, texels: Index) -> "Trial":
        """The trial with some of its texels; `shape` no longer holds."""
        parts = {name: getattr(self, name)[texels] for name in ("truth", "valid", "full")}
        return replace(self, samples=self.samples.of(texels), held=self.held.of(texels), **parts)

    def thinned(self, most: int) -> "Trial":
        """The trial with at most so many texels, evenly through the map."""
        return self.of(np.linspace(0, self.texels - 1, min(most, self.texels)).astype(np.intp))

    def with_exposures(self, kept: int) -> "Trial":
        """The trial as if only the `kept` longest exposures had been taken; brighter samples are clipped."""
        clip = self.clips[kept - 1].astype(np.float32)[:, None]
        seen, W = self.samples.under.reaching(self.samples.T), self.samples.W
        full = (clip <= seen).any(1)
        bounds = np.zeros_like(W) if self.samples.bounds is None else self.samples.bounds
        less = replace(
            self.samples,
            T=self.samples.under.square_on(np.minimum(seen, clip)),
            W=np.where(full, 0, W).astype(np.float32),
            bounds=np.where(full & (W > 0), 1, bounds).astype(np.float32),
        )
        return replace(self, samples=less)


def read(fabric: Fabric) -> Trial:
    """The trial of a fabric's middle texels.

    Raises
    ------
    InputError
        No light is held out.
    """
    stack = fabric.stack
    if not stack.held_out.any():
        raise InputError(f"{stack.path}: no light is held out to judge by; set holdout in config.yaml")
    box = middle(stack)
    held = HeldOut.read(stack, box)
    return Trial(
        samples=read_samples(fabric, box),
        lights=tuple(stack.lights[i] for i in training_lights(stack)),
        held=under(stack, box, held.use),
        truth=by_texel(held.truth),
        valid=by_texel(held.valid) > 0,
        full=by_texel(held.full),
        share=held.share,
        regions=tuple(region.name for region in fabric.regions),
        shape=(box[1] - box[0], box[3] - box[2]),
        coder=held.coder,
        peak=held.peak,
        clips=_clips(stack),
        to_rec709=TO_REC709 @ stack.to_acescg,
    )


def middle(stack: Stack) -> Box:
    """Box of the texels of a stack that methods are tried on."""
    height, width = min(stack.height, SIDE), min(stack.width, SIDE)
    y, x = (stack.height - height) // 2, (stack.width - width) // 2
    return y, y + height, x, x + width


def by_texel(images: NDArray[T_]) -> NDArray[T_]:
    """Images (light, y, x, 3) as (texel, 3, light)."""
    return np.ascontiguousarray(images.reshape(len(images), -1, 3).transpose(1, 2, 0))


def _clips(stack: Stack) -> tuple[Array, ...]:
    noise = stack.noise
    if noise.get("kind") != "raw":
        return ()
    white = np.asarray(noise["white_counts_per_second"], float)
    return tuple(FULL * noise["saturation_counts"] / (s * white) for s in sorted(noise["seconds"], reverse=True))
