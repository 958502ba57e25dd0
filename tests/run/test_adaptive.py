"""Rounds of the adaptive plan, with the workflow and `kinran propose` played by the test."""

import copy
import fcntl
import json
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from kinran.base.files import InputError
from kinran.base.project import ROOT
from kinran.run import adaptive
from kinran.run.fabrics import read_fabrics

SHIPPED = yaml.safe_load((ROOT / "config.yaml").read_text())
ROWS = ["theta\tphi\tgroup", *(f"{10 + k}\t{10 * k}\t{k // 8}" for k in range(32))]


def configured(folder: Path, change: Callable[[dict[str, Any]], object] = lambda _: None) -> adaptive.Options:
    """A working folder with one fabric on the rig and one of photographs."""
    config = copy.deepcopy(SHIPPED)
    config["rig"]["plan"] = "adaptive"
    change(config)
    (folder / "config").mkdir()
    (folder / "scenes").mkdir()
    (folder / "scenes" / "drape.xml").touch()
    (folder / "config.yaml").write_text(yaml.safe_dump(config))
    (folder / "config" / "fabrics.tsv").write_text(
        "fabric\tsource\tencoding\tcrop\tregions\tseeds\ntiny\trig\t\t\t2\t\n"
    )
    (folder / "config" / "recapture.tsv").write_text("fabric\ttheta\tphi\trevision\treason\n")
    return adaptive.Options(folder, 1)


class Played:
    """`kinran propose` and the workflow, noted: proposals take 8 rows to 16, 24 and 32, the workflow does nothing."""

    def __init__(self, fails: Callable[[str], int] = lambda _: 0) -> None:
        self.said: list[str] = []
        self.fails = fails

    def __call__(self, command: list[str], **options: Any) -> "subprocess.CompletedProcess[str]":
        said = "propose" if "propose" in command else "workflow"
        self.said.append(said)
        if said == "propose":
            sheet = Path(command[-1])
            sheet.parent.mkdir(parents=True, exist_ok=True)
            rows = len(sheet.read_text().splitlines()) - 1 if sheet.exists() else 8
            if rows < 32:
                sheet.write_text("\n".join(ROWS[: rows + 9]) + "\n")
            sheet.with_suffix(".json").write_text(json.dumps([{"directions": rows, "error": 0.08}]))
        return subprocess.CompletedProcess(command, self.fails(said))

    def instead(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Play them for the test."""
        monkeypatch.setattr(subprocess, "run", self)
        monkeypatch.setattr(adaptive, "run_snakemake", lambda options, files: self(list(options)).returncode)


def test_rounds_until_there_is_no_further_group(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    played = Played()
    played.instead(monkeypatch)
    adaptive.main(configured(tmp_path))
    assert played.said == ["propose", *["workflow", "propose"] * 3]
    assert "tiny: 32 directions, error 0.080 (wanted: 0.1); 353 fewer than the grid" in capsys.readouterr().out


def test_a_killed_run_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The first dies in its workflow; the second begins no sheet."""

    def killed(said: str) -> int:
        if said == "workflow":
            raise KeyboardInterrupt
        return 0

    Played(killed).instead(monkeypatch)
    options = configured(tmp_path)
    with pytest.raises(KeyboardInterrupt):
        adaptive.main(options)
    again = Played()
    again.instead(monkeypatch)
    adaptive.main(options)
    assert again.said == ["workflow", "propose"] * 3


@pytest.mark.parametrize(
    ("part", "says"), [("workflow", "tiny: the run did not finish"), ("propose", "no further group")]
)
def test_a_step_that_fails_stops_the_rounds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, part: str, says: str
) -> None:
    Played(lambda said: said == part).instead(monkeypatch)
    with pytest.raises(InputError, match=says):
        adaptive.main(configured(tmp_path))


def test_one_at_a_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    played = Played()
    played.instead(monkeypatch)
    options = configured(tmp_path)
    (tmp_path / ".snakemake").mkdir()
    with (tmp_path / adaptive.LOCK).open("w") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        with pytest.raises(InputError, match="another kinran adaptive is at work here"):
            adaptive.main(options)
    assert not played.said


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda c: c["rig"].update(plan="grid"), "rig.plan is grid; set it to adaptive"),
        (lambda c: c["fit"].update(model="lambert"), "set both"),
        (lambda c: c.update(holdout=0), "set both"),
        (lambda c: c["rig"].update(most=8), "rig.most"),
        (lambda c: c["rig"].update(error=0), "rig.error"),
    ],
)
def test_a_config_for_something_else(tmp_path: Path, change: Callable[[dict[str, Any]], object], says: str) -> None:
    with pytest.raises(InputError, match=says):
        adaptive.main(configured(tmp_path, change))


def test_only_fabrics_with_an_adaptive_plan_of_their_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The others are left alone; a broken row is said at the end, when the rounds are done."""
    played = Played()
    played.instead(monkeypatch)
    options = configured(tmp_path, lambda c: c["rig"].update(plan="grid"))
    rows = "fabric\tsource\tencoding\tcrop\tregions\tseeds\ntiny\trig\t\t\t2\t\nother\trig\t\t\t2\t\nbad\trig\n"
    (tmp_path / "config" / "fabrics.tsv").write_text(rows)
    (tmp_path / "config" / "fabrics").mkdir()
    (tmp_path / "config" / "fabrics" / "other.yaml").write_text("rig: {plan: adaptive, error: 0.2}")
    with pytest.raises(InputError, match="line 4 has another number of cells"):
        adaptive.main(options)
    assert played.said == ["propose", *["workflow", "propose"] * 3]
    assert "other: 32 directions, error 0.080 (wanted: 0.2)" in capsys.readouterr().out
    assert not (tmp_path / "captures" / "tiny").exists()


def test_a_sheet_that_is_not_begun(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    configured(tmp_path)
    monkeypatch.chdir(tmp_path)
    (says,) = read_fabrics(yaml.safe_load(Path("config.yaml").read_text())).broken.values()
    assert "tiny/directions.tsv: is not there yet; kinran adaptive begins it" in says
