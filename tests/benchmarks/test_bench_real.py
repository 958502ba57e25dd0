"""`kinran bench real`: on a set that is made here, and what it says of two of the real ones."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from benchmarks import real, real_sets
from benchmarks.texels import microfacets, texels
from kinran.__main__ import main
from kinran.base import frames

SIDE = 16


def lights_of_a_dome(count: int) -> np.ndarray:
    k = np.arange(count) + 0.5
    return frames.direction(np.arccos(1 - 0.75 * k / count), k * np.pi * (3 - 5**0.5))


@pytest.fixture(scope="module")
def made() -> real_sets.RealSet:
    """Gold over silk as microfacets, which no fit assumes, as 8-bit photographs; true normals of the silk."""
    directions = lights_of_a_dome(56)
    shapes, colours = texels(SIDE * SIDE)
    light = 0.25 * microfacets(shapes, colours, directions).reshape(SIDE, SIDE, 3, -1).transpose(3, 0, 1, 2)
    light = np.round(255 * np.clip(light, 0, 1) ** (1 / 2.2)) / 255
    saturated = light >= 1
    normals = np.concatenate([shapes[:, 5:], np.ones((len(shapes), 1))], 1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    held = real_sets.every_eighth(len(directions))
    picture = (light**2.2).astype(np.float32)
    return real_sets.RealSet(picture, saturated, directions, held, "gamma:2.2", normals.reshape(SIDE, SIDE, 3))


@pytest.fixture(scope="module")
def row(made: real_sets.RealSet) -> dict[str, Any]:
    return real.measure(made)


def test_a_set_is_measured_beside_its_peers(row: dict[str, Any]) -> None:
    """Every method by the same lights held out; the lobes are better than any that does not know of them."""
    assert (row["lights"], row["held_out"]) == (49, 7)
    methods = row["methods"]
    assert methods.keys() == {"lobes", "Kinran", "Lambert", *real.PEERS}
    best = max(methods[name]["psnr"] for name in real.COMPARED)
    assert row["above_the_best_peer"] == pytest.approx(methods["Kinran"]["psnr"] - best, abs=0.01)
    assert row["above_the_best_peer"] > 3
    assert row["normals"].keys() == {"Kinran", "least squares"}
    assert methods["HSH16"]["bytes"] == 96
    assert methods["Kinran"]["bytes"] < methods["Delaunay"]["bytes"]


def test_nothing_that_is_held_out_reaches_the_material(made: real_sets.RealSet, row: dict[str, Any]) -> None:
    """Held-out photographs of another cloth change what methods are judged by, and so each of their scores."""
    other = made.light.copy()
    other[made.held] = other[made.held][:, ::-1]
    changed = real.measure(replace(made, light=other))
    assert row["residual"] == changed["residual"]
    assert row["methods"]["Kinran"]["psnr"] > changed["methods"]["Kinran"]["psnr"] + 5


def test_folders_of_photographs(tmp_path: Path) -> None:
    """The middle of the photographs, row 0 at the bottom; of two folders the second is held out."""
    for folder, count in (("dome", 9), ("test", 3)):
        directions = lights_of_a_dome(count)
        (tmp_path / folder).mkdir()
        lines = [str(count)]
        for k, (x, y, z) in enumerate(directions):
            value = np.zeros((140, 134, 3), np.uint8)
            value[6 + 127, 3] = 20 * k
            Image.fromarray(value).save(tmp_path / folder / f"{k:02d}.png")
            lines.append(f"{k:02d}.png {x:.6f} {y:.6f} {z:.6f}")
        (tmp_path / folder / "dirs.lp").write_text("\n".join(lines) + "\n")
    one, two = real_sets.dome(tmp_path / "dome"), real_sets.dome(tmp_path / "dome", tmp_path / "test")
    assert one.light.shape == (9, 128, 128, 3)
    assert (np.diff(one.light[:, 0, 0, 0]) > 0).all()
    np.testing.assert_array_equal(np.flatnonzero(one.held), [4])
    np.testing.assert_array_equal(np.flatnonzero(two.held), [9, 10, 11])


def test_an_unknown_set_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "real", "--data", str(tmp_path), "--sets", "velvet", "--out", str(tmp_path / "out.json")])
    assert "velvet: is none of item3, item5" in capsys.readouterr().err


@pytest.mark.real
@pytest.mark.slow
def test_gold_leaf(real_data: Path) -> None:
    """RealRTI item 3, nine of 72 lights held out: 39.5 dB, and more than a dB above harmonics and components."""
    row = real.measure(real_sets.sets()["item3"](real_data))
    assert row["methods"]["Kinran"]["psnr"] >= 39.5
    assert row["above_the_best_peer"] > 1


@pytest.mark.real
@pytest.mark.slow
def test_ball(real_data: Path) -> None:
    """DiLiGenT: a row of lights held out between which highlights lie, and true normals."""
    row = real.measure(real_sets.sets()["ball"](real_data))
    assert row["above_the_best_peer"] > 1
    assert row["normals"]["Kinran"] <= 4.0
