"""Hot, stuck and flickering pixels, odd sizes, and frames that are not of the calibrated camera."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from raw_frames import BLACK, CLIP, GAIN, RATES, READ, TRUE, expose, scene, write

from kinran.base.files import InputError
from kinran.bracket.shots import Bracket, Frame, Taken, read_bracket
from kinran.bracket.superpixels import merge_sites
from kinran.data.calibration import CalibratedCamera, Exposure, Response
from kinran.data.radiance import HOT, SATURATED, SHIFTED
from kinran.data.raw import read_raw

HEIGHT = 48
EXPOSURES = tuple(Exposure(1 / rate, TRUE[rate], TRUE[rate], 1) for rate in RATES)
RESPONSE = Response(CLIP - BLACK, GAIN, float(np.hypot(READ, 12**-0.5)))
CAMERA = CalibratedCamera((float(BLACK),) * 4, False, RESPONSE, EXPOSURES, ())


def bracket(electrons: np.ndarray, seed: int = 0) -> Bracket:
    """Bracket of a mosaic (4, y, x) of electrons a second, (exposure, 4, y, x) where they change."""
    rng = np.random.default_rng(seed)
    each = electrons if electrons.ndim == 4 else [electrons] * len(RATES)
    planes = np.stack([expose(light, TRUE[rate], rng) for light, rate in zip(each, RATES, strict=True)])
    frames = tuple(Frame(Path(f"{rate}.dng"), 1 / rate) for rate in RATES)
    shot = Taken("shot", "light", 0, None, None, frames)
    nominal = np.array([1 / rate for rate in RATES])
    return Bracket(shot, planes, np.full((5, 4), float(BLACK)), None, None, nominal, 4095.0, 0, frames)


def cloth() -> np.ndarray:
    """Dark cloth with a bright part, by which exposures are told."""
    light = np.full((4, HEIGHT, HEIGHT), 3e4)
    light[:, :, :16] = 10 ** np.linspace(5, 7.5, HEIGHT)[:, None]
    return light


def test_hot_sites_are_seen_by_the_dark_frame_alone() -> None:
    """Their current grows with the time as light does: no exposure contradicts another; cloth is 19 times too bright.

    The map of the dark frame flags them; their values come from the neighbours.
    """
    light = cloth()
    hot = ((0, 10, 30), (3, 25, 40), (0, 40, 20))
    for site in hot:
        light[site] += 6e5
    seen = merge_sites(bracket(light), CAMERA)
    wrong = seen.value[10, 30, 0] / (3e4 * GAIN)
    assert wrong > 15
    assert not seen.flags[10, 30, 0] & (SHIFTED | HOT)
    known = merge_sites(bracket(light), replace(CAMERA, bad=hot))
    for plane, y, x in hot:
        c = (0, 1, 1, 2)[plane]
        assert known.flags[y, x, c] & HOT
        assert known.value[y, x, c] == pytest.approx(3e4 * GAIN, rel=0.1)
    assert ((known.flags & HOT) > 0).sum() == len(hot)


def test_one_bad_green_leaves_the_other() -> None:
    light = cloth()
    light[1, 20, 30] = 0
    merged = merge_sites(bracket(light), replace(CAMERA, bad=((1, 20, 30),)))
    assert merged.value[20, 30, 1] == pytest.approx(3e4 * GAIN, rel=0.15)
    assert not merged.flags[20, 30, 1] & HOT


def test_stuck_sites_are_saturated() -> None:
    light = cloth()
    light[0, 30, 30] = 1e9
    merged = merge_sites(bracket(light), CAMERA)
    assert merged.flags[30, 30, 0] & SATURATED
    assert np.isinf(merged.sigma[30, 30, 0])


def test_a_site_that_flickers_disagrees() -> None:
    """Random telegraph noise: in one frame 400 counts more."""
    light = np.repeat(cloth()[None], 5, 0)
    light[2, 3, 20, 20] += 400 / GAIN / TRUE[250]
    merged = merge_sites(bracket(light), CAMERA)
    assert merged.flags[20, 20, 2] & SHIFTED
    assert ((merged.flags & SHIFTED) > 0).sum() <= 3


def test_a_lamp_that_jumps_shifts_nothing() -> None:
    """+2 % in one exposure: the ratio of the frames takes it up, and no level bends by more than 0.2 %."""
    light = np.repeat(cloth()[None], 5, 0)
    light[2] *= 1.02
    steady, jumped = merge_sites(bracket(cloth()), CAMERA), merge_sites(bracket(light), CAMERA)
    ratio = jumped.value / steady.value
    levels = [np.median(ratio[rows, :16]) for rows in (np.s_[:10], np.s_[20:30], np.s_[38:])]
    assert np.ptp(levels) < 2e-3
    assert ((jumped.flags & SHIFTED) > 0).mean() < 1e-3


def test_another_white_level_than_the_calibrations() -> None:
    """The calibration says 10 % more or less than where counts end: another ISO or another camera."""
    light = cloth()
    light[:, :, 30:] = 1e8
    for factor in (1.1, 0.9):
        other = replace(CAMERA, response=replace(RESPONSE, saturation=factor * RESPONSE.saturation))
        with pytest.raises(InputError, match=r"25\.dng: counts end at \d+ over black but those of the calibration at"):
            merge_sites(bracket(light), other)


def test_counts_below_darkness() -> None:
    """A black level of 300 where it is 256: dark cloth comes out below nothing."""
    with pytest.raises(InputError, match="darker than darkness"):
        merge_sites(bracket(np.full((4, HEIGHT, HEIGHT), 2e3)), replace(CAMERA, black=(300.0,) * 4))
    wrong = replace(bracket(np.full((4, HEIGHT, HEIGHT), 2e3)), mask=np.full((5, 4), 300.0))
    with pytest.raises(InputError, match="darker than darkness"):
        merge_sites(wrong, replace(CAMERA, black=(300.0,) * 4))


def test_nan_reaches_no_sample() -> None:
    """Whatever is asked of the estimator, what comes out is finite but for σ of saturated samples."""
    light = np.stack([scene(24, seed)[::2, ::2][:24, :24] for seed in range(4)])
    light[:, :4] = 0
    light[:, 4:8] = 1e10
    merged = merge_sites(bracket(light), CAMERA)
    assert np.isfinite(merged.value).all()
    assert not np.isnan(merged.sigma).any()


@pytest.mark.parametrize(("height", "width", "mask"), [(33, 48, 8), (32, 49, 8), (48, 64, 6), (48, 64, 0)])
def test_odd_sizes_keep_the_phase(tmp_path: Path, height: int, width: int, mask: int) -> None:
    """An odd row or column is left out; another mask, or none, moves no colour."""
    light = np.full((height, width), 3e5)
    light[::2, ::2] *= 2
    light[1::2, 1::2] *= 0.5
    write(tmp_path / "f.dng", expose(light, TRUE[100], np.random.default_rng(0)), 100, mask=mask)
    frame = read_raw(tmp_path / "f.dng")
    assert frame.planes.shape == (4, height // 2, width // 2)
    assert (frame.mask is not None) == (mask > 0)
    means = (frame.planes.mean((1, 2)) - BLACK) / (3e5 * GAIN * TRUE[100])
    np.testing.assert_allclose(means, [2, 1, 1, 0.5], rtol=0.01)


def test_iso_and_aperture_must_not_change(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from kinran.bracket import shots

    rng = np.random.default_rng(0)
    paths = [write(tmp_path / f"f_{rate}.dng", expose(scene(), TRUE[rate], rng), rate) for rate in (25, 100)]
    shot = Taken("s", "light", 0, None, None, tuple(Frame(p, 1 / r) for p, r in zip(paths, (25, 100), strict=True)))
    assert read_bracket(shot).planes.shape[0] == 2
    for name, value in (("iso", 400.0), ("aperture", 4.0)):

        def other(path: Path, name: str = name, value: float = value) -> object:
            frame = read_raw(path)
            return replace(frame, **{name: value}) if path == paths[1] else replace(frame, iso=100.0, aperture=8.0)

        monkeypatch.setattr(shots, "read_raw", other)
        with pytest.raises(InputError, match=rf"f_100\.dng: has {'ISO 400' if name == 'iso' else 'aperture 4'}"):
            read_bracket(shot)
