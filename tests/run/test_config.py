"""The config and its sheets: what is wrong with them, in one sentence each."""

import copy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from PIL import Image

from kinran.base.files import InputError
from kinran.base.project import ROOT
from kinran.capture import ingest
from kinran.run.config import SCHEMAS, directions_options, lobes_of, motion_options
from kinran.run.fabrics import Fabrics, read_fabrics

SHIPPED = yaml.safe_load((ROOT / "config.yaml").read_text())
FABRICS = "fabric\tsource\tencoding\tcrop\tregions\tseeds"
RECAPTURE = "fabric\ttheta\tphi\trevision\treason"


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "config" / "fabrics").mkdir(parents=True)
    (tmp_path / "scenes").mkdir()
    (tmp_path / "scenes" / "drape.xml").touch()
    sheet(tmp_path, "fabrics", FABRICS, "tiny\trig\t\t\t2\t")
    sheet(tmp_path, "recapture", RECAPTURE)
    return tmp_path


def sheet(folder: Path, name: str, *rows: str) -> None:
    (folder / "config" / f"{name}.tsv").write_text("\n".join(rows) + "\n")


def read() -> Fabrics:
    """What the shipped config says of the sheets in the current folder."""
    return read_fabrics(copy.deepcopy(SHIPPED))


def says(name: str, config: dict[str, Any] = SHIPPED) -> str:
    """What is wrong with a fabric, in one sentence."""
    fabrics = read_fabrics(copy.deepcopy(config))
    assert name not in fabrics.sound
    assert "\n" not in fabrics.broken[name]
    return fabrics.broken[name]


@pytest.mark.usefixtures("project")
def test_the_shipped_config_is_good() -> None:
    """With the shipped sheet; what it leaves out has a default."""
    config = {**copy.deepcopy(SHIPPED), "fabrics": str(ROOT / SHIPPED["fabrics"])}
    del config["fit"]["jobs"], config["holdout"]
    fabrics = read_fabrics(config)
    assert config["fit"]["jobs"] == 2
    assert config["holdout"] == 8
    assert not fabrics.broken
    assert fabrics.sound["brocade"].light_groups == ("00", "01", "02", "03", "04", "05")


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
        read_fabrics(config)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("name", "row", "key", "sentence"),
    [
        ("fabrics", "../up\trig\t\t\t\t", "_line_3", "line 3: fabric '../up': fabric: '../up' does not match"),
        ("fabrics", "a;b\trig\t\t\t\t", "_line_3", "does not match"),
        (
            "fabrics",
            "bad\trig\t\t\t0\t",
            "bad",
            "config/fabrics.tsv: line 3: fabric 'bad': regions: '0' does not match",
        ),
        ("fabrics", "bad\trig\t\t\t2\tgold:1", "bad", "line 3: fabric 'bad': seeds: 'gold:1' does not match"),
        ("fabrics", "bad\tnowhere\t\t\t\t", "bad", "line 3: fabric 'bad': source: nowhere: no such folder"),
        ("fabrics", "bad\tset\tgamma:x\t\t\t", "bad", "line 3: fabric 'bad': encoding: "),
        ("fabrics", "bad\trig", "bad", "line 3 has another number of cells"),
        ("fabrics", "bad rig", "_line_3", "line 3 has another number of cells"),
        ("fabrics", "bad\trig\t\t\t\t\nbad\trig\t\t\t\t", "bad", "'bad' stands twice, in lines 3 and 4"),
        ("recapture", "bad\t40\t44\t1\tx", "bad", "line 2: fabric 'bad': θ = 40, φ = 44 is no direction of the grid"),
        ("recapture", "bad\t40\t45\t0\tx", "bad", "line 2: fabric 'bad': revision: '0' does not match"),
        ("recapture", "bad\t40\t45\t1\t", "bad", "line 2: fabric 'bad': reason: "),
        ("recapture", "bad\t40", "bad", "line 2 has another number of cells"),
        ("recapture", "other\t40\t45\t1\tx", "_recapture_line_2", "fabric 'other': is no fabric on the rig"),
    ],
)
def test_a_bad_row_is_one_bad_fabric(project: Path, name: str, row: str, key: str, sentence: str) -> None:
    """The message names sheet, line and column, and the other fabric is as it was."""
    good = read().sound["tiny"]
    rows = [FABRICS, "tiny\trig\t\t\t2\t", row if name == "fabrics" else "bad\trig\t\t\t\t"]
    sheet(project, "fabrics", *rows)
    if name == "recapture":
        sheet(project, "recapture", RECAPTURE, row, "bad\t40\t43\t1\tx")
    assert sentence in says(key)
    assert read().sound["tiny"] == good


@pytest.mark.parametrize(
    ("rows", "sentence"),
    [
        ([FABRICS], "has no fabric"),
        (["fabric\tsource", "tiny\trig"], "has no column 'encoding'"),
        ([f"{FABRICS}\tregion", "tiny\trig\t\t\t2\t\t"], "has a column 'region'"),
    ],
)
def test_a_bad_sheet_is_refused_as_a_whole(project: Path, rows: list[str], sentence: str) -> None:
    sheet(project, "fabrics", *rows)
    with pytest.raises(InputError, match=f"config/fabrics.tsv: {sentence}"):
        read()


def own(project: Path, fabric: str, text: str) -> Path:
    """Give a fabric settings of its own."""
    path = project / "config" / "fabrics" / f"{fabric}.yaml"
    path.write_text(text)
    return path


def two(project: Path) -> None:
    sheet(project, "fabrics", FABRICS, "tiny\trig\t\t\t2\t", "other\trig\t\t\t2\t")


def test_a_fabric_has_settings_of_its_own(project: Path) -> None:
    """They are merged into those of the config, and no other fabric sees them."""
    two(project)
    before = read().sound
    text = "{rig: {phis: 8, exposures: [10]}, virtual: {motif: waves}, fit: {model: lambert, compare: []}, holdout: 4}"
    own(project, "other", text)
    fabrics = read()
    other = fabrics.sound["other"]
    assert not fabrics.broken
    assert fabrics.sound["tiny"] == before["tiny"]
    assert (other.settings["rig"]["phis"], other.settings["rig"]["exposures"]) == (8, [10])
    assert other.settings["rig"]["thetas"] == SHIPPED["rig"]["thetas"]
    assert other.settings["virtual"] == {**before["tiny"].settings["virtual"], "motif": "waves"}
    assert (other.models, other.settings["holdout"]) == (["lambert"], 4)
    assert (other.lights, other.light_groups) == (16 * 8 + 1, ("00", "01"))


def test_a_file_of_settings_can_be_named(project: Path) -> None:
    (project / "fine.yaml").write_text("virtual: {texels: 33}")
    own(project, "tiny", "virtual: {texels: 44}")
    rows = "tiny\trig\t\t\t2\t\tfine.yaml", "other\trig\t\t\t\t\tnone.yaml"
    sheet(project, "fabrics", f"{FABRICS}\tsettings", *rows)
    assert read().sound["tiny"].settings["virtual"]["texels"] == 33
    assert "line 3: fabric 'other': settings: none.yaml is no file" in says("other")


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("fitt: {}", "'fitt' is no section of a fabric"),
        ("fabrics: a.tsv", "'fabrics' is no section of a fabric"),
        ("fit: {modell: slope}", "fit: Additional properties are not allowed ('modell' was unexpected)"),
        ("rig: {exposures: []}", "rig.exposures: "),
        ("fit: slope", "fit: 'slope' is not of type 'object'"),
        ("rig: {device: none}", "rig.device: is the same for all fabrics, as there is one rig"),
        ("rig: {backlash: 1}", "rig.backlash: is the same for all fabrics"),
        ("- fit", "has no sections"),
        ("fit: {", "cannot be read"),
        ("scene: {template: none.xml}", "scene.template: none.xml is no file"),
        ("scene: {scan: none.ply}", "scene.scan: none.ply is no file"),
    ],
)
def test_bad_settings_of_a_fabric(project: Path, text: str, sentence: str) -> None:
    """The message names the file and the key; the other fabric is sound."""
    two(project)
    own(project, "other", text)
    assert says("other").startswith(f"config/fabrics/other.yaml: {sentence}")
    assert list(read().sound) == ["tiny"]


def test_a_grid_that_cannot_be_grouped(project: Path) -> None:
    two(project)
    own(project, "other", "rig: {thetas: [0, 20, 40], meridians: 3}")
    assert "fabric 'other': " in says("other")
    assert "put a multiple of 4 meridians in a group" in says("other")


def test_a_set_whose_folder_is_gone_is_what_was_captured(project: Path) -> None:
    """Its lights are counted from its plan; what is calibrated needs no chart."""
    (project / "set").mkdir()
    Image.fromarray(np.full((8, 8, 3), 90, np.uint8)).save(project / "set" / "chart.png")
    for k in range(12):
        Image.fromarray(np.full((8, 8, 3), 90, np.uint8)).save(project / "set" / f"p{k}.png")
    lines = [f"p{k}.png 0.{k:02d} 0 0.9" for k in range(12)]
    (project / "set" / "a.lp").write_text("\n".join(["12", *lines]) + "\n")
    sheet(project, "fabrics", f"{FABRICS}\tchart", "dome\tset\t\t\t\t\tchart.png")
    before = read().sound["dome"]
    plan = project / "captures" / "dome" / "plan.json"
    plan.parent.mkdir(parents=True)
    ingest.main(ingest.Inputs(project / "set"), plan, ingest.Options(fabric="dome"))
    (project / "set").rename(project / "unmounted")
    assert "chart: set/chart.png is no file" in says("dome")
    (project / "results" / "dome").mkdir(parents=True)
    (project / "results" / "dome" / "calibration.json").touch()
    assert read().sound["dome"] == before
    plan.unlink()
    assert "source: set: no such folder" in says("dome")


def test_revisions_of_a_group(project: Path) -> None:
    """The latest revision counts, and the text does not depend on the order of the rows."""
    rows = ["tiny\t40\t45\t1\tx", "tiny\t5\t0\t1\ty", "tiny\t40\t45\t3\tz"]
    sheet(project, "recapture", RECAPTURE, *rows)
    first = read().revisions
    sheet(project, "recapture", RECAPTURE, *reversed(rows))
    second = read().revisions
    assert first("tiny", "00") == second("tiny", "00") == '{"t05_p000": 1, "t40_p045": 3}'
    assert first("tiny", "01") == "{}"


def test_a_monitor_can_be_shot_again(project: Path) -> None:
    sheet(project, "recapture", RECAPTURE, "tiny\t0\t60\t1\tlamp")
    assert read().revisions("tiny", "01") == '{"monitor_5": 1}'


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
    tiny = read_fabrics(config).sound["tiny"]
    assert (tiny.light_groups, tiny.all_groups, tiny.lights) == (("00", "01"), ("00", "01", "calibration"), 71)
    assert directions_options(config["rig"], "tiny") == "--directions directions.csv"
    sheet(project, "recapture", RECAPTURE, "tiny\t5\t0\t1\tx", "tiny\t74\t207\t2\ty", "tiny\t0\t0\t1\tz")
    revisions = read_fabrics(config).revisions
    assert (
        revisions("tiny", "00")
        == '{"monitor_00_1": 1, "monitor_00_2": 1, "monitor_00_3": 1, "monitor_00_4": 1, "t05_p000": 1}'
    )
    assert revisions("tiny", "01") == '{"monitor_01_1": 1, "monitor_01_2": 1, "t74_p207": 2}'
    sheet(project, "recapture", RECAPTURE, "tiny\t5\t1\t1\tx")
    assert "θ = 5, φ = 1 is no direction of directions.csv" in says("tiny", config)


def test_a_sheet_that_cannot_be(project: Path) -> None:
    assert "directions.csv: line 3: theta 'x' is no number" in says("tiny", listed(project, "5,0", "x,0"))
    config = copy.deepcopy(SHIPPED)
    config["rig"]["plan"] = "none.tsv"
    assert "none.tsv: cannot be read" in says("tiny", config)


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
    assert lobes_of(config["fit"], read_fabrics(config).sound["tiny"].lights) == (2, "gaussian")
    config["rig"].update(thetas=[0, 20, 40, 60, 80], phis=8)
    assert lobes_of(config["fit"], read_fabrics(config).sound["tiny"].lights) == (1, "ggx")


def test_distances_of_a_set(project: Path) -> None:
    """Columns that a sheet may have; on the rig, the config has them."""
    (project / "set").mkdir()
    (project / "set" / "a.lp").write_text("1\na.png 0 0 1\n")
    columns = f"{FABRICS}\tlamp_mm\tfield_mm\tcamera_mm"
    sheet(project, "fabrics", columns, "dome\tset\t\t\t\t\t300\t60.5\t", "tiny\trig\t\t\t2\t\t\t\t")
    fabrics = read().sound
    assert fabrics["dome"].light_options == "--lamp-mm 300 --field-mm 60.5"
    assert fabrics["tiny"].light_options == ""
    sheet(project, "fabrics", columns, "tiny\trig\t\t\t2\t\t\t60\t")
    assert "fabric 'tiny': field_mm: lies on the rig, whose distances and chart" in says("tiny")
    sheet(project, "fabrics", columns, "dome\tset\t\t\t\t\t-3\t\t")
    assert "lamp_mm: '-3' does not match" in says("dome")


def test_the_chart_of_a_set(project: Path) -> None:
    """Its photograph lies beside the others; on the rig, the config says what is known of it."""
    (project / "set").mkdir()
    (project / "set" / "a.lp").write_text("1\na.png 0 0 1\n")
    (project / "set" / "my chart.tif").touch()
    columns = f"{FABRICS}\tchart\tchart_corners\tlamp"
    sheet(project, "fabrics", columns, "dome\tset\t\t\t\t\tmy chart.tif\t\txenon", "tiny\trig\t\t\t2\t\t\t\t")
    config = copy.deepcopy(SHIPPED)
    config["rig"]["chart_corners"] = "0,0,9,0,9,6,0,6"
    fabrics = read_fabrics(config).sound
    assert fabrics["dome"].chart.options == "--chart 'set/my chart.tif' --chart-corners='' --lamp=xenon"
    assert fabrics["tiny"].chart.options == "--chart-corners=0,0,9,0,9,6,0,6 --lamp=''"
    for cells, sentence in (("none.tif\t\t", "none.tif is no file"), ("\t\txenon", "fabric 'dome': chart: has none")):
        sheet(project, "fabrics", columns, f"dome\tset\t\t\t\t\t{cells}")
        assert sentence in says("dome")


@pytest.mark.parametrize("schema", sorted(path.name for path in SCHEMAS.glob("*.yaml")))
def test_every_key_is_described(schema: str) -> None:
    def undescribed(rules: dict[str, Any], at: str) -> list[str]:
        found = []
        for key, rule in rules.get("properties", {}).items():
            own = [] if "description" in rule or "properties" in rule else [f"{at}{key}"]
            found += own + undescribed(rule, f"{at}{key}.")
        return found

    assert undescribed(yaml.safe_load((SCHEMAS / schema).read_text()), "") == []
