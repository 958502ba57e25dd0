"""The config and its sheets: what is wrong with them, in one sentence each."""

import copy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from kinran.base.files import InputError
from kinran.base.project import ROOT
from kinran.run.config import SCHEMAS, directions_options, lobes_of, motion_options, read_fabrics, read_revisions

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
        (lambda c: c["rig"].update(camera_mm=0), "rig.camera_mm"),
        (lambda c: c["rig"].update(backlash=-1), "rig.backlash"),
        (lambda c: c["rig"].update(chart_corners="1,2,3"), "rig.chart_corners"),
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


def listed(project: Path, *rows: str) -> dict[str, Any]:
    """The shipped config with a sheet of directions in the place of its grid."""
    (project / "directions.csv").write_text("\n".join(["theta,phi", *rows]) + "\n")
    config = copy.deepcopy(SHIPPED)
    config["rig"]["plan"] = "directions.csv"
    del config["rig"]["thetas"], config["rig"]["phis"]
    return config


def test_a_sheet_of_directions(project: Path) -> None:
    """Its groups are those of the fabric, and its directions can be shot again."""
    config = listed(project, *(f"{5 + k},{3 * k}" for k in range(70)))
    tiny = read_fabrics(config)["tiny"]
    assert (tiny.light_groups, tiny.all_groups, tiny.lights) == (("00", "01"), ("00", "01", "calibration"), 71)
    assert directions_options(config["rig"], "tiny") == "--directions directions.csv"
    sheet(project, "recapture", RECAPTURE, "tiny\t5\t0\t1\tx", "tiny\t74\t207\t2\ty", "tiny\t0\t0\t1\tz")
    revisions = read(config)
    assert (
        revisions("tiny", "00")
        == '{"monitor_00_1": 1, "monitor_00_2": 1, "monitor_00_3": 1, "monitor_00_4": 1, "t05_p000": 1}'
    )
    assert revisions("tiny", "01") == '{"monitor_01_1": 1, "monitor_01_2": 1, "t74_p207": 2}'
    sheet(project, "recapture", RECAPTURE, "tiny\t5\t1\t1\tx")
    with pytest.raises(InputError, match=r"θ = 5, φ = 1 is no direction of directions\.csv"):
        read(config)


def test_a_sheet_that_cannot_be(project: Path) -> None:
    with pytest.raises(InputError, match=r"directions\.csv: line 3: theta .x. is no number"):
        read_fabrics(listed(project, "5,0", "x,0"))
    config = copy.deepcopy(SHIPPED)
    config["rig"]["plan"] = "none.tsv"
    with pytest.raises(InputError, match=r"none\.tsv: cannot be read"):
        read_fabrics(config)


@pytest.mark.usefixtures("project")
def test_a_grid_needs_its_angles() -> None:
    config = copy.deepcopy(SHIPPED)
    del config["rig"]["phis"]
    with pytest.raises(InputError, match="rig: 'phis' is a required property"):
        read_fabrics(config)


@pytest.mark.usefixtures("project")
def test_motion_of_the_rig() -> None:
    """What the config leaves out is left to the command."""
    config = copy.deepcopy(SHIPPED)
    read_fabrics(config)
    assert motion_options(config["rig"]) == ""
    assert directions_options(config["rig"], "tiny").endswith("--phis 24 --meridians 4")
    rig = {**config["rig"], "backlash": 0.5, "speeds": [5, 15, 5, 15], "photodiode": False}
    assert motion_options(rig) == "--backlash 0.5 --speeds 5,15,5,15 --no-photodiode"


def test_one_lobe_where_lights_are_few(project: Path) -> None:
    config = copy.deepcopy(SHIPPED)
    assert lobes_of(config, read_fabrics(config)["tiny"]) == (2, "gaussian")
    config["rig"].update(thetas=[0, 20, 40, 60, 80], phis=8)
    assert lobes_of(config, read_fabrics(config)["tiny"]) == (1, "ggx")


def test_distances_of_a_set(project: Path) -> None:
    """Columns that a sheet may have; on the rig, the config has them."""
    (project / "set").mkdir()
    (project / "set" / "a.lp").write_text("1\na.png 0 0 1\n")
    columns = f"{FABRICS}\tlamp_mm\tfield_mm\tcamera_mm"
    sheet(project, "fabrics", columns, "dome\tset\t\t\t\t\t300\t60.5\t", "tiny\trig\t\t\t2\t\t\t\t")
    fabrics = read_fabrics(copy.deepcopy(SHIPPED))
    assert fabrics["dome"].distance_options == "--lamp-mm 300 --field-mm 60.5"
    assert fabrics["tiny"].distance_options == ""
    sheet(project, "fabrics", columns, "tiny\trig\t\t\t2\t\t\t60\t")
    with pytest.raises(InputError, match="'tiny' lies on the rig, whose distances and chart"):
        read_fabrics(copy.deepcopy(SHIPPED))
    sheet(project, "fabrics", columns, "dome\tset\t\t\t\t\t-3\t\t")
    with pytest.raises(InputError, match="lamp_mm: '-3' does not match"):
        read_fabrics(copy.deepcopy(SHIPPED))


def test_the_chart_of_a_set(project: Path) -> None:
    """Its photograph lies beside the others; on the rig, the config says what is known of it."""
    (project / "set").mkdir()
    (project / "set" / "a.lp").write_text("1\na.png 0 0 1\n")
    (project / "set" / "my chart.tif").touch()
    columns = f"{FABRICS}\tchart\tchart_corners\tlamp"
    sheet(project, "fabrics", columns, "dome\tset\t\t\t\t\tmy chart.tif\t\txenon", "tiny\trig\t\t\t2\t\t\t\t")
    config = copy.deepcopy(SHIPPED)
    config["rig"]["chart_corners"] = "0,0,9,0,9,6,0,6"
    fabrics = read_fabrics(config)
    assert fabrics["dome"].chart.options == "--chart 'set/my chart.tif' --chart-corners='' --lamp=xenon"
    assert fabrics["tiny"].chart.options == "--chart-corners=0,0,9,0,9,6,0,6 --lamp=''"
    for cells, says in (("none.tif\t\t", "none.tif is no file"), ("\t\txenon", "fabric 'dome' has no chart")):
        sheet(project, "fabrics", columns, f"dome\tset\t\t\t\t\t{cells}")
        with pytest.raises(InputError, match=says):
            read_fabrics(copy.deepcopy(SHIPPED))


@pytest.mark.parametrize("schema", sorted(path.name for path in SCHEMAS.glob("*.yaml")))
def test_every_key_is_described(schema: str) -> None:
    def undescribed(rules: dict[str, Any], at: str) -> list[str]:
        found = []
        for key, rule in rules.get("properties", {}).items():
            own = [] if "description" in rule or "properties" in rule else [f"{at}{key}"]
            found += own + undescribed(rule, f"{at}{key}.")
        return found

    assert undescribed(yaml.safe_load((SCHEMAS / schema).read_text()), "") == []
