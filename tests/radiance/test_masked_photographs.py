"""Photographs with a mask: what is outside it decides nothing, from the stack to the errors."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from stages import make_stack

from kinran.base.exr import read_exr
from kinran.base.files import InputError, read_json
from kinran.capture import ingest, ingest_group
from kinran.data.block_average import average
from kinran.data.mask import find_mask, read_mask
from kinran.data.photographs import Crop
from kinran.data.radiance import HOT, OUTSIDE, Radiance
from kinran.data.radiance_stack import Stack
from kinran.fit import fit, material
from kinran.judge import evaluate, relight
from kinran.segment import segment

WIDTH, HEIGHT, LIGHTS = 56, 48, 12
Y, X = np.mgrid[:HEIGHT, :WIDTH] + 0.5
DISC = np.hypot(X - 30, Y - 22) < 18


def photographs(folder: Path, around: float) -> Path:
    """A matt cloth of two colours in a disc, in linear light, and a table around it that is brighter or darker."""
    folder.mkdir()
    rng = np.random.default_rng(1)
    cloth = np.where((X < 30)[..., None], [0.5, 0.1, 0.1], [0.1, 0.1, 0.5]) * rng.uniform(0.9, 1.1, (HEIGHT, WIDTH, 1))
    cloth[~DISC] = around
    rows = [str(LIGHTS)]
    for k in range(LIGHTS):
        theta, phi = 0.2 + 0.07 * k, 2.4 * k
        light = np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
        Image.fromarray((255 * cloth * light[2]).astype(np.uint8)).save(folder / f"p{k}.png")
        rows.append(f"p{k}.png {' '.join(f'{part:.9f}' for part in light)}")
    (folder / "lights.lp").write_text("\n".join(rows), encoding="utf-8")
    Image.fromarray((255 * DISC).astype(np.uint8)).save(folder / "mask.png")
    return folder


def results(folder: Path, work: Path) -> dict[str, Any]:
    """Everything that stages make of a set, and its stack."""
    plan, manifest, fabric = work / "captures/set/plan.json", work / "captures/set/groups/00.json", work / "set"
    ingest.main(ingest.Inputs(folder), plan, ingest.Options(encoding="linear", fabric="set", holdout=4))
    ingest_group.main(ingest_group.Inputs(folder, plan), manifest, ingest_group.Options(group="00"))
    stack = make_stack(work, plan, manifest)
    fabric.mkdir()
    (fabric / "radiance.zarr").symlink_to(stack.path)
    segment.main(fabric, segment.Options(count=2))
    run, made = fabric / "run.npz", fabric / "slope.exr"
    fit.main(fit.Inputs(fabric), run, fit.Options(model="slope"))
    outputs = material.Outputs(made, made.with_suffix(".json"))
    material.main(material.Inputs(fabric, (run,)), outputs, material.Options(model="slope"))
    judged = evaluate.Outputs(fabric / "errors.json", fabric / "errors.png")
    evaluate.main(evaluate.Inputs(fabric, (made,)), judged, evaluate.Options(name="set"))
    errors = read_json(judged.errors)["methods"]["slope"]
    costs = ("fit", "relight_cpu_seconds")
    return {
        "folder": folder,
        "stack": stack,
        "regions": read_json(fabric / "regions.json"),
        "maps": read_exr(made),
        "summary": read_json(outputs.summary),
        "errors": {key: value for key, value in errors.items() if key not in costs},
    }


@pytest.fixture(scope="module")
def dark(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    work = tmp_path_factory.mktemp("dark")
    return results(photographs(work / "photographs", 0.02), work)


def test_the_stack_has_no_samples_outside(dark: dict[str, Any]) -> None:
    stack: Stack = dark["stack"]
    seen = stack.read_tile(0, HEIGHT, 0, WIDTH)
    np.testing.assert_array_equal(stack.inside, DISC[::-1])
    assert (seen.flags[:, ~stack.inside] == (HOT | OUTSIDE)).all()
    assert not seen.flags[:, stack.inside].any()
    assert not seen.value[:, ~stack.inside].any()


def test_regions_and_material_are_of_the_inside(dark: dict[str, Any]) -> None:
    inside = DISC[::-1]
    assert [region["name"] for region in dark["regions"]] in (["red", "blue"], ["blue", "red"])
    assert sum(region["texels"] for region in dark["regions"]) == inside.sum()
    assert (dark["maps"]["label"][~inside] == -1).all()
    assert (dark["maps"]["label"][inside] >= 0).all()
    for name, plane in dark["maps"].items():
        assert name in ("label", "bound") or not plane[~inside].any()
    assert dark["maps"]["diffuse.amplitude"][inside].min() > 0
    assert (dark["summary"]["outside_texels"], dark["summary"]["filled_texels"]) == ((~inside).sum(), 0)


def test_what_is_outside_decides_nothing(dark: dict[str, Any], tmp_path: Path) -> None:
    """A white table around the cloth gives the same regions, maps and errors, to the bit."""
    white = results(photographs(tmp_path / "photographs", 0.95), tmp_path)
    assert white["regions"] == dark["regions"]
    assert white["errors"] == dark["errors"]
    assert dark["errors"]["texel_median"] > 0  # most texels are outside, where the error is 0
    for name, plane in dark["maps"].items():
        np.testing.assert_array_equal(white["maps"][name], plane)


def test_a_mask_that_changed_is_refused(tmp_path: Path) -> None:
    folder, plan = photographs(tmp_path / "photographs", 0.5), tmp_path / "captures/set/plan.json"
    manifest = tmp_path / "captures/set/groups/00.json"
    ingest.main(ingest.Inputs(folder), plan, ingest.Options(encoding="linear", fabric="set", holdout=4))
    ingest_group.main(ingest_group.Inputs(folder, plan), manifest, ingest_group.Options(group="00"))
    Image.fromarray((255 * (X > 9)).astype(np.uint8)).save(folder / "mask.png")
    with pytest.raises(InputError, match="the mask is not the one that was ingested"):
        make_stack(tmp_path, plan, manifest)


def test_names_sizes_and_crops_of_masks(tmp_path: Path) -> None:
    """`buddha.mask.png` is one, and `mask.png` the one among several; it must have the photographs' size."""
    for name in ("buddha.mask.png", "hair.mask.png", "noh_mask.png"):
        Image.fromarray((255 * DISC).astype(np.uint8)).save(tmp_path / name)
    with pytest.raises(InputError, match=r"has buddha.mask.png and hair.mask.png; give the right one by --mask"):
        find_mask(tmp_path)
    (tmp_path / "hair.mask.png").rename(tmp_path / "Mask.PNG")
    assert find_mask(tmp_path) == tmp_path / "Mask.PNG"
    (tmp_path / "Mask.PNG").unlink()
    assert find_mask(tmp_path) == tmp_path / "buddha.mask.png"
    assert find_mask(tmp_path / "none") is None

    mask = tmp_path / "buddha.mask.png"
    np.testing.assert_array_equal(read_mask(mask, (WIDTH, HEIGHT), Crop(20, 10, 9, 7)), DISC[10:17, 20:29][::-1])
    with pytest.raises(InputError, match="the mask is 56x48 but the photographs are 48x56"):
        read_mask(mask, (HEIGHT, WIDTH))
    with pytest.raises(InputError, match="leaves no texel"):
        read_mask(mask, (WIDTH, HEIGHT), Crop(0, 0, 5, 5))


def test_relighting_is_compared_inside(
    dark: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A table that no material explains does not count; it would cost 30 dB."""
    work = dark["folder"].parent
    found = relight.Inputs(work / "set/slope.exr", dark["folder"] / "lights.lp", dark["folder"])
    bare = photographs(tmp_path / "white", 0.95)
    relight.main(found, tmp_path / "a")
    relight.main(replace(found, against=bare), tmp_path / "b")
    means = [line.split()[1] for line in capsys.readouterr().out.splitlines() if line.startswith("mean")]
    assert means[0] == means[1]
    assert float(means[0]) > 30


def test_blocks_of_texels_at_the_edge_of_a_mask() -> None:
    """The mean of a block is that of its texels inside; it is outside where all are."""
    value = np.arange(8, dtype=np.float32).reshape(1, 2, 4, 1).repeat(3, 3)
    inside = np.array([[True, True, False, False], [True, False, False, False]])
    coarse = average(Radiance.unflagged(value)[0].only(inside)[None], 2)
    np.testing.assert_allclose(coarse.value[0, 0, :, 0], [(0 + 1 + 4) / 3, 0])
    np.testing.assert_array_equal(coarse.flags[0, 0, :, 0], [0, HOT | OUTSIDE])
