"""The simulated camera: its files, its counts, its determinism."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from kinran.base.files import InputError
from kinran.data.raw import read_raw
from kinran.rig.camera import CameraError
from kinran.virtual.dng import Tags, write_dng
from kinran.virtual.sensor import BORDER, CROSSTALK, Sensor, shutter
from kinran.virtual.simulated_camera import SimulatedCamera
from kinran.virtual.weave import VirtualFabric

SCENE = {"texels": 16, "seed": 5}


class Rig:
    """A goniometer that stands still."""

    def __init__(self, *pose: float) -> None:
        self.pose = (*pose, 0.0, 0.0)
        self.shutter_open = True
        self.lamp_seconds = 900.0
        self.lamp_output = 1.0


def camera(folder: Path, *pose: float, card: str = "card") -> SimulatedCamera:
    """A camera whose fabric is a wedge that falls from bottom left to top right."""
    fabric = VirtualFabric(**SCENE)
    wedge = np.linspace(1.0, 0.1, 16) * np.linspace(1.0, 0.5, 16)[:, None]
    cached = folder / "cache" / fabric.digest() / "30000_90000.npy"
    cached.parent.mkdir(parents=True, exist_ok=True)
    np.save(cached, (wedge[..., None] * np.ones(3)).astype(np.float32))
    return SimulatedCamera(Rig(*(pose or (30_000.0, 90_000.0))), folder / card, SCENE, folder / "cache")


def names(of: SimulatedCamera) -> list[str]:
    return [file.name for file in of.card()]


def test_a_dng_comes_back_bit_by_bit(tmp_path: Path) -> None:
    """Counts, black, shutter time and colour filters pass through LibRaw unchanged."""
    from fractions import Fraction

    counts = np.random.default_rng(1).integers(0, 4096, (32 + BORDER, 40)).astype(np.uint16)
    path = tmp_path / "frame.dng"
    write_dng(path, counts, Tags(Fraction(1, 250), BORDER, 256, 4095, "2000:01:01 00:00:00"))
    frame = read_raw(path)
    picture = counts[BORDER:][::-1]  # rows from the bottom: B rows come first
    np.testing.assert_array_equal(frame.planes[0], picture[1::2, 0::2])
    np.testing.assert_array_equal(frame.planes[1], picture[1::2, 1::2])
    np.testing.assert_array_equal(frame.planes[2], picture[0::2, 0::2])
    np.testing.assert_array_equal(frame.planes[3], picture[0::2, 1::2])
    assert frame.seconds == pytest.approx(1 / 250, rel=1e-6)
    assert frame.white == 4095


def test_darkness_under_the_mask_forgets_hot_sites(tmp_path: Path) -> None:
    from fractions import Fraction

    rng = np.random.default_rng(2)
    counts = np.round(rng.normal(256.4, 1.2, (64 + BORDER, 64))).astype(np.uint16)
    counts[3, 10] = 4000
    path = tmp_path / "frame.dng"
    write_dng(path, counts, Tags(Fraction(1, 25), BORDER, 256, 4095, "2000:01:01 00:00:00"))
    frame = read_raw(path)
    assert frame.black.tolist() == [256] * 4
    assert frame.mask == pytest.approx([256.4] * 4, abs=0.45)


def test_counts_follow_radiance_shutter_and_lamp(tmp_path: Path) -> None:
    """The mean of each plane is radiance × crosstalk × rate × true time to 0.5 %, v = 0 at row 0."""
    taken = camera(tmp_path)
    taken.expose(1 / 1000)
    (name,) = names(taken)
    frame = read_raw(tmp_path / "card" / name)
    sensor = Sensor()
    wedge = np.linspace(1.0, 0.1, 16) * np.linspace(1.0, 0.5, 16)[:, None]
    electrons = wedge * sensor.rate * shutter(1 / 1000)
    for plane, channel in enumerate((0, 1, 1, 2)):
        signal = (frame.planes[plane] - frame.black[plane]) * sensor.gain / CROSSTALK[channel].sum()
        assert signal.mean() == pytest.approx(electrons.mean(), rel=0.005)
        assert np.corrcoef(signal.ravel(), electrons.ravel())[0, 1] > 0.99


def test_a_rerun_gives_the_same_bytes(tmp_path: Path) -> None:
    files = []
    for card in ("one", "two"):
        taken = camera(tmp_path, card=card)
        for seconds in (1 / 25, 1 / 250, 1 / 250):
            taken.expose(seconds)
        files.append([(tmp_path / card / name).read_bytes() for name in names(taken)])
    assert files[0] == files[1]
    assert files[0][1] != files[0][2]  # but every frame has noise of its own


def test_shutter_times_are_third_stops_but_for_the_curtain() -> None:
    assert shutter(1 / 25) == pytest.approx(1 / 25.4, rel=2e-3)
    assert shutter(1 / 4000) == pytest.approx(1 / 4096, rel=2e-2)
    assert abs(shutter(1 / 100) * 101.6 - 1) < 2e-3
    assert abs(shutter(1 / 100) * 100 - 1) > 0.01  # far from the nominal time


def test_a_closed_shutter_and_a_cap_are_dark(tmp_path: Path) -> None:
    taken = camera(tmp_path)
    rig = taken._rig
    rig.shutter_open = False
    taken.expose(1 / 25)
    rig.shutter_open = True
    taken.place("dark")
    taken.expose(1 / 25)
    for name in names(taken):
        frame = read_raw(tmp_path / "card" / name)
        assert np.median(frame.planes) == pytest.approx(256, abs=2)


def test_sites_saturate_well_under_the_stated_white(tmp_path: Path) -> None:
    taken = camera(tmp_path)
    taken.expose(1 / 25)
    frame = read_raw(tmp_path / "card" / names(taken)[0])
    assert frame.planes.max() == Sensor().clip < 0.95 * frame.white


def test_the_card_keeps_counting_when_files_are_deleted(tmp_path: Path) -> None:
    taken = camera(tmp_path)
    taken.expose(1 / 25)
    (first,) = names(taken)
    taken.download(first, tmp_path / "copy.dng")
    taken.delete(first)
    taken.expose(1 / 25)
    (second,) = names(camera(tmp_path))
    assert second != first
    assert read_raw(tmp_path / "copy.dng").planes.shape == (4, 16, 16)
    with pytest.raises(CameraError, match="no such file on the card"):
        taken.delete(first)
    shutil.rmtree(tmp_path / "card")


@pytest.mark.parametrize(
    ("scene", "message"),
    [
        ({"texel": 8}, "'texel' is not known"),
        ({"motif": "dragon"}, "motif = 'dragon'; give one of comma, waves, lozenges"),
        ({"threads": "gold"}, "threads = 'gold'; give one of red, indigo, moss"),
        ({"texels": 0}, "texels = 0"),
        ({"texels": 8}, "at least 16"),
        ({"texels": "8"}, "texels = '8'"),
        ({"lamp_mm": -1.0}, "lamp_mm = -1"),
    ],
)
def test_a_wrong_scene_is_refused(tmp_path: Path, scene: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        SimulatedCamera(Rig(0.0, 0.0), tmp_path, scene)


def test_a_subject_or_time_that_is_not_there_is_refused(tmp_path: Path) -> None:
    taken = camera(tmp_path)
    with pytest.raises(CameraError, match="subject 'cat'"):
        taken.place("cat")
    with pytest.raises(CameraError, match="shutter time"):
        taken.expose(1e-6)
