"""The path-traced fabric: its unit, its frame, its cache."""

from pathlib import Path

import numpy as np
import pytest

from kinran.base.frames import direction
from kinran.virtual import targets, yarn
from kinran.virtual.weave import COLOURS, VirtualFabric, _materials, load_scene

N = (0.0, 0.0, 1.0)


@pytest.fixture(scope="module")
def fabric() -> VirtualFabric:
    return VirtualFabric(texels=24, samples=16)


def flat(half: float, material: int, z: float = 0.3) -> yarn.Surface:
    """A sheet over the whole field."""
    x = np.linspace(-half, half, 5)
    points = np.stack(np.broadcast_arrays(x[:, None], x, z), -1)
    normals = np.broadcast_to(np.array(N), points.shape)
    return yarn.Surface(points, normals, points[..., :2], material)


def test_the_unit_is_a_white_diffuser_that_faces_the_lamp(monkeypatch: pytest.MonkeyPatch) -> None:
    """Path tracer and inverse-square cosine law agree to 0.5 % on a diffuse sheet, at all angles."""
    fabric = VirtualFabric(field_mm=40.0, texels=8, samples=1024, lamp_mm=200.0)
    white = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 1.0}}
    monkeypatch.setattr("kinran.virtual.weave._materials", lambda threads: dict.fromkeys(yarn.MATERIALS, white))
    fabric.__dict__["_scene"] = load_scene(fabric, [flat(22.0, 0, z=0.0)])
    for theta, phi in ((0, 0), (40, 0), (40, 90), (75, 200)):
        light = direction(np.radians(theta), np.radians(phi))
        expected = targets.white(light, 40.0, 8, 200.0)
        np.testing.assert_allclose(fabric.trace(light), expected, rtol=0.005)


def test_columns_follow_the_weft_and_rows_the_warp(fabric: VirtualFabric) -> None:
    """Blue comma at the lower left, white sail at the lower right, gold above: no mirror, no turn."""
    label, purity = fabric.labels()
    names = fabric.names
    centre = {name: np.argwhere(label == k).mean(0) for k, name in enumerate(names) if name != "red"}
    middle = (fabric.texels - 1) / 2
    assert (label == names.index("gold")).mean() > 0.25
    assert centre["blue"][0] < middle
    assert centre["blue"][1] < middle
    assert centre["white"][0] < middle
    assert centre["white"][1] > middle
    assert centre["gold"][0] > middle
    assert purity.min() > 0.2
    image = fabric.trace(N)
    blue, gold = (image[label == names.index(name)].mean(0) for name in ("blue", "gold"))
    assert blue[2] > 2 * blue[0]
    assert gold[0] > gold[1] > gold[2]


def test_the_shadow_is_on_the_side_away_from_the_lamp() -> None:
    """A sheet that floats at 1 mm throws its shadow 1.7 mm far under a lamp at 60°."""
    fabric = VirtualFabric(texels=24, samples=16)
    fabric.__dict__["_scene"] = load_scene(fabric, [flat(4.0, 0, z=0.0), flat(0.6, 0, z=1.0)])
    low, high, middle = 5, 18, 12  # texels at -1.3, 1.3 and 0.1 mm
    for phi, lit, dark in (
        (0, (middle, high), (middle, low)),
        (90, (high, middle), (low, middle)),
        (180, (middle, low), (middle, high)),
        (270, (low, middle), (high, middle)),
    ):
        image = fabric.trace(direction(np.radians(60), np.radians(phi)))[..., 0]
        assert image[dark] < 0.3 * image[lit], (phi, image[dark], image[lit])


def test_the_same_direction_gives_the_same_values(fabric: VirtualFabric) -> None:
    light = direction(0.5, 1.0)
    first = fabric.trace(light)
    fabric.trace(N)
    np.testing.assert_array_equal(fabric.trace(light), first)


def test_a_traced_frame_is_paid_once(fabric: VirtualFabric, tmp_path: Path) -> None:
    first = fabric.frame(30_000, 45_000, tmp_path)
    (path,) = tmp_path.rglob("*.npy")
    assert path.name == "30000_45000.npy"

    class Untraceable(VirtualFabric):
        def trace(self, light: object) -> np.ndarray:
            raise AssertionError("traced again")

    again = Untraceable(texels=24, samples=16)
    np.testing.assert_array_equal(again.frame(30_000, 45_000, tmp_path), first)
    path.write_bytes(path.read_bytes()[:100])  # a torn file is traced anew
    np.testing.assert_array_equal(fabric.frame(30_000, 45_000, tmp_path), first)
    assert fabric.digest() != VirtualFabric(texels=25, samples=16).digest()


def test_azimuth_means_nothing_at_the_pole(fabric: VirtualFabric, tmp_path: Path) -> None:
    fabric.frame(0, 123_000, tmp_path)
    assert [path.name for path in tmp_path.rglob("*.npy")] == ["0_0.npy"]


def test_the_chart_is_upright() -> None:
    image = targets.chart(N, 4.8, 48, 600.0)
    top_left, bottom_left = image[-6, 4], image[6, 4]
    np.testing.assert_allclose(top_left, targets.CHART[0], rtol=1e-3)  # dark skin
    np.testing.assert_allclose(bottom_left, targets.CHART[18], rtol=1e-3)  # white


def test_fabrics_differ_by_motif_and_threads() -> None:
    """Each motif floats elsewhere, on 5 to 30 % of the fabric, and has no symmetry; threads change the silk alone."""
    x, ys = np.arange(0, yarn.REPEAT, 0.05), np.arange(0.0, yarn.REPEAT, 0.05)
    maps = {}
    for motif in yarn.MOTIFS:
        figure = np.zeros((len(ys), len(x)), int)
        for x0, x1, y, material in yarn._figure(-yarn.REPEAT / 2, yarn.REPEAT / 2, motif):
            row = round((y + yarn.REPEAT / 2) / 0.05)
            figure[row - 1 : row + 2, (x + 0.05 > x0 + yarn.REPEAT / 2) & (x < x1 + yarn.REPEAT / 2)] = material
        assert 0.05 < (figure > 0).mean() < 0.3, motif
        for turned in (figure[:, ::-1], figure[::-1], figure.T):
            assert (figure != turned).mean() > 0.05, motif
        maps[motif] = figure
    assert all((a != b).mean() > 0.04 for k, a in enumerate(maps.values()) for b in list(maps.values())[:k])
    silks = [_materials(threads) for threads in COLOURS]
    assert all(silk["gold"] == silks[0]["gold"] for silk in silks)
    colours = [tuple(silk["red"]["base_color"]["value"]) for silk in silks]
    assert [int(np.argmax(colour)) for colour in colours] == [0, 2, 1]


def test_pictures_are_shared(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By scene and pose: another working folder has them without a path tracer, and another scene has not."""
    traced: list[VirtualFabric] = []

    def trace(fabric: VirtualFabric, light: np.ndarray) -> np.ndarray:
        traced.append(fabric)
        return np.full((16, 16, 3), light[0] + fabric.seed, np.float32)

    monkeypatch.setattr(VirtualFabric, "trace", trace)
    monkeypatch.setenv("KINRAN_CACHE", str(tmp_path))
    fabric = VirtualFabric(texels=16)
    pictures = [fabric.frame(30_000, phi, tmp_path / "mine") for phi in (0, 90_000, 0)]
    assert len(traced) == 2
    for phi, picture in zip((0, 90_000), pictures, strict=False):
        np.testing.assert_array_equal(fabric.frame(30_000, phi, tmp_path / "yours"), picture)
    assert len(traced) == 2
    for other in (VirtualFabric(texels=16, seed=8), VirtualFabric(texels=16, threads="moss")):
        other.frame(30_000, 0, tmp_path / "yours")
        assert traced[-1] == other
    monkeypatch.setattr("drjit.detail.llvm_version", lambda: (99, 0, 0))
    fabric.frame(30_000, 0, tmp_path / "elsewhere")
    assert traced[-1] == fabric
