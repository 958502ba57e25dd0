"""An autoencoder over the samples of a texel, in the shape of NeuralRTI [Dulecha2020], trained by Dr.Jit.

An encoder makes a few codes of all samples of a texel, and a decoder, which all texels share, makes a sample of the
codes and a light (l_x, l_y). What is kept are the codes and the decoder.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinran.data.texel_directions import Under
from kinran.fit.samples import Samples

Array = NDArray[np.float64]
Single = NDArray[np.float32]
Layers = list[tuple[Single, Single]]

CODES = 9
"""Numbers of a texel, as in [Dulecha2020]."""
SMALL = (50, 50)
"""Widths of the hidden layers of the decoder that DisK-NeuralRTI distils to."""
TEXELS, LIGHTS = 64, 16
"""Texels of a step of training, and lights of each. Choices: with four times the texels, and a third of the steps,
item 3 has 31 dB and not 38.6."""
RATES, LAST = (4e-3, 1e-3), 0.01
"""Rates of Adam that are tried, of which that with the least error of training is kept, and the last of a training over
the first. Choices: item 3 has 38.6 dB with the first and 36.4 with 1.5e-3; material 7 19 dB with the first, 41 with the
second."""
SEED = 1


@dataclass(frozen=True)
class Autoencoded:
    """Codes (texel, `CODES`), and weights (out, in) and biases (out,) of the layers of the decoder."""

    codes: Single
    decoder: Layers

    @property
    def numbers(self) -> float:
        """Numbers that each texel keeps."""
        return float(self.codes.shape[1])

    @property
    def shared(self) -> int:
        """Numbers that all texels share."""
        return sum(weights.size + bias.size for weights, bias in self.decoder)

    def predict(self, under: Under) -> Single:
        """Values (texel, 3, light) under some lights, of the kind that was fitted."""
        out = np.empty((len(self.codes), 3, under.count), np.float32)
        for k, at in under.cells():
            for i, light in enumerate(under.lights[k][:, :2].astype(np.float32)):
                codes = self.codes[at].T
                towards = np.repeat(light[:, None], codes.shape[1], 1)
                out[at, :, i] = _forward(np.concatenate([codes, towards]), self.decoder).T
        return out


def fit(samples: Samples, hidden: tuple[int, ...] | None, steps: int) -> Autoencoded:
    """Train an autoencoder on all samples.

    Parameters
    ----------
    samples
        Samples in the values of photographs, [0, 1], from one place of lamp and camera.
    hidden
        Widths of the decoder's hidden layers; three as wide as the samples of a texel if None.
    steps
        Steps of training, each of `TEXELS` × `LIGHTS` samples.
    """
    count = samples.T.shape[2]
    lights = samples.under.directions[:, :2].astype(np.float32)
    wide = (3 * count,) * 3
    values = np.ascontiguousarray(samples.T.reshape(len(samples), -1).T)
    mean, spread = values.mean(1, keepdims=True), values.std(1, keepdims=True) + 1e-3
    seen = (values - mean) / spread
    weight = samples.W / max(float(samples.W.mean()), 1e-9)
    found: list[tuple[float, int, Autoencoded]] = []
    for rate in RATES:
        encoder, decoder = _network(3 * count, wide, CODES), _network(CODES + 2, hidden or wide, 3)
        _train(encoder, decoder, seen, values, weight, lights, steps, rate)
        parts = np.array_split(seen, max(1, len(samples) // 4096), axis=1)
        codes = np.concatenate([_forward(part, _layers(encoder)).T for part in parts]).astype(np.float32)
        made = Autoencoded(codes, _layers(decoder))
        error = float((weight[:, None] * np.square(made.predict(samples.under) - samples.T)).mean())
        found.append((error if np.isfinite(error) else np.inf, len(found), made))
    return min(found)[2]


def _elu(x: Any, xp: Any) -> Any:
    least = xp.minimum(x, 0)
    return (np.where if xp is np else xp.select)(x > 0, x, xp.exp(least) - 1)


def _network(size: int, hidden: tuple[int, ...], out: int) -> Any:
    """Network of layers with ELU between them, in single precision."""
    import drjit as dr
    from drjit import nn
    from drjit.llvm.ad import TensorXf

    class Elu(nn.Module):
        def __call__(self, x: Any) -> Any:
            return _elu(x, dr)

    parts: list[Any] = []
    for width in hidden:
        parts += [nn.Linear(-1, width), Elu()]
    return nn.Sequential(*parts, nn.Linear(-1, out)).alloc(TensorXf, size, dr.rng(seed=SEED))


def _train(
    encoder: Any, decoder: Any, seen: Single, values: Single, weight: Single, lights: Single, steps: int, rate: float
) -> None:
    """Train both networks by Adam.

    Parameters
    ----------
    seen, values : (sample of a texel, texel)
        What the encoder sees, and what the decoder is to make of its codes.
    weight : (texel, light)
        Weights of the values.
    rate
        Rate of Adam at the start, which falls as half a cosine to `LAST` of it.
    """
    import drjit as dr
    from drjit.llvm.ad import Float, TensorXf, UInt
    from drjit.opt import Adam

    rng = np.random.default_rng(SEED)
    count, texels = len(lights), values.shape[1]
    batch, some = min(TEXELS, texels), min(LIGHTS, count)
    optimizers = [Adam(lr=rate) for _ in range(2)]
    for optimizer, network in zip(optimizers, (encoder, decoder), strict=True):
        optimizer.update(network)
    place = np.repeat(np.arange(batch), some)
    gather = UInt((np.arange(CODES)[:, None] * batch + place).ravel().astype(np.uint32))
    for step in range(steps):
        now = rate * (LAST + (1 - LAST) * 0.5 * (1 + np.cos(np.pi * step / steps)))
        for optimizer, network in zip(optimizers, (encoder, decoder), strict=True):
            optimizer.set_learning_rate(now)
            network.update(optimizer)
        at = rng.integers(0, texels, batch)
        under = rng.integers(0, count, (batch, some))
        codes = encoder(TensorXf(np.ascontiguousarray(seen[:, at])))
        spread = TensorXf(dr.gather(Float, codes.array, gather), (CODES, batch * some))
        inputs = dr.concat((spread, TensorXf(np.ascontiguousarray(lights[under.ravel()].T))), axis=0)
        truth = values.reshape(3, count, -1)[:, under.ravel(), at[place]]
        counted = weight[at[place], under.ravel()]
        loss = dr.mean(TensorXf(np.ascontiguousarray(counted[None])) * dr.square(decoder(inputs) - TensorXf(truth)))
        dr.backward(loss)
        for optimizer in optimizers:
            optimizer.step()
    for optimizer, network in zip(optimizers, (encoder, decoder), strict=True):
        network.update(optimizer)


def _layers(network: Any) -> Layers:
    """Weights and biases of a network's layers."""
    return [
        (np.array(layer.weights, np.float32), np.array(layer.bias, np.float32))
        for layer in network.layers
        if hasattr(layer, "weights")
    ]


def _forward(x: Single, layers: Layers) -> Single:
    """Output (out, n) of layers for inputs (in, n)."""
    for k, (weights, bias) in enumerate(layers):
        x = weights @ x + bias[:, None]
        if k < len(layers) - 1:
            x = _elu(x, np)
    return x


KINDS: dict[str, Callable[[Samples, int], Autoencoded]] = {
    "DisK-NeuralRTI": lambda samples, steps: fit(samples, SMALL, steps),
    "NeuralRTI": lambda samples, steps: fit(samples, None, steps),
}
"""Fits of autoencoders to samples in so many steps, by their names."""
