"""Files of another kind are refused by a sentence that names the file and what to do."""

import json
from pathlib import Path

import numpy as np
import pytest
from cloth_on_disk import Cloth, directions, pictures
from synthetic_texels import grid, radiance, texels

LABELS = np.repeat([0, 1], 8).reshape(4, 4)


@pytest.fixture(scope="module")
def cloth(tmp_path_factory: pytest.TempPathFactory) -> Cloth:
    """Two regions with their priors, and runs and materials of two models."""
    lights = grid(40, 6)
    cloth = Cloth(
        tmp_path_factory.mktemp("cloth"), pictures(radiance(*texels(16), lights), (4, 4)), directions(lights), LABELS
    )
    cloth.fit(prior=True)
    assert cloth.run("fit", "takeda.npz", "--model", "takeda2008") == 0
    return cloth


def priors(cloth: Cloth) -> dict:
    return json.loads((cloth.folder / "prior.json").read_text())


def refused(cloth: Cloth, capsys: pytest.CaptureFixture[str], *words: object) -> str:
    """What a stage says; nothing is written."""
    out = cloth.folder / "refused"
    assert cloth.run(str(words[0]), out.name, *words[1:]) == 2
    assert not out.exists()
    said = capsys.readouterr().err
    assert said.startswith(f"kinran {words[0]}: ")
    assert said.count("\n") == 1
    return said


ANOTHER = {
    "choice.json": {"tail": "ggx", "lobes": 1, "fitted": [0]},
    "list.json": [],
    "number.json": 3,
    "empty.json": {},
    "trust.json": {"regions": [], "trust": {"lights": ["l0"], "outliers": False}},
}


@pytest.mark.parametrize("name", ANOTHER)
def test_what_holds_no_priors(cloth: Cloth, capsys: pytest.CaptureFixture[str], name: str) -> None:
    (cloth.folder / name).write_text(json.dumps(ANOTHER[name]))
    said = refused(cloth, capsys, "fit", "--prior", cloth.folder / name)
    assert f"{cloth.folder / name}: holds no priors" in said
    assert "make it with kinran prior" in said


def test_priors_of_other_lobes(cloth: Cloth, capsys: pytest.CaptureFixture[str]) -> None:
    said = refused(cloth, capsys, "fit", "--lobes", 2, "--prior", cloth.folder / "prior.json")
    assert "prior.json: is of another number of lobes than 2; make it again" in said


@pytest.mark.parametrize("stage", ["fit", "sigma", "residual"])
def test_priors_of_a_fabric_of_fewer_regions(cloth: Cloth, capsys: pytest.CaptureFixture[str], stage: str) -> None:
    found = priors(cloth)
    (cloth.folder / "one.json").write_text(json.dumps({**found, "regions": found["regions"][:1]}))
    made = ["--material", cloth.folder / "slope.exr", "--summary", cloth.folder / "refused.json"]
    rest = {"sigma": [*made, "--picture", cloth.folder / "refused.png"]}
    rest["residual"] = [*made, "--fitted", cloth.folder / "slope.json"]
    said = refused(cloth, capsys, stage, "--prior", cloth.folder / "one.json", *rest.get(stage, ()))
    assert "one.json: holds priors of 1 regions, and" in said
    assert "labels.exr has 2; make it again with kinran prior" in said


@pytest.mark.parametrize("stage", ["prior", "fit", "material"])
def test_what_holds_no_choice(cloth: Cloth, capsys: pytest.CaptureFixture[str], stage: str) -> None:
    given = ["--runs", cloth.folder / "run.npz", "--summary", cloth.folder / "refused.json"]
    rest = given if stage == "material" else []
    said = refused(cloth, capsys, stage, "--choice", cloth.folder / "prior.json", *rest)
    assert "prior.json: holds no choice" in said
    assert "make it with kinran choice" in said


@pytest.mark.parametrize(
    ("run", "options", "says"),
    [
        ("takeda.npz", (), "was fitted as takeda2008, not as slope: 1 ggx"),
        ("run.npz", ("--tail", "gaussian"), "was fitted as slope: 1 ggx, not as slope: 1 gaussian"),
        ("run.npz", ("--lobes", "2"), "was fitted as slope: 1 ggx, not as slope: 2 ggx"),
        ("prior.json", (), "is no fitted run; make it with kinran fit"),
        ("none.npz", (), "is no fitted run; make it with kinran fit"),
    ],
)
def test_runs_of_another_kind(
    cloth: Cloth, capsys: pytest.CaptureFixture[str], run: str, options: tuple[str, ...], says: str
) -> None:
    """A run of GGX lobes would be shown as one of Gaussians, and nothing would say so."""
    given = ["--runs", cloth.folder / run, "--summary", cloth.folder / "refused.json", *options]
    assert f"{run}: {says}" in refused(cloth, capsys, "material", *given)


@pytest.mark.parametrize("tile", ["2/2", "x", "1", "-1/2", "0/0", "1/2/3"])
def test_no_run_of_tiles(cloth: Cloth, capsys: pytest.CaptureFixture[str], tile: str) -> None:
    assert f"--tile {tile}: is no run of tiles" in refused(cloth, capsys, "fit", f"--tile={tile}")


def test_a_material_needs_all_runs(cloth: Cloth, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert cloth.run("fit", "none-of-two.npz", "--tile", "0/2") == 0
    given = ["--runs", cloth.folder / "none-of-two.npz", "--summary", tmp_path / "refused.json"]
    assert "16 texels have no fit; give all runs" in refused(cloth, capsys, "material", *given)
