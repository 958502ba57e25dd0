"""The config and its sheets: what is wrong with them, in one sentence each."""

import copy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from kinran.code import ROOT
from kinran.config import lobes_of, read_fabrics, read_revisions
from kinran.files import InputError

SHIPPED = yaml.safe_load((ROOT / "config.yaml").read_text())
FABRICS = "fabric\tsource\tencoding\tcrop\tregions\tseeds"
RECAPTURE = "fabric\ttheta\tphi\trevision\treason"


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "config").mkdir()
    sheet(tmp_path, "fabrics", FABRICS, "tiny\trig\t\t\t2\t")
    sheet(tmp_path, "recapture", RECAPTURE)
    return tmp_path


def sheet(folder: Path, name: str, *rows: str) -> None:
    (folder / "config" / f"{name}.tsv").write_text("\n".join(rows) + "\n")


def read(config: dict[str, Any]) -> Callable[[str, str], str]:
    return read_revisions(config, read_fabrics(config))


def test_the_shipped_config_is_good() -> None:
    """With the shipped sheet; what it leaves out has a default."""
    config = {**copy.deepcopy(SHIPPED), "fabrics": str(ROOT / SHIPPED["fabrics"])}
    del config["fit"]["jobs"], config["holdout"]
    fabrics = read_fabrics(config)
    assert config["fit"]["jobs"] == 2
    assert config["holdout"] == 8
    assert fabrics["brocade"].light_groups == ("00", "01", "02", "03", "04", "05")


@pytest.mark.usefixtures("project")
@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda c: c.update(fitt=1), "'fitt' was unexpected"),
        (lambda c: c["fit"].update(modell="slope"), "fit: .*'modell' was unexpected"),
        (lambda c: c["rig"].update(device="lamp"), "'lamp' is not one of"),
        (lambda c: c.update(holdout=1), "holdout"),
        (lambda c: c.update(holdout=-8), "holdout"),
        (lambda c: c["rig"].update(thetas=[10, 20]), "rig.thetas"),
        (lambda c: c["rig"].update(thetas=[0, 95]), "rig.thetas"),
        (lambda c: c["rig"].update(thetas=[0, 20, 40], meridians=3), "put a multiple of 4 meridians in a group"),
        (lambda c: c.update(fabrics="none.tsv"), "none.tsv: cannot be read"),
        (lambda c: c["virtual"].update(texels=4), "virtual.texels"),
    ],
)
def test_bad_configs(change: Callable[[dict[str, Any]], object], says: str) -> None:
    config = copy.deepcopy(SHIPPED)
    change(config)
    with pytest.raises(InputError, match=says) as error:
        read(config)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("name", "row", "says"),
    [
        ("fabrics", "../up\trig\t\t\t\t", "does not match"),
        ("fabrics", "<b>\trig\t\t\t\t", "does not match"),
        ("fabrics", "a;b\trig\t\t\t\t", "does not match"),
        ("fabrics", "tiny\trig\t\t\t0\t", "does not match"),
        ("fabrics", "tiny\trig\t\t\t2\tgold:1", "does not match"),
        ("fabrics", "tiny\tnowhere\t\t\t\t", "nowhere: no such folder"),
        ("fabrics", "tiny\trig", "another number of cells"),
        ("fabrics", "tiny\trig\t\t\t\t\ntiny\trig\t\t\t\t", "'tiny' stands twice"),
        ("fabrics", "", "has no fabric"),
        ("recapture", "tiny\t40\t44\t1\tx", "is no direction of the grid"),
        ("recapture", "other\t40\t45\t1\tx", "'other' is no fabric on the rig"),
        ("recapture", "tiny\t40\t45\t0\tx", "does not match"),
        ("recapture", "tiny\t40\t45\t1\t", "is too short|should be non-empty"),
    ],
)
def test_bad_rows(project: Path, name: str, row: str, says: str) -> None:
    sheet(project, name, {"fabrics": FABRICS, "recapture": RECAPTURE}[name], row)
    with pytest.raises(InputError, match=says) as error:
        read(copy.deepcopy(SHIPPED))
    assert "\n" not in str(error.value)


def test_revisions_of_a_group(project: Path) -> None:
    """The latest revision counts, and the text does not depend on the order of the rows."""
    rows = ["tiny\t40\t45\t1\tx", "tiny\t5\t0\t1\ty", "tiny\t40\t45\t3\tz"]
    sheet(project, "recapture", RECAPTURE, *rows)
    first = read(copy.deepcopy(SHIPPED))
    sheet(project, "recapture", RECAPTURE, *reversed(rows))
    second = read(copy.deepcopy(SHIPPED))
    assert first("tiny", "00") == second("tiny", "00") == '{"t05_p000": 1, "t40_p045": 3}'
    assert first("tiny", "01") == "{}"


def test_a_monitor_can_be_shot_again(project: Path) -> None:
    sheet(project, "recapture", RECAPTURE, "tiny\t0\t60\t1\tlamp")
    assert read(copy.deepcopy(SHIPPED))("tiny", "01") == '{"monitor_5": 1}'


def test_one_lobe_where_lights_are_few(project: Path) -> None:
    config = copy.deepcopy(SHIPPED)
    assert lobes_of(config, read_fabrics(config)["tiny"]) == (2, "gaussian")
    config["rig"].update(thetas=[0, 20, 40, 60, 80], phis=8)
    assert lobes_of(config, read_fabrics(config)["tiny"]) == (1, "ggx")
