"""A bracket of losslessly compressed DNG files with known truth."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks import merge_real
from kinran.__main__ import main
from kinran.base.exr import read_exr_with_header
from kinran.bracket.estimator import estimate
from kinran.data.calibration import Response
from kinran.data.raw import read_raw


@pytest.mark.real
def test_a_compressed_bracket_is_merged_without_bias(real_data: Path) -> None:
    """Per decade of electrons a second, 0.1 % from 10⁴ on; σ to 5 %."""
    data = real_data / "hdr_synth"
    frames = [read_raw(data / f"b_{rate}.dng") for rate in (25, 100, 250, 1000, 4000)]
    seconds = 2.0 ** (-np.array([14, 20, 24, 30, 36]) / 3)
    np.testing.assert_allclose([frame.seconds for frame in frames], seconds, rtol=0.03)
    truth = np.load(data / "truth_e_per_s_f32.npy")
    site = ((0, 0), (0, 1), (1, 0), (1, 1))
    response = Response(3726 - 256, 1 / 12.1, float(np.hypot(20 / 12.1, 12**-0.5)))
    for plane, (row, column) in enumerate(site):
        counts = np.stack([frame.planes[plane] for frame in frames])
        black = np.array([frame.black[plane] for frame in frames])
        rate, sigma, _ = estimate(counts, black, seconds, response)
        expected = truth[row::2, column::2][::-1]
        for low in (1e4, 1e5, 1e6, 1e7):
            use = (expected > low) & (expected < 10 * low) & np.isfinite(sigma)
            if use.sum() > 3000:
                bias = (rate[use] / response.gain).sum() / expected[use].sum() - 1
                assert abs(bias) < 1e-3, (plane, low, bias)
                z = (rate[use] - expected[use] * response.gain) / sigma[use]
                assert np.sqrt(np.mean(z**2)) == pytest.approx(1, abs=0.05)


@pytest.mark.real
def test_real_patches_are_what_a_spectrometer_says(real_data: Path) -> None:
    """24 patches in 6 narrow bands over 1000 : 1, from 8-bit frames: median residual ≤ 5 %, worst patch ≤ 12 %.

    Times are those of the names, to 2 % in the middle; leave-one-out ΔE00 ≤ 7.
    """
    found = merge_real.evaluate(real_data)
    assert found["patches"] >= 140
    assert found["median_residual_percent"] < 5
    assert found["worst_patch_residual_percent"] < 12
    assert found["times_over_nominal"][1] == pytest.approx(1, abs=0.02)
    assert min(found["leave_one_out_delta_e"]["linear"], found["leave_one_out_delta_e"]["root polynomial"]) < 7


@pytest.mark.real
@pytest.mark.parametrize("band", [450, 550, 650])
def test_real_frames_merge_by_their_names_alone(real_data: Path, tmp_path: Path, band: int) -> None:
    frames = sorted((real_data / merge_real.FRAMES).glob(f"*_{band}nm_*.tif"))
    assert len(frames) == 7
    assert main(["merge", *map(str, frames), "--out", str(tmp_path / "x.exr")]) == 0
    channels, header = read_exr_with_header(tmp_path / "x.exr")
    assert "linear photographs" in str(header["kinran:colour"])
    lit = channels["G"] > 0
    assert channels["G"][lit].max() / np.percentile(channels["G"][lit], 1) > 100
    assert (channels["flags"].astype(int) & 1).mean() < 0.01


@pytest.mark.real
def test_a_real_dng_bracket_by_the_command(real_data: Path, tmp_path: Path) -> None:
    """Losslessly compressed DNG, no calibration at all: per decade 0.1 % of the truth, σ to 5 %."""
    data = real_data / "hdr_synth"
    frames = [data / f"b_{rate}.dng" for rate in (250, 25, 4000, 100, 1000)]
    assert main(["merge", *map(str, frames), "--out", str(tmp_path / "x.exr")]) == 0
    channels, _ = read_exr_with_header(tmp_path / "x.exr")
    truth = np.load(data / "truth_e_per_s_f32.npy")
    for name, (row, column) in {"R": (0, 0), "B": (1, 1)}.items():
        true, sigma = truth[row::2, column::2] / 12.1, channels[f"sigma.{name}"]
        for low in (1e4, 1e5, 1e6, 1e7):
            use = (true * 12.1 > low) & (true * 12.1 < 10 * low) & np.isfinite(sigma)
            if use.sum() > 3000:
                assert abs(channels[name][use].sum() / true[use].sum() - 1) < 1e-3
                assert np.sqrt(np.mean(((channels[name] - true)[use] / sigma[use]) ** 2)) == pytest.approx(1, abs=0.05)
