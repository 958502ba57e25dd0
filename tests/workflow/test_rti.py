"""A folder of photographs, from `kinran rti` to `kinran relight`, as a user runs it."""

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT, small_template
from PIL import Image

from kinran.base import frames
from kinran.base.encoding import parse
from kinran.base.exr import read_exr
from kinran.base.files import InputError
from kinran.data.light import LpLight
from kinran.data.light_files import write_lp
from kinran.run.rti import Inputs, Options, prepare

SIDE, LIGHTS = 28, 24


def run(*arguments: str) -> str:
    done = subprocess.run([sys.executable, "-m", *arguments], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-6000:]
    return done.stdout + done.stderr


def pipeline(folder: Path, out: Path, crop: str, holdout: int, *options: str) -> str:
    """What `kinran rti` does, with a picture small enough for a test."""
    work = prepare(Inputs(folder), out, Options(crop=crop, holdout=holdout))
    (work / "small.xml").write_text(small_template())
    config = (work / "config.yaml").read_text()
    (work / "config.yaml").write_text(config.replace(str(ROOT / "scenes" / "drape.xml"), "small.xml"))
    return run("snakemake", "-s", str(ROOT / "Snakefile"), "-d", str(work), "-c2", *options)


def bowl(light: np.ndarray) -> np.ndarray:
    """A rough bowl, two colours wide, in sRGB: Oren-Nayar-like shading by hand, top row first."""
    y, x = np.mgrid[1 : -1 : SIDE * 1j, -1 : 1 : SIDE * 1j]
    normal = np.stack([-0.4 * x, -0.4 * y, np.ones_like(x)], -1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    cosine = np.clip(normal @ light, 0, 1)
    half = light + np.array([0.0, 0, 1])
    half /= np.linalg.norm(half)
    gloss = np.clip(normal @ half, 0, 1) ** 40
    colour = np.where((x < 0)[..., None], [0.5, 0.1, 0.08], [0.1, 0.2, 0.4])
    value = colour * cosine[..., None] ** 0.8 + 0.25 * (gloss * cosine)[..., None]
    return np.round(parse("srgb").encode(value) * 255).astype(np.uint8)


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("photographs") / "My Set"
    folder.mkdir()
    k = np.arange(LIGHTS) + 0.5
    directions = frames.direction(np.arccos(1 - 0.6 * k / LIGHTS), k * np.pi * (3 - 5**0.5))
    lights = [LpLight(f"IMG {i:02d}", tuple(d), f"IMG {i:02d}.png") for i, d in enumerate(directions)]
    for light in lights:
        Image.fromarray(bowl(np.array(light.direction))).save(folder / light.file)
    write_lp(folder / "lights.lp", lights)
    out = tmp_path_factory.mktemp("results") / "Out.1"
    pipeline(folder, out, "", 8)
    return out


def photographs(out: Path) -> Path:
    manifest = json.loads(next((out / ".kinran" / "captures").rglob("00.json")).read_text())
    return Path(manifest["shots"][0]["frames"][0]["file"]).parent


def test_contracts(out: Path) -> None:
    for name in ("material.exr", "evaluation.json", "report.html", "render.png"):
        assert (out / name).stat().st_size > 0
    errors = json.loads((out / "evaluation.json").read_text())
    assert errors["held_out"] == ["IMG 04", "IMG 12", "IMG 20"]
    assert errors["methods"][errors["default"]]["psnr"] > 30
    assert set(errors["methods"]["slope"]["lights"]) == set(errors["held_out"])


def test_relight_is_upright_and_says_what_the_evaluation_says(out: Path, tmp_path: Path) -> None:
    folder = photographs(out)
    errors = json.loads((out / "evaluation.json").read_text())
    lights = ["--lights", str(folder / "lights.lp"), "--against", str(folder)]
    text = run("kinran", "relight", str(out / "material.exr"), "--out", str(tmp_path / "relit"), *lights)
    *lines, unseen, fitted = (line.split("  ") for line in text.splitlines())
    scores = {name: float(score.split()[0]) for name, score, *_ in lines}
    assert len(scores) == LIGHTS
    assert [name for name, _, *marks in lines if marks == ["held out"]] == errors["held_out"]
    for said, chosen in ((unseen, errors["held_out"]), (fitted, scores.keys() - set(errors["held_out"]))):
        assert float(said[1].split()[0]) == pytest.approx(np.mean([scores[name] for name in chosen]), abs=0.02)
    for name in errors["held_out"]:
        assert scores[name] == pytest.approx(errors["methods"][errors["default"]]["lights"][name]["psnr"], abs=0.02)
    channels = read_exr(tmp_path / "relit" / "IMG 04.exr")
    assert set(channels) == {"R", "G", "B"}
    image = np.stack([channels[c] for c in "RGB"], -1)
    truth = parse("srgb").decode(np.asarray(Image.open(folder / "IMG 04.png")) / 255)
    assert np.abs(image - truth).mean() < 0.03
    assert np.abs(image[::-1] - truth).mean() > 2 * np.abs(image - truth).mean()


def test_the_page_of_python_makes_the_same_material(
    out: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The program of docs/python.md, word for word: the maps of the workflow's one GGX lobe, and their errors."""
    (program,) = re.findall(
        r"^```python\n(.*?)^```", (ROOT / "docs" / "python.md").read_text(), re.MULTILINE | re.DOTALL
    )
    monkeypatch.chdir(tmp_path)
    Path("photographs").symlink_to(photographs(out), target_is_directory=True)
    exec(compile(program, "docs/python.md", "exec"), {})
    assert (tmp_path / "out" / "slope.exr").read_bytes() == (out / "fit" / "slope.exr").read_bytes()
    said, same = (json.loads((folder / "evaluation.json").read_text()) for folder in (tmp_path / "out", out))
    errors, expected = (each["methods"]["slope"] for each in (said, same))
    assert all(errors[key] == expected[key] for key in ("relative_error", "psnr", "regions", "lights"))
    assert len(list((tmp_path / "out" / "relit").glob("*.exr"))) == LIGHTS
    assert capsys.readouterr().out == f"{LIGHTS} pictures in out/relit\n"


def test_a_finished_set_whose_folder_is_gone_stays_finished(out: Path) -> None:
    """The workflow has nothing to do; `kinran rti`, which is asked for this folder alone, refuses it."""
    folder = photographs(out)
    away = folder.rename(folder.with_name("unmounted"))
    try:
        said = run("snakemake", "-s", str(ROOT / "Snakefile"), "-d", str(out / ".kinran"), "-c2", "--dry-run")
        with pytest.raises(InputError, match="no such folder"):
            prepare(Inputs(folder), out, Options(holdout=8))
    finally:
        away.rename(folder)
    assert "Nothing to be done" in said
    assert "left out" not in said


def test_again_does_nothing_and_another_crop_starts_over(out: Path) -> None:
    folder = photographs(out)
    assert "Nothing to be done" in pipeline(folder, out, "", 8, "--dry-run")
    planned = pipeline(folder, out, "2,3,20,18", 0, "--dry-run", "--printshellcmds")
    assert "--crop=2,3,20,18 --holdout 0" in planned
    assert all(f"rule {name}:" in planned for name in ("ingest", "merge", "segment", "fit", "evaluate", "report"))


@pytest.mark.real
@pytest.mark.campaign
def test_gold_leaf_icon(real_data: Path, tmp_path: Path) -> None:
    """RealRTI item 3, the 128² centre: a lobe model on lights that it has not seen, against simple baselines."""
    out = tmp_path / "icon"
    pipeline(real_data / "realrti" / "item3", out, "137,133,128,128", 8, "results/icon/evaluation.json")
    errors = json.loads((out / "evaluation.json").read_text())
    methods, baselines = errors["methods"], errors["beside"]["baselines"]
    assert methods["slope"]["psnr"] > 33
    assert methods["slope-residual"]["psnr"] > 38.5
    assert methods["takeda2008"]["psnr"] < 29
    assert 27 < max(baseline["psnr"] for baseline in baselines.values()) < 33
