"""`kinran merge FRAME… --out X.exr`: one bracket, from RAW files or photographs, with its noise and its errors."""

import re
from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image
from raw_frames import BLACK, CLIP, GAIN, RATES, TRUE, bracket, expose, scene, write

from kinran.__main__ import main
from kinran.base.encoding import parse
from kinran.base.exr import read_exr, read_exr_with_header
from kinran.data.radiance import DARK, SATURATED, SHIFTED

SITES = {"R": (0, 0), "B": (1, 1)}


def merge(tmp_path: Path, frames: list[Path], *options: str) -> dict[str, np.ndarray]:
    assert main(["merge", *map(str, frames), "--out", str(tmp_path / "x.exr"), *options]) == 0
    return read_exr(tmp_path / "x.exr")


def refused(
    tmp_path: Path, frames: list[Path], message: str, capsys: pytest.CaptureFixture[str], *options: str
) -> None:
    assert main(["merge", *map(str, frames), "--out", str(tmp_path / "x.exr"), *options]) == 2
    error = capsys.readouterr().err
    assert re.search(message, error), error
    assert not (tmp_path / "x.exr").exists()
    assert not list(tmp_path.glob(".*part*"))


# -- RAW -----------------------------------------------------------------------------------------------------


def test_raw_comes_out_unbiased_with_its_noise(tmp_path: Path) -> None:
    """Per decade 0.1 %, or four σ of the mean; σ to 5 %; times from EXIF, as third stops; nothing else is given."""
    electrons = scene(96)
    channels = merge(tmp_path, bracket(tmp_path / "raw", electrons))
    assert set(channels) == {"R", "G", "B", "sigma.R", "sigma.G", "sigma.B", "flags"}
    for name, (row, column) in SITES.items():
        true, sigma = electrons[row::2, column::2] * GAIN, channels[f"sigma.{name}"]
        error = channels[name] - true
        for low in (1e4, 1e5, 1e6, 1e7):
            use = (true > low * GAIN) & (true < 10 * low * GAIN) & np.isfinite(sigma)
            bound = max(1e-3, 4 * np.sqrt((sigma[use] ** 2).sum()) / true[use].sum())
            assert abs(error[use].sum() / true[use].sum()) < bound, (name, low)
        seen = np.isfinite(sigma) & (true > 1e4 * GAIN)
        assert np.sqrt(np.mean((error[seen] / sigma[seen]) ** 2)) == pytest.approx(1, abs=0.05)
    flags = channels["flags"].astype(int)
    np.testing.assert_array_equal(
        (flags & SATURATED) > 0, np.isinf(channels["sigma.R"]) | np.isinf(channels["sigma.B"])
    )
    assert ((flags & SHIFTED) > 0).mean() < 1e-3


def test_the_header_says_what_it_is(tmp_path: Path) -> None:
    merge(tmp_path, bracket(tmp_path / "raw", scene()))
    _, header = read_exr_with_header(tmp_path / "x.exr")
    assert header["expTime"] == pytest.approx(TRUE[25], rel=1e-6)
    assert header["kinran:unit"] == "counts over black per second"
    assert "chromaticities" not in header  # camera RGB has none


def test_the_order_of_the_frames_does_not_matter(tmp_path: Path) -> None:
    frames = bracket(tmp_path / "raw", scene())
    merge(tmp_path, frames)
    first = (tmp_path / "x.exr").read_bytes()
    merge(tmp_path, [frames[k] for k in (3, 0, 4, 2, 1)])
    assert (tmp_path / "x.exr").read_bytes() == first


@pytest.mark.parametrize("pattern", [(0, 1, 1, 2), (2, 1, 1, 0), (1, 0, 2, 1), (1, 2, 0, 1)])
def test_all_phases_of_the_colour_filters(tmp_path: Path, pattern: tuple[int, int, int, int]) -> None:
    """Red is twice, blue half as bright as green, whatever site it is on; under a mask of odd height too."""
    light = np.full((48, 64), 3e5)
    for k, colour in enumerate(pattern):
        light[k // 2 :: 2, k % 2 :: 2] *= (2, 1, 0.5)[colour]
    rng = np.random.default_rng(0)
    frames = [
        write(tmp_path / f"f_{rate}.dng", expose(light, TRUE[rate], rng), rate, mask=mask, pattern=pattern)
        for rate, mask in ((100, 8), (1000, 8))
    ]
    channels = merge(tmp_path, frames)
    means = [channels[name].mean() / (3e5 * GAIN) for name in "RGB"]
    np.testing.assert_allclose(means, [2, 1, 0.5], rtol=5e-3)


@pytest.mark.parametrize(("orientation", "turns"), [(1, 0), (3, 2), (6, 3), (8, 1)])
def test_a_camera_on_its_side_gives_an_upright_picture(tmp_path: Path, orientation: int, turns: int) -> None:
    light = np.full((64, 96), 1e5)
    light[:16, :16] = 4e5
    rng = np.random.default_rng(0)
    frames = [
        write(tmp_path / f"f_{rate}.dng", expose(light, TRUE[rate], rng), rate, orientation=orientation)
        for rate in (100, 1000)
    ]
    red = merge(tmp_path, frames)["R"]
    bright = np.zeros((32, 48), bool)
    bright[:8, :8] = True
    np.testing.assert_array_equal(red > 2.5e5 * GAIN, np.rot90(bright, turns))


def test_all_saturated_is_a_flagged_lower_bound(tmp_path: Path) -> None:
    electrons = scene()
    electrons[32:64, 32:64] = 1e9
    channels = merge(tmp_path, bracket(tmp_path / "raw", electrons))
    corner = np.s_[18:30, 18:30]
    assert (channels["flags"][corner].astype(int) & SATURATED).all()
    assert np.isinf(channels["sigma.G"][corner]).all()
    np.testing.assert_allclose(channels["G"][corner], (CLIP - BLACK) / TRUE[4000], rtol=2e-3)


def test_darkness_keeps_its_negative_values(tmp_path: Path) -> None:
    electrons = scene()
    electrons[:, 64:] = 0.0
    channels = merge(tmp_path, bracket(tmp_path / "raw", electrons))
    dark, sigma = channels["G"][:, 32:], channels["sigma.G"][:, 32:]
    assert (dark < 0).mean() == pytest.approx(0.5, abs=0.1)
    assert np.isfinite(sigma).all()
    assert (channels["flags"][:, 32:].astype(int) & DARK).mean() > 0.99


def test_one_frame_is_enough(tmp_path: Path) -> None:
    """Its σ, with no other frame to compare with, is right to 15 % where the scene is smooth."""
    electrons = scene()
    (frame,) = bracket(tmp_path / "raw", electrons, rates=(1000,))
    channels = merge(tmp_path, [frame])
    true, sigma = electrons[::2, ::2] * GAIN, channels["sigma.R"]
    seen = np.isfinite(sigma)
    assert 0.02 < (~seen).mean() < 0.5
    assert np.sqrt(np.mean(((channels["R"] - true) / sigma)[seen] ** 2)) == pytest.approx(1, abs=0.15)


def test_a_missing_exposure_merges(tmp_path: Path) -> None:
    electrons = scene()
    frames = bracket(tmp_path / "raw", electrons)
    del frames[2]
    channels = merge(tmp_path, frames)
    seen = np.isfinite(channels["sigma.R"])
    true = electrons[::2, ::2] * GAIN
    assert channels["R"][seen].sum() == pytest.approx(true[seen].sum(), rel=2e-3)


def test_shutter_banding_is_measured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """±3 % along the rows at 1/4000 s: of it 0.4 % is left in the highlights, over 2 % where the curtain is ignored."""
    electrons = scene(96)
    rng = np.random.default_rng(2)
    band = 1 + 0.03 * np.linspace(1, -1, len(electrons))[:, None]
    frames = [
        write(tmp_path / f"f_{rate}.dng", expose(electrons, TRUE[rate] * (band if rate == 4000 else 1.0), rng), rate)
        for rate in RATES
    ]
    true = electrons[::2, ::2] * GAIN

    def difference() -> float:
        channels = merge(tmp_path, frames)
        bright = (true * TRUE[1000] > CLIP) & np.isfinite(channels["sigma.R"])
        assert bright[:24].any()
        assert bright[-24:].any()
        ratio = np.where(bright, channels["R"] / true, np.nan)
        return float(abs(np.nanmean(ratio[:24]) - np.nanmean(ratio[-24:])))

    assert difference() < 4e-3
    monkeypatch.setattr("kinran.bracket.exposures.curtain_of", lambda sums, response: ())
    assert difference() > 0.02


def test_swapped_labels(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    frames = bracket(tmp_path / "raw", scene())
    refused(
        tmp_path, frames, r"f_\d+\.dng: EXIF says 0\.0\d+ s, not", capsys, "--times", "1/25,1/250,1/100,1/1000,1/4000"
    )


def test_swapped_frames_whose_exif_lies(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rng = np.random.default_rng(1)
    truth = {25: 25, 100: 250, 250: 100, 1000: 1000, 4000: 4000}
    frames = [write(tmp_path / f"f_{r}.dng", expose(scene(), TRUE[truth[r]], rng), r) for r in RATES]
    refused(tmp_path, frames, r"f_100\.dng: is 0\.\d+ times as bright beside f_25\.dng", capsys)


def test_a_shift_of_two_pixels(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rng = np.random.default_rng(1)
    fine = scene() * (1 + 0.5 * np.kron(rng.integers(0, 2, (64, 64)), np.ones((2, 2))))
    frames = bracket(tmp_path / "raw", fine)
    write(frames[1], expose(np.roll(fine, 4, 1), TRUE[100], rng), 100)
    refused(tmp_path, frames, r"f_100\.dng: does not agree with the other exposures", capsys)


def test_what_moves_in_a_corner_is_flagged(tmp_path: Path) -> None:
    fine = scene()
    moved = fine.copy()
    moved[:16, :32] *= 2
    frames = bracket(tmp_path / "raw", fine)
    write(frames[2], expose(moved, TRUE[250], np.random.default_rng(9)), 250)
    shifted = (merge(tmp_path, frames)["flags"].astype(int) & SHIFTED) > 0
    assert shifted[:8, :16].mean() > 0.4
    assert shifted[10:].mean() < 1e-3


def test_a_black_level_that_is_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Counts from which black was taken already, in a file that says 256."""
    frames = [
        write(
            tmp_path / f"f_{rate}.dng",
            np.maximum(expose(scene(), TRUE[rate], np.random.default_rng(rate)), 256) - 256,
            rate,
        )
        for rate in RATES
    ]
    refused(tmp_path, frames, "darker than darkness|times as bright|does not agree", capsys)


def test_another_bit_depth(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    frames = bracket(tmp_path / "raw", scene())
    counts = expose(scene(), TRUE[250], np.random.default_rng(0)) << 2
    write(frames[2], counts, 250, white=16383)
    refused(tmp_path, frames, "different bit depths", capsys)
    write(frames[2], counts, 250)
    refused(tmp_path, frames, r"f_\d+\.dng: is [\d.]+ times as bright", capsys)


def test_a_truncated_frame(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    frames = bracket(tmp_path / "raw", scene())
    frames[1].write_bytes(frames[1].read_bytes()[:4000])
    refused(tmp_path, frames, r"f_100\.dng: ", capsys)


def test_frames_that_do_not_belong_together(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    frames = bracket(tmp_path / "raw", scene())
    picture = tmp_path / "p_0.004s.png"
    Image.fromarray(np.zeros((64, 64, 3), np.uint8)).save(picture)
    refused(tmp_path, [*frames[:2], picture], "is no file of the kind of", capsys)
    refused(tmp_path, [*frames, frames[0]], "is given twice", capsys)
    refused(tmp_path, [tmp_path / "none.dng"], "no such file", capsys)
    refused(tmp_path, frames, "has 2 times for 5 frames", capsys, "--times", "1/25,1/100")
    refused(tmp_path, frames[:2], "'x' is no time", capsys, "--times", "1/25,x")
    refused(tmp_path, frames, "is for photographs", capsys, "--encoding", "srgb")
    twice = [*frames[:2], write(tmp_path / "again.dng", expose(scene(), TRUE[100], np.random.default_rng(5)), 100)]
    refused(tmp_path, twice, "stands twice", capsys)
    small = write(tmp_path / "small.dng", expose(scene(48), TRUE[250], np.random.default_rng(5)), 250)
    refused(tmp_path, [*frames[:2], small], "its size differs", capsys)
    assert main(["merge", str(frames[0]), "--out", str(tmp_path / "x.png")]) == 2


# -- photographs ---------------------------------------------------------------------------------------------

TIMES = (0.4, 0.1, 0.025, 0.00625)


def picture(side: int = 96, seed: int = 3) -> np.ndarray:
    """Light (side, side, 3) that is white in 1 s at 1, over three decades, smooth."""
    y, x = np.mgrid[0 : 1 : side * 1j, 0 : 1 : side * 1j]
    light = 10 ** (-2 + 3 * x + 0.6 * np.sin(5 * y))
    return light[..., None] * np.array([1.0, 0.8, 0.5])


def photograph(light: np.ndarray, seconds: float, rng: np.random.Generator) -> np.ndarray:
    """Linear light in [0, 1] with noise of 20,000 electrons."""
    return np.clip(light * seconds + rng.normal(0, np.sqrt(light * seconds / 20_000 + 1e-8)), 0, 1)


def photographs(folder: Path, kind: str, curve: object, seed: int = 0) -> list[Path]:
    rng, frames = np.random.default_rng(seed), []
    for seconds in TIMES:
        value = curve(photograph(picture(), seconds, rng))  # type: ignore[operator]
        path = folder / f"p_{seconds * 1000:g}ms.{kind}"
        if kind == "tif":
            tifffile.imwrite(path, np.round(value * 65535).astype(np.uint16), photometric="rgb")
        else:
            exif = Image.Exif()
            exif[0x829A] = seconds
            options = {"quality": 100, "subsampling": 0} if kind == "jpg" else {}
            Image.fromarray(np.round(value * 255).astype(np.uint8)).save(path, exif=exif, **options)
        frames.append(path)
    return frames


def linear(value: np.ndarray) -> np.ndarray:
    return value


def film(value: np.ndarray) -> np.ndarray:
    """A response that is neither linear nor sRGB."""
    return np.clip(1.16 * value**0.42 / (1 + 0.16 * value**0.42), 0, 1)


@pytest.mark.parametrize(
    ("kind", "curve", "found", "bound"),
    [
        ("tif", linear, "linear", 0.005),
        ("png", parse("srgb").encode, "srgb", 0.01),
        ("jpg", parse("srgb").encode, "srgb", 0.02),
        ("png", film, "recovered", 0.06),
    ],
)
def test_photographs_tell_their_encoding(tmp_path: Path, kind: str, curve: object, found: str, bound: float) -> None:
    """Light per second comes out to `bound` at all levels of three decades, on one scale; white is flagged."""
    channels = merge(tmp_path, photographs(tmp_path, kind, curve))
    _, header = read_exr_with_header(tmp_path / "x.exr")
    assert f"({found} photographs)" in str(header["kinran:colour"])
    true = picture()[..., 1]
    seen = np.isfinite(channels["sigma.G"]) & (true > 0.02)
    ratio = channels["G"][seen] / true[seen]
    levels = np.array([np.median(part) for part in np.array_split(ratio[np.argsort(true[seen])], 12)])
    assert np.abs(levels / np.median(ratio) - 1).max() < bound
    if found != "recovered":
        assert np.median(ratio) == pytest.approx(1, abs=0.02)
    assert channels["flags"].max() > 0


def test_twelve_bits_in_sixteen(tmp_path: Path) -> None:
    """White is where the counts pile up, at 4095, whatever the file could hold; taken for 65535 it bends highlights."""
    rng = np.random.default_rng(0)
    frames = []
    for seconds in TIMES:
        path = tmp_path / f"p_{seconds * 1000:g}ms.tif"
        value = np.round(photograph(picture(), seconds, rng) * 4095).astype(np.uint16)
        tifffile.imwrite(path, value, photometric="rgb")
        frames.append(path)
    channels = merge(tmp_path, frames)
    true = picture()[..., 1] * 4095 / 65535
    full = (picture() * TIMES[-1] >= 1).any(-1)
    assert (channels["flags"].astype(int)[full] & SATURATED).all()
    seen = np.isfinite(channels["sigma.G"]) & (true > 0.01)
    assert abs(np.median(channels["G"][seen] / true[seen]) - 1) < 0.02


def test_times_are_needed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    frames = []
    for k in range(2):
        frames.append(tmp_path / f"p{k}.png")
        Image.fromarray(np.full((32, 32, 3), 60 + 60 * k, np.uint8)).save(frames[-1])
    refused(tmp_path, frames, r"p0\.png: has no exposure time in its EXIF or name; give --times", capsys)
    refused(tmp_path, frames, "give srgb, linear or gamma", capsys, "--times", "1,2", "--encoding", "rgb")


def test_photographs_with_swapped_times(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    frames = photographs(tmp_path, "png", parse("srgb").encode)
    refused(
        tmp_path,
        frames,
        "no response makes its bracket consistent|times as bright",
        capsys,
        "--times",
        "0.4,0.025,0.1,0.00625",
    )


def test_debevec_and_malik_by_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The baseline of 1997 with the response that it recovers: to 6 % over a decade and a half.

    It has no σ, and is no number where no exposure has a weight.
    """
    frames = photographs(tmp_path, "png", film)
    ours = merge(tmp_path, frames)
    theirs = merge(tmp_path, frames, "--method", "debevec")
    assert set(theirs) == {"R", "G", "B", "flags"}
    true, seen = picture()[..., 1], np.isfinite(theirs["G"]) & np.isfinite(ours["sigma.G"])
    scale = np.median(theirs["G"][seen] / true[seen])
    middle = seen & (true > 0.3) & (true < 10)
    levels = [np.median(part) for part in np.array_split((theirs["G"] / true)[middle][np.argsort(true[middle])], 8)]
    np.testing.assert_allclose(np.array(levels) / scale, 1, atol=0.06)
    _, header = read_exr_with_header(tmp_path / "x.exr")
    assert header["kinran:method"] == "Debevec and Malik 1997"
    assert "(recovered photographs)" in str(header["kinran:colour"])
    none = np.isnan(theirs["R"]) | np.isnan(theirs["G"]) | np.isnan(theirs["B"])
    np.testing.assert_array_equal(none, theirs["flags"] > 0)
    (tmp_path / "x.exr").unlink()
    refused(tmp_path, bracket(tmp_path / "raw", scene()), "is RAW, but --method debevec", capsys, "--method", "debevec")
