"""`kinran merge` on what people hand it: one sentence that says what is wrong, or a right and flagged picture."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image

from kinran.__main__ import main
from kinran.base.encoding import parse
from kinran.base.exr import read_exr, write_exr
from kinran.data.radiance import DARK, SATURATED

TIMES = (0.4, 0.1, 0.025)
SIDE = 64
SRGB = parse("srgb").encode


def light() -> np.ndarray:
    y, x = np.mgrid[0 : 1 : SIDE * 1j, 0 : 1 : SIDE * 1j]
    return 10 ** (-1.5 + 2.6 * x + 0.4 * np.sin(5 * y))[..., None] * np.array([1.0, 0.8, 0.5])


def seen(seconds: float, scene: np.ndarray | None = None) -> np.ndarray:
    """Linear photograph in [0, 1] of 20,000 electrons."""
    mean = (light() if scene is None else scene) * seconds
    rng = np.random.default_rng(round(seconds * 1e6))
    return np.clip(mean + rng.normal(0, np.sqrt(mean / 20_000 + 1e-8)), 0, 1)


def grey(seconds: float) -> np.ndarray:
    return seen(seconds)[..., 1:2].repeat(3, -1)


def png(path: Path, linear: np.ndarray, mode: str = "RGB") -> None:
    image = Image.fromarray(np.round(SRGB(linear) * 255).astype(np.uint8))
    if mode == "P":
        image = image.convert("L")  # whose palette is exact
    (image if mode == "RGB" else image.convert(mode)).save(path)


def tif(path: Path, values: np.ndarray) -> None:
    tifffile.imwrite(path, values, photometric="minisblack" if values.ndim == 2 else "rgb")


def bracket(folder: Path, suffix: str, write: Callable[[Path, float], None]) -> list[Path]:
    paths = [folder / f"p_{seconds * 1000:g}ms.{suffix}" for seconds in TIMES]
    for path, seconds in zip(paths, TIMES, strict=True):
        write(path, seconds)
    return paths


def run(folder: Path, frames: list[Path], *options: str) -> int:
    return main(["merge", *map(str, frames), "--out", str(folder / "out.exr"), *options])


KINDS: dict[str, tuple[str, Callable[[Path, float], None]]] = {
    "grey, 16 bits": ("tif", lambda path, s: tif(path, np.round(seen(s)[..., 1] * 65535).astype(np.uint16))),
    "grey, 8 bits": ("png", lambda path, s: png(path, grey(s), "L")),
    "with alpha": ("png", lambda path, s: png(path, seen(s), "RGBA")),
    "with a palette": ("png", lambda path, s: png(path, grey(s), "P")),
    "floating point": ("tif", lambda path, s: tif(path, seen(s).astype(np.float32))),
    "JPEG": ("jpg", lambda path, s: Image.fromarray((SRGB(seen(s)) * 255.5).astype(np.uint8)).save(path, quality=95)),
}


@pytest.mark.parametrize("kind", KINDS)
def test_kinds_of_files_that_are_merged(tmp_path: Path, kind: str) -> None:
    """Green to 2 % in the median of each of six levels, on the scale of white a second; any order, the same bytes."""
    frames = bracket(tmp_path, *KINDS[kind])
    assert run(tmp_path, frames) == 0
    first = (tmp_path / "out.exr").read_bytes()
    channels = read_exr(tmp_path / "out.exr")
    true = light()[..., 1]
    use = np.isfinite(channels["sigma.G"]) & (true > 0.05) & (true < 20)
    ratio = (channels["G"] / true)[use][np.argsort(true[use])]
    np.testing.assert_allclose([np.median(part) for part in np.array_split(ratio, 6)], 1, atol=0.02)
    assert run(tmp_path, [frames[1], frames[2], frames[0]]) == 0
    assert (tmp_path / "out.exr").read_bytes() == first


def not_a_number(path: Path, seconds: float) -> None:
    values = seen(seconds).astype(np.float32)
    values[3, 4] = np.nan
    tif(path, values)


def of_two_depths(path: Path, seconds: float) -> None:
    full, kind = (255, np.uint8) if seconds == TIMES[1] else (65535, np.uint16)
    tif(path, np.round(seen(seconds) * full).astype(kind))


def radiance(path: Path, seconds: float) -> None:
    write_exr(path, {name: np.ascontiguousarray(seen(seconds)[..., k], np.float32) for k, name in enumerate("RGB")})


def wall(path: Path, seconds: float) -> None:
    rng = np.random.default_rng(0)
    scene = light() * (1 + 0.6 * np.kron(rng.integers(0, 2, (SIDE // 2, SIDE // 2, 1)), np.ones((2, 2, 1))))
    png(path, np.roll(seen(seconds, scene), 2 if seconds == TIMES[1] else 0, 1))


WRONG: dict[str, tuple[str, Callable[[Path, float], None], tuple[str, ...], str]] = {
    "no number": ("tif", not_a_number, (), r"p_400ms\.tif: has values that are no numbers"),
    "no white": ("tif", lambda path, s: tif(path, np.float32(1000 * seen(s))), (), "has values up to 1000, but white"),
    "two depths": ("tif", of_two_depths, (), r"p_100ms\.tif: has 8 bits but p_400ms\.tif 16"),
    "radiance": ("exr", radiance, (), "is linear radiance already"),
    "32 bits": ("tif", lambda path, s: tif(path, np.uint32(4e9 * seen(s))), (), "has samples of type uint32"),
    "pages": ("tif", lambda path, s: tifffile.imwrite(path, np.zeros((2, 9, 9, 3), np.uint8)), (), "holds 2 pictures"),
    "text": ("png", lambda path, s: path.write_bytes(b"hello" * 99) and None, (), "is truncated or broken"),
    "empty": ("jpg", lambda path, s: path.write_bytes(b"") and None, (), "is truncated or broken"),
    "moved": ("png", wall, ("--encoding", "srgb"), r"p_100ms\.png: does not agree with the other exposures"),
    "one picture": ("png", lambda path, s: png(path, seen(0.1)), (), "no response makes its bracket consistent"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_refused_in_one_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str], case: str) -> None:
    suffix, write, options, message = WRONG[case]
    assert run(tmp_path, bracket(tmp_path, suffix, write), *options) == 2
    error = capsys.readouterr().err.strip()
    assert len(error.splitlines()) == 1, error
    assert error.startswith("kinran merge: ")
    assert re.search(message, error), error
    assert not list(tmp_path.glob("*out*"))


def test_a_mixture_of_kinds(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Encoded and linear files in one bracket: no response is right for both."""
    tif(tmp_path / "p_400ms.tif", np.round(seen(0.4) * 65535).astype(np.uint16))
    png(tmp_path / "p_100ms.png", seen(0.1))
    assert run(tmp_path, [tmp_path / "p_400ms.tif", tmp_path / "p_100ms.png"]) == 2
    assert "p_100ms.png: is no file of the kind of p_400ms.tif" in capsys.readouterr().err


@pytest.mark.parametrize(("level", "flag"), [(1.0, SATURATED), (0.0, DARK)])
def test_white_and_black_photographs(tmp_path: Path, level: float, flag: int) -> None:
    """All white is a lower bound with σ = ∞; all black is 0 with a σ of at least the step of its codes."""
    assert run(tmp_path, bracket(tmp_path, "png", lambda path, s: png(path, np.full((40, 40, 3), level)))) == 0
    channels = read_exr(tmp_path / "out.exr")
    assert (channels["flags"].astype(int) == flag).all()
    if level:
        assert np.isinf(channels["sigma.G"]).all()
        np.testing.assert_allclose(channels["G"], 1 / (2 ** (-16 / 3)), rtol=0.01)  # 1/40 s is that third stop
    else:
        np.testing.assert_array_equal(channels["G"], 0)
        assert (channels["sigma.G"] > parse("srgb").decode(np.float32(1 / 255)) / 12**0.5).all()


def test_photographs_of_one_colour(tmp_path: Path) -> None:
    """No noise, no texture, one code a frame: the level comes out to a code, and nothing is called saturated."""
    assert run(tmp_path, bracket(tmp_path, "png", lambda path, s: png(path, np.full((40, 40, 3), 0.9 * s)))) == 0
    channels = read_exr(tmp_path / "out.exr")
    np.testing.assert_allclose(channels["G"], 0.9, rtol=0.03)
    assert not channels["flags"].any()


def test_one_pixel(tmp_path: Path) -> None:
    assert run(tmp_path, bracket(tmp_path, "png", lambda path, s: png(path, np.full((1, 1, 3), 0.9 * s)))) == 0
    assert read_exr(tmp_path / "out.exr")["G"][0, 0] == pytest.approx(0.9, rel=0.03)
