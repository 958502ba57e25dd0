"""Protocols of fitted models: each predicts and has a size, and one that becomes a material has channels as well."""

from itertools import product
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from kinran.data.texel_directions import Under

Channels = dict[str, NDArray[np.floating]]


class Fitted(Protocol):
    """A model fitted to texels."""

    @property
    def numbers(self) -> float:
        """Numbers that each texel keeps."""
        ...

    @property
    def shared(self) -> int:
        """Numbers that all texels share."""
        ...

    def predict(self, under: Under) -> NDArray[np.float32]:
        """T (texel, 3, light) under some lights, without falloff, in the unit of the samples."""
        ...


class Mapped(Fitted, Protocol):
    """A fitted model that becomes a material."""

    def channels(self) -> Channels:
        """Channels (texel,) of the material's maps, named as `kinran_bsdf` names them; colours in the stack's RGB."""
        ...


def named(names: tuple[str, ...], shapes: NDArray[np.float64], colours: NDArray[np.float64]) -> Channels:
    """Channels (texel,) of shapes (texel, lobes × K) and colours (texel, lobes + 1, 3), the diffuse term untilted."""
    lobes = [f"lobe{k + 1}" for k in range(colours.shape[1] - 1)]
    channels: Channels = {f"{lobe}.{name}": shapes[:, k] for k, (lobe, name) in enumerate(product(lobes, names))}
    for k, part in enumerate([*lobes, "diffuse"]):
        channels.update({f"{part}.{c}": colours[:, k, i] for i, c in enumerate("RGB")})
    channels["diffuse.x"], channels["diffuse.y"] = np.zeros((2, len(colours)))
    return channels
