"""Photographs of more megapixels than are wanted: averaged in linear light, with texels of the same place and size."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from stages import make_stack

from kinran.base.encoding import parse
from kinran.base.files import InputError, read_json, write_json
from kinran.capture import ingest, ingest_group
from kinran.data.radiance import Radiance
from kinran.judge import relight

HEIGHT, WIDTH = 31, 44
CODES = np.random.default_rng(0).integers(5, 250, (4, HEIGHT, WIDTH, 3)).astype(np.uint8)


def stack_of(tmp_path: Path, options: ingest.Options):  # type: ignore[no-untyped-def]
    folder, work = tmp_path / "photographs", tmp_path / "work"
    plan, manifest = work / "captures/set/plan.json", work / "captures/set/groups/00.json"
    folder.mkdir(exist_ok=True)
    for k, codes in enumerate(CODES):
        Image.fromarray(codes).save(folder / f"p{k}.png")
    (folder / "a.lp").write_text("4\np0.png 0 0 1\np1.png 0.6 0 0.8\np2.png 0 0.6 0.8\np3.png -0.6 0 0.8\n")
    ingest.main(ingest.Inputs(folder), plan, options)
    ingest_group.main(ingest_group.Inputs(folder, plan), manifest, ingest_group.Options(group="00"))
    return plan, make_stack(work, plan, manifest, holdout=0)


def test_texels_are_means_of_light(tmp_path: Path) -> None:
    """3 × 3 pixels make a texel; what is over at the top and at the right is left out, as row 0 is at the bottom."""
    _, stack = stack_of(tmp_path, ingest.Options(fabric="set", max_mp=WIDTH * HEIGHT * 1e-6 / 4.1))
    assert (stack.height, stack.width) == (HEIGHT // 3, WIDTH // 3)
    light = parse("srgb").decode(CODES.astype(np.float32) / 255)[:, ::-1]
    seen = stack.read_tile(0, stack.height, 0, stack.width).value
    for y, x in ((0, 0), (9, 13), (4, 7)):
        block = light[:, 3 * y : 3 * y + 3, 3 * x : 3 * x + 3]
        np.testing.assert_allclose(seen[:, y, x], block.mean((1, 2)), rtol=2e-3)


def test_distances_stay(tmp_path: Path) -> None:
    options = ingest.Options(fabric="set", max_mp=1e-3, lamp_mm=300, field_mm=88)
    _, stack = stack_of(tmp_path, options)
    assert stack.texel_mm == pytest.approx(2 * 88 / WIDTH)


def test_enough_megapixels_change_nothing(tmp_path: Path) -> None:
    plan, stack = stack_of(tmp_path, ingest.Options(fabric="set", max_mp=1))
    assert (stack.height, stack.width) == (HEIGHT, WIDTH)
    value = read_json(plan)
    assert "average" not in value  # as of plans that were made before
    write_json(plan, value)


def test_less_than_a_texel_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"--max-mp 1e-07: leaves no texel of 44x31 pixels"):
        stack_of(tmp_path, ingest.Options(fabric="set", max_mp=1e-7))


def test_a_relit_picture_is_compared_with_averages() -> None:
    """Those that its material was made from; of a material of all pixels, with the photograph itself."""
    light = np.random.default_rng(1).random((HEIGHT, WIDTH, 3)).astype(np.float32)
    averaged = relight._made_from(Radiance.unflagged(light), (HEIGHT // 3, WIDTH // 3, 3))
    assert averaged.shape == (HEIGHT // 3, WIDTH // 3, 3)
    np.testing.assert_allclose(averaged[2, 5], light[6:9, 15:18].mean((0, 1)), rtol=1e-5)
    np.testing.assert_array_equal(relight._made_from(Radiance.unflagged(light), light.shape), light)


@pytest.mark.parametrize("max_mp", [0.0, -3.0, float("nan")])
def test_no_megapixels_at_all_are_refused(tmp_path: Path, max_mp: float) -> None:
    with pytest.raises(InputError, match=r"--max-mp .*: is no number of megapixels"):
        stack_of(tmp_path, ingest.Options(fabric="set", max_mp=max_mp))
