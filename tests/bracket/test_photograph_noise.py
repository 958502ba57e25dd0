"""σ and encoding of brackets of photographs, against a sensor of photons, read noise and rounding of its own."""

from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image

from kinran.__main__ import main
from kinran.base.encoding import parse
from kinran.base.exr import read_exr_with_header

TIMES = 2.0 ** (-np.array([4, 10, 16, 22]) / 3)
SIDE = 160


def scene() -> np.ndarray:
    """Light (SIDE, SIDE, 3) over three and a half decades: patches, and a ramp through them."""
    rng = np.random.default_rng(1)
    patches = np.kron(10 ** rng.uniform(-2, 1.2, (SIDE // 16, SIDE // 16)), np.ones((16, 16)))
    ramp = 10 ** (0.3 * np.linspace(-1, 1, SIDE))
    return (patches * ramp)[..., None] * np.array([1.0, 0.8, 0.5])


def photograph(light: np.ndarray, seconds: float, well: float, read: float, rng: np.random.Generator) -> np.ndarray:
    """Linear light in [0, 1] of a sensor that is full at `well` electrons."""
    electrons = rng.poisson(np.minimum(light * seconds * well, 3 * well)) + rng.normal(0, read, light.shape)
    return np.clip(electrons / well, 0, 1)


def bracket(folder: Path, encoding: str, bits: int, well: float, read: float) -> list[Path]:
    rng, paths = np.random.default_rng(2), []
    for seconds in TIMES:
        value = parse(encoding).encode(photograph(scene(), seconds, well, read, rng))
        path = folder / f"p_{seconds:.6f}s.{'tif' if bits == 16 else 'png'}"
        if bits == 16:
            tifffile.imwrite(path, np.round(value * 65535).astype(np.uint16), photometric="rgb")
        else:
            Image.fromarray(np.round(value * 255).astype(np.uint8)).save(path)
        paths.append(path)
    return paths


@pytest.mark.parametrize("well", [5_000, 20_000])
@pytest.mark.parametrize(("encoding", "bits"), [("linear", 16), ("srgb", 16), ("srgb", 8), ("linear", 8)])
def test_sigma_of_photographs_is_calibrated(tmp_path: Path, encoding: str, bits: int, well: int) -> None:
    """z-rms within 5 % of 1 in each decade; bias 0.2 %, under 3 % where darkness is cut off at 0.

    Nobody says how the photographs are encoded: the noisiest bracket tells it, too.
    """
    frames = bracket(tmp_path, encoding, bits, well, 5.0)
    out, times = tmp_path / "x.exr", ",".join(f"{seconds:.9f}" for seconds in TIMES)
    assert main(["merge", *map(str, frames), "--out", str(out), "--times", times]) == 0
    channels, header = read_exr_with_header(out)
    assert f"({encoding} photographs)" in str(header["kinran:colour"])
    value, sigma = (np.stack([channels[prefix + name] for name in "RGB"], -1) for prefix in ("", "sigma."))
    light, seen = scene(), np.isfinite(sigma)
    for low, high, bias in ((0.01, 0.03, 0.03), (0.03, 0.3, 2e-3), (0.3, 3, 2e-3), (3, 30, 2e-3)):
        if (encoding, bits) == ("linear", 8) and low < 0.03:
            continue  # it has one code there
        use = seen & (light > low) & (light < high)
        assert use.sum() > 1500
        z = (value - light)[use] / sigma[use]
        assert np.sqrt(np.mean(z**2)) == pytest.approx(1, abs=0.05), low
        assert abs(value[use].sum() / light[use].sum() - 1) < bias, low


def test_the_steps_of_codes_are_noise_that_grows_with_light(tmp_path: Path) -> None:
    """8 bits of a quiet sensor: σ is right to 5 % in the highlights; with photons and reading alone it is not."""
    frames = bracket(tmp_path, "srgb", 8, 100_000, 5.0)
    out, times = tmp_path / "x.exr", ",".join(f"{seconds:.9f}" for seconds in TIMES)
    assert main(["merge", *map(str, frames), "--out", str(out), "--times", times]) == 0
    channels, header = read_exr_with_header(out)
    assert '"relative_coding": 0.0,' not in str(header["kinran:noise"])
    light = scene()[..., 1]
    use = np.isfinite(channels["sigma.G"]) & (light > 0.3)
    z = (channels["G"] - light)[use] / channels["sigma.G"][use]
    assert np.sqrt(np.mean(z**2)) == pytest.approx(1, abs=0.05)
