"""A white card under the lights of a set evens out its lamps; a card that is none is refused."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from kinran.base.encoding import to_srgb
from kinran.base.files import InputError
from kinran.calibrate import calibrate
from kinran.capture import ingest, ingest_group
from kinran.capture.photograph_set import Known
from kinran.data.calibration import read_calibration
from kinran.data.radiance_stack import Stack
from kinran.radiance import merge_group, stack
from kinran.run.rti import check_card

HEIGHT, WIDTH, LIGHTS = 40, 56, 8


def lamp_light(rng: np.random.Generator) -> np.ndarray:
    """Light (light, y, x, 3) of lamps of other brightness and colour, each brighter on its own side, top row first."""
    y, x = np.mgrid[:HEIGHT, :WIDTH] / WIDTH - 0.5
    fields = []
    for _ in range(LIGHTS):
        a, b, c = rng.uniform(-0.5, 0.5, 3)
        field = 1 + a * x + b * y + c * x * y - 0.4 * (x**2 + y**2)
        fields.append(field[..., None] * rng.uniform(0.6, 1.4, 3))
    return np.array(fields)


def write(folder: Path, name: str, light: np.ndarray, noise: np.random.Generator, seconds: float = 0.01) -> None:
    folder.mkdir(exist_ok=True)
    codes = to_srgb(np.clip(light + noise.normal(0, 0.002, light.shape), 0, 1))
    exif = Image.Exif()
    exif[274] = 1  # Pillow writes no EXIF of a PNG without a tag of its own
    exif.get_ifd(0x8769)[0x829A] = seconds
    Image.fromarray((codes * 255 + 0.5).astype(np.uint8)).save(folder / name, exif=exif)


def make(tmp_path: Path, names: str = "{:02d}.png") -> tuple[np.ndarray, np.ndarray]:
    """A set of a matt cloth with a card of 0.6; returns what even lamps would show, and what the lamps show."""
    rng = np.random.default_rng(4)
    lamps = lamp_light(rng)
    cloth = np.kron(rng.uniform(0.1, 0.5, (HEIGHT // 4, WIDTH // 4)), np.ones((4, 4)))[..., None] * [1, 0.8, 0.6]
    even, rows = [], [str(LIGHTS)]
    for k in range(LIGHTS):
        theta, phi = np.radians(20 + 6 * k), k * 2.4
        vector = np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)
        rows.append(f"{k:02d}.png " + " ".join(f"{part:.8f}" for part in vector))
        write(tmp_path / "set", f"{k:02d}.png", cloth * lamps[k] * vector[2], rng)
        write(tmp_path / "card", names.format(k), 0.6 * lamps[k] * vector[2], rng)
        even.append(cloth * vector[2])
    (tmp_path / "set" / "dome.lp").write_text("\n".join(rows) + "\n")
    middle = lamps[:, HEIGHT // 2 - 1 : HEIGHT // 2 + 1, WIDTH // 2 - 1 : WIDTH // 2 + 1].mean((1, 2))
    return np.array(even) * middle.mean(0), np.array(even) * lamps


def prepare(tmp_path: Path) -> None:
    """Plan and manifest of the set."""
    ingest.main(ingest.Inputs(tmp_path / "set"), tmp_path / "c" / "plan.json", ingest.Options(fabric="cloth"))
    ingest_group.main(
        ingest_group.Inputs(tmp_path / "set", tmp_path / "c" / "plan.json"),
        tmp_path / "c" / "groups" / "00.json",
        ingest_group.Options(group="00"),
    )


def calibrated(tmp_path: Path, flat: Path | None) -> Path:
    out = tmp_path / "calibration.json"
    inputs = calibrate.Inputs(tmp_path / "c" / "plan.json", (tmp_path / "c" / "groups" / "00.json",), None, flat)
    calibrate.main(inputs, out)
    return out


def test_a_card_evens_out_field_brightness_and_colour_of_each_lamp(tmp_path: Path) -> None:
    even, seen = make(tmp_path)
    assert np.median(np.abs(seen / even - 1)) > 0.15  # what the lamps do
    prepare(tmp_path)
    calibration = calibrated(tmp_path, tmp_path / "card")
    group = tmp_path / "c" / "groups" / "00.json"
    merged = merge_group.Outputs(tmp_path / "radiance.zarr", tmp_path / "00.json")
    merge_group.main(merge_group.Inputs(tmp_path / "c" / "plan.json", calibration, group), merged)
    stack.main(
        stack.Inputs(tmp_path / "c" / "plan.json", calibration, (group,), (tmp_path / "00.json",)),
        tmp_path / "radiance.zarr",
        stack.Options(0),
    )
    found, _ = Stack.open(tmp_path / "radiance.zarr").read_stored(0, HEIGHT, 0, WIDTH)
    assert np.median(np.abs(found[:, ::-1] / even - 1)) < 0.01


def fault(folder: Path, kind: str) -> None:
    """Spoil the card under one lamp."""
    path = folder / "03.png"
    codes = np.asarray(Image.open(path))
    rng = np.random.default_rng(1)
    spoiled = {
        "saturated": np.minimum(codes.astype(int) * 2, 255).astype(np.uint8),
        "dark": codes // 40,
        "smooth": (codes * np.kron(rng.uniform(0.2, 1, (10, 14, 1)), np.ones((4, 4, 1)))).astype(np.uint8),
        "texels": codes[:-4],
        "exposure": codes,
    }[kind]
    exif = Image.Exif()
    exif[274] = 1  # Pillow writes no EXIF of a PNG without a tag of its own
    exif.get_ifd(0x8769)[0x829A] = 0.02 if kind == "exposure" else 0.01
    Image.fromarray(spoiled).save(path, exif=exif)


@pytest.mark.parametrize(
    ("kind", "says"),
    [
        ("saturated", r"03\.png: \d+% of the card is saturated"),
        ("dark", r"03\.png: the card reads \d\.\d+% of white"),
        ("smooth", r"03\.png: differs by \d+% from a smooth surface"),
        ("exposure", r"03\.png: was taken with 0\.02 s but 00\.png with 0\.01 s"),
        ("texels", r"03\.png: gives 56 × 36 texels but the set 56 × 40"),
    ],
)
def test_a_card_that_is_none_is_refused(tmp_path: Path, kind: str, says: str) -> None:
    make(tmp_path)
    prepare(tmp_path)
    fault(tmp_path / "card", kind)
    with pytest.raises(InputError, match=says):
        calibrated(tmp_path, tmp_path / "card")


def test_a_card_is_checked_before_a_run_begins(tmp_path: Path) -> None:
    make(tmp_path)
    found = ingest.inspect(tmp_path / "set", Known(), 0)
    check_card(tmp_path / "card", found)
    fault(tmp_path / "card", "texels")
    with pytest.raises(InputError, match=r"03\.png: is 56x36 but the set 56x40"):
        check_card(tmp_path / "card", found)
    (tmp_path / "card" / "03.png").unlink()
    with pytest.raises(InputError, match=r"card/03: no such image"):
        check_card(tmp_path / "card", found)


def test_a_card_with_names_of_its_own_goes_by_order(tmp_path: Path) -> None:
    make(tmp_path, "IMG_{}.png")
    prepare(tmp_path)
    lamps = read_calibration(calibrated(tmp_path, tmp_path / "card")).lamps
    brightness = [lamp.values(HEIGHT, WIDTH).mean() for lamp in lamps]
    truth = lamp_light(np.random.default_rng(4)).mean((1, 2, 3))
    np.testing.assert_allclose(brightness / np.mean(brightness), truth / truth.mean(), rtol=0.1)
    assert np.ptp(truth) > 0.2
