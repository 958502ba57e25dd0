"""Photographs in brackets, grouped by light: from a folder with a .lp file to the stack."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from raw_frames import BLACK, CLIP, GAIN, RATES, TRUE, expose, write
from stages import make_stack

from kinran.base.encoding import parse
from kinran.base.files import InputError
from kinran.capture import ingest, ingest_group
from kinran.capture.photograph_set import Known, inspect
from kinran.data.calibration import read_calibration
from kinran.data.light import LpLight
from kinran.data.light_files import write_lp
from kinran.data.radiance import SATURATED
from kinran.data.radiance_stack import Stack

COUNT, SIDE = 9, 48
TIMES = (0.4, 0.1, 0.025)


def truth(light: int) -> np.ndarray:
    """LpLight (SIDE, SIDE, 3) in white a second, row 0 at the bottom: three decades, each light of its own level."""
    y, x = np.mgrid[0 : 1 : SIDE * 1j, 0 : 1 : SIDE * 1j]
    level = 10 ** (-1.2 + 2.4 * x + 0.5 * np.sin(4 * y + light)) * (1 + 0.2 * light)
    return level[..., None] * np.array([1.0, 0.7, 0.4])


def lights(folder: Path) -> None:
    angles = np.linspace(0, 2 * np.pi, COUNT, endpoint=False)
    vectors = [(0.5 * float(np.cos(a)), 0.5 * float(np.sin(a)), 0.75**0.5) for a in angles]
    write_lp(folder / "set.lp", [LpLight(f"l{k}", vector, f"l{k}.png") for k, vector in enumerate(vectors)])


@pytest.fixture(params=["folders", "names"])
def folder(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """Nine lights of three exposures: in a folder each, or named after their light."""
    rng = np.random.default_rng(0)
    lights(tmp_path)
    for k in range(COUNT):
        for seconds in TIMES:
            mean = truth(k)[::-1] * seconds
            seen = np.clip(mean + rng.normal(0, np.sqrt(mean / 20_000)), 0, 1)
            picture = Image.fromarray(np.round(parse("srgb").encode(seen) * 255).astype(np.uint8))
            name = f"l{k}/{seconds}s.png" if request.param == "folders" else f"l{k}_{seconds * 1000:g}ms.png"
            (tmp_path / name).parent.mkdir(exist_ok=True)
            exif = Image.Exif()
            if request.param == "folders":
                exif[0x829A] = seconds
            picture.save(tmp_path / name, exif=exif)
    return tmp_path


def run(folder: Path, encoding: str = "srgb", crop: str = "") -> Stack:
    plan, manifest = folder / "captures/set/plan.json", folder / "captures/set/groups/00.json"
    options = ingest.Options(encoding=encoding, crop=crop, fabric="set", holdout=4)
    ingest.main(ingest.Inputs(folder), plan, options)
    ingest_group.main(ingest_group.Inputs(folder, plan), manifest, ingest_group.Options(group="00"))
    return make_stack(folder, plan, manifest)


def test_a_photograph_that_was_changed_meanwhile(folder: Path) -> None:
    run(folder)
    path = next(folder.rglob("*.png"))
    with Image.open(path) as picture:
        changed, exif = picture.point([255 - k for k in range(256)] * 3), picture.getexif()
    changed.save(path, exif=exif)
    manifest = folder / "captures/set/groups/00.json"
    said = f"{path.name}: has other bytes .*; put the photograph back, or take it in as it is now: `snakemake --force"
    with pytest.raises(InputError, match=said):
        make_stack(folder, folder / "captures/set/plan.json", manifest)


def test_brackets_become_radiance_on_one_scale(folder: Path) -> None:
    """All lights to 1 % of one scale at all levels: 1 is white of the longest exposure."""
    stack = run(folder)
    seen = stack.read_tile(0, SIDE, 0, SIDE)
    values, flags = seen.value, seen.flags
    assert (stack.encoding, stack.noise["kind"]) == ("", "raw")
    true = np.stack([truth(k) for k in range(COUNT)]) * 0.4
    seen = ((flags & SATURATED) == 0) & (true > 0.02)
    ratio = np.where(seen, values / true, np.nan)
    np.testing.assert_allclose(np.nanmedian(ratio, axis=(1, 2, 3)), 1, atol=0.012)
    bright = seen & (true > 2)
    assert bright.any()
    assert np.median(ratio[bright]) == pytest.approx(np.median(ratio[seen & (true < 0.2)]), rel=0.02)
    assert (flags[(true > 16.2)] & SATURATED).all()


def test_a_crop_is_from_the_top_left(folder: Path) -> None:
    stack = run(folder, crop="8,4,20,10")
    seen = stack.read_tile(0, 10, 0, 20)
    values, flags = seen.value, seen.flags
    assert (stack.height, stack.width) == (10, 20)
    true = truth(3)[SIDE - 14 : SIDE - 4, 8:28] * 0.4
    seen = flags[3] == 0
    assert np.median(np.abs(values[3] / true - 1)[seen]) < 0.02


def test_a_wrong_encoding_gives_way(folder: Path) -> None:
    """What the bracket says is believed, not what is given."""
    run(folder, "linear")
    assert read_calibration(folder / "calibration.json").encoding == "srgb"


def test_raw_brackets_by_light(tmp_path: Path) -> None:
    """DNG brackets of each light: radiance to 0.5 %, on the scale of the longest exposure."""
    lights(tmp_path)
    rng = np.random.default_rng(1)
    levels = [10 ** np.linspace(4.5, 7.5, 64)[None] * np.ones((64, 1)) * (1 + 0.1 * k) for k in range(COUNT)]
    for k, level in enumerate(levels):
        (tmp_path / f"l{k}").mkdir()
        for rate in RATES[::2]:
            write(tmp_path / f"l{k}/{rate}.dng", expose(level, TRUE[rate], rng), rate)
    stack = run(tmp_path)
    seen = stack.read_tile(0, 32, 0, 32)
    values, flags = seen.value, seen.flags
    for k, level in enumerate(levels):
        seen = flags[k, ..., 1] == 0
        expected = level.reshape(32, 2, 32, 2).mean((1, 3)) / 12.1 * TRUE[25] / 3470
        assert np.median(values[k, ..., 1][seen] / expected[seen]) == pytest.approx(1, abs=5e-3)
    assert stack.colour == "camera RGB, balanced for daylight"


def test_what_must_stop(folder: Path) -> None:
    frames = sorted(folder.glob("l3*/*.png")) or sorted(folder.glob("l3_*.png"))
    frames[0].rename(folder / "elsewhere.txt")
    frames[1].rename(folder / "elsewhere2.txt")
    with pytest.raises(InputError, match="light 'l3' has 1 image"):
        inspect(folder, Known(), 4)
    frames[2].unlink()
    with pytest.raises(InputError, match=r"l3.png: no such image"):
        inspect(folder, Known(), 4)


def test_an_unknown_time(folder: Path) -> None:
    frame = next(iter(sorted(folder.glob("l3*/*.png")) or sorted(folder.glob("l3_*.png"))))
    Image.open(frame).convert("RGB").save(frame.with_name("l3_a.png"))
    frame.unlink()
    with pytest.raises(InputError, match=r"l3_a\.png: has no exposure time in its EXIF; rename it"):
        inspect(folder, Known(), 4)


def test_a_raw_file_for_each_light(tmp_path: Path) -> None:
    """One DNG a light, known by its bytes: radiance to 1 %, in the time that their EXIF states."""
    lights(tmp_path)
    rng = np.random.default_rng(1)
    levels = [10 ** np.linspace(4.5, 6, 64)[None] * np.ones((64, 1)) * (1 + 0.1 * k) for k in range(COUNT)]
    for k, level in enumerate(levels):
        write(tmp_path / f"l{k}.dng", expose(level, TRUE[25], rng), 25).rename(tmp_path / f"l{k}.tif")
    stack = run(tmp_path)
    values = stack.read_tile(0, 32, 0, 32).value
    true = np.stack([level.reshape(32, 2, 32, 2).mean((1, 3)) for level in levels]) * GAIN * TRUE[25] / (CLIP - BLACK)
    lit = true > 0.02
    ratio = values[..., 1] / true
    assert np.median(ratio[lit]) == pytest.approx(1, abs=0.01)
    np.testing.assert_allclose([np.median(r[s]) for r, s in zip(ratio, lit, strict=True)], 1, atol=0.01)
