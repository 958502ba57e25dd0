"""The configuration: read once, checked by schema, with defaults filled in."""

import json
import shlex
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import jsonschema
import yaml

from kinran.base import encoding
from kinran.base.distances import Distances
from kinran.base.files import InputError
from kinran.base.project import ROOT
from kinran.base.sheets import read_sheet
from kinran.capture import grid
from kinran.capture.assembly import CALIBRATION
from kinran.capture.directions import Directions, read_directions
from kinran.data.capture_plan import list_group_names
from kinran.data.lights import lp_file, read_lp
from kinran.fit.few_lights import FEW_LIGHTS

OF_PHOTOGRAPHS = ("lamp_mm", "field_mm", "camera_mm", "chart", "chart_corners", "lamp")
"""Columns of the sheet of fabrics that it need not have."""
ADAPTIVE = "adaptive"
"""The plan of a rig whose fabrics have a sheet of directions each, which `kinran propose` appends to."""
SCHEMAS = ROOT / "workflow" / "schemas"


@dataclass(frozen=True)
class ChartShot:
    """A photograph of a colour chart.

    Attributes
    ----------
    file
        None on the rig, which shoots it itself, and where there is none.
    corners, lamp
        Options ``--chart-corners`` and ``--lamp`` of `kinran calibrate`.
    """

    file: Path | None = None
    corners: str = ""
    lamp: str = ""

    @property
    def options(self) -> str:
        """Options of `kinran calibrate`."""
        file = f"--chart {shlex.quote(str(self.file))} " if self.file else ""
        return f"{file}--chart-corners={shlex.quote(self.corners)} --lamp={shlex.quote(self.lamp)}"


@dataclass(frozen=True)
class FabricRow:
    """A row of the sheet of fabrics.

    Attributes
    ----------
    name
        Name of the fabric and of its folders.
    folder
        Folder of its photographs; None where it lies on the rig.
    encoding, crop
        Encoding and crop of the photographs.
    regions
        Number of regions; None for as many as the data tell apart.
    seeds
        Texels of each region, as the sheet has them.
    distances
        Distances of lamps and camera of photographs; empty on the rig, whose config has them.
    chart
        Colour chart of the fabric's session.
    lights
        Number of different light directions.
    light_groups
        Groups of its capture that hold lights.
    all_groups
        Groups of lights, and the calibration group of the rig.
    """

    name: str
    folder: Path | None
    encoding: str
    crop: str
    regions: int | None
    seeds: str
    distances: Distances
    chart: ChartShot
    lights: int
    light_groups: tuple[str, ...]
    all_groups: tuple[str, ...]

    @property
    def region_option(self) -> str:
        """Options of `kinran segment`."""
        count = "" if self.regions is None else f"--count {self.regions} "
        return f"{count}--seeds={shlex.quote(self.seeds)}" if self.seeds else count

    @property
    def distance_options(self) -> str:
        """Options of `kinran ingest`."""
        given = {name.replace("_", "-"): value for name, value in asdict(self.distances).items() if value is not None}
        return " ".join(f"--{name} {value:.9g}" for name, value in given.items())


def lobes_of(config: dict[str, Any], fabric: FabricRow) -> tuple[int, str] | None:
    """Number and tail of a fabric's slope lobes: those of the config, but one GGX lobe under few lights.

    None where `kinran choice` chooses them for each fabric. With few directions two lobes explode: on a path-traced
    brocade under 29 lights their held-out error was 1.17, that of one lobe less than that of the four steps, 0.99.
    """
    if config["fit"]["lobes"] == "choose":
        return None
    if fabric.lights < FEW_LIGHTS:
        return 1, "ggx"
    return config["fit"]["lobes"], config["fit"]["tail"]


def check(value: dict[str, Any], schema: str, where: str) -> None:
    """Check a value against a schema of `workflow/schemas` and fill in the defaults.

    Raises
    ------
    InputError
        The value does not fit the schema.
    """
    rules = yaml.safe_load((SCHEMAS / f"{schema}.schema.yaml").read_text(encoding="utf-8"))
    _fill(value, rules)
    error = jsonschema.exceptions.best_match(jsonschema.Draft202012Validator(rules).iter_errors(value))
    if error is not None:
        at = ".".join(str(part) for part in error.absolute_path)
        raise InputError(
            f"{where}: {at + ': ' if at else ''}{error.message}; see workflow/schemas/{schema}.schema.yaml"
        )


def _fill(value: dict[str, Any], rules: dict[str, Any]) -> None:
    for key, rule in rules.get("properties", {}).items():
        if "default" in rule:
            value.setdefault(key, rule["default"])
        if isinstance(value.get(key), dict):
            _fill(value[key], rule)


def read_fabrics(config: dict[str, Any]) -> dict[str, FabricRow]:
    """Check the config, and read the sheet of fabrics that it names.

    Raises
    ------
    InputError
        The config or a row is wrong, or a set's lights cannot be read.
    """
    check(config, "config", "config.yaml")
    sheet = config["fabrics"]
    fabrics: dict[str, FabricRow] = {}
    for row in read_sheet(sheet):
        check(dict(row), "fabric", f"{sheet}: fabric '{row.get('fabric', '')}'")
        if row["fabric"] in fabrics:
            raise InputError(f"{sheet}: fabric '{row['fabric']}' stands twice; give each a name of its own")
        fabrics[row["fabric"]] = _fabric(row, config["rig"], sheet)
    if not fabrics:
        raise InputError(f"{sheet}: has no fabric; add a row")
    return fabrics


def _fabric(row: dict[str, str], rig: dict[str, Any], sheet: str) -> FabricRow:
    regions = int(row["regions"]) if row["regions"] else None
    lamp, field, camera = (float(row[name]) if row.get(name) else None for name in ("lamp_mm", "field_mm", "camera_mm"))
    distances = Distances(lamp, field, camera)
    if row["source"] == "rig":
        if given := [name for name in OF_PHOTOGRAPHS if row.get(name)]:
            raise InputError(
                f"{sheet}: fabric '{row['fabric']}' lies on the rig, whose distances and chart are those of"
                f" config.yaml; leave {given[0]} empty in its row"
            )
        chart = ChartShot(None, rig["chart_corners"], rig["lamp"])
        if listed := rig_directions(rig, row["fabric"]):
            names, count = listed.group_names, listed.count
        else:
            names = grid.group_names(rig["thetas"], rig["phis"], rig["meridians"])
            count = (len(rig["thetas"]) - 1) * rig["phis"] + 1
        lights = tuple(name for name in names if name != CALIBRATION)
        return FabricRow(
            row["fabric"], None, "", "", regions, row["seeds"], distances, chart, count, lights, tuple(names)
        )
    folder = Path(row["source"])
    encoded = row["encoding"] or "srgb"
    encoding.parse(encoded)
    chart = ChartShot(
        folder / row["chart"] if row.get("chart") else None, row.get("chart_corners", ""), row.get("lamp", "")
    )
    if chart.file is None and (chart.corners or chart.lamp):
        raise InputError(
            f"{sheet}: fabric '{row['fabric']}' has no chart; name its photograph,"
            " or leave its corners and its lamp empty"
        )
    if chart.file is not None and not chart.file.is_file():
        raise InputError(f"{sheet}: {chart.file} is no file; correct the chart of fabric '{row['fabric']}'")
    count = len(read_lp(lp_file(folder)))
    groups = tuple(list_group_names(count))
    return FabricRow(
        row["fabric"], folder, encoded, row["crop"], regions, row["seeds"], distances, chart, count, groups, groups
    )


def sheet_of(rig: dict[str, Any], fabric: str) -> Path | None:
    """Return the sheet of a fabric's directions by the section `rig` of the config; None for a grid."""
    if rig["plan"] == "grid":
        return None
    return Path(f"captures/{fabric}/directions.tsv" if rig["plan"] == ADAPTIVE else rig["plan"])


def rig_directions(rig: dict[str, Any], fabric: str) -> Directions | None:
    """Return the directions of a fabric's sheet; None for a grid.

    Raises
    ------
    InputError
        The sheet is wrong, or not yet there.
    """
    sheet = sheet_of(rig, fabric)
    if rig["plan"] == ADAPTIVE and sheet and not sheet.exists():
        raise InputError(f"{sheet}: is not there yet; kinran adaptive begins it, and adds to it")
    return None if sheet is None else read_directions(sheet)


def directions_options(rig: dict[str, Any], fabric: str) -> str:
    """Return the options of `kinran plan` for the directions of the light."""
    if sheet := sheet_of(rig, fabric):
        return f"--directions {shlex.quote(str(sheet))}"
    thetas = ",".join(f"{theta:g}" for theta in rig["thetas"])
    return f"--thetas {thetas} --phis {rig['phis']} --meridians {rig['meridians']}"


def motion_options(rig: dict[str, Any]) -> str:
    """Return the options of `kinran plan` for the motion of the rig, as far as the config states it."""
    options = [f"--backlash {rig['backlash']:g}"] if rig["backlash"] else []
    for name in ("speeds", "accelerations"):
        if rig.get(name):
            options.append(f"--{name} {','.join(f'{value:g}' for value in rig[name])}")
    if not rig["photodiode"]:
        options.append("--no-photodiode")
    return " ".join(options)


def read_revisions(config: dict[str, Any], fabrics: dict[str, FabricRow]) -> Callable[[str, str], str]:
    """Read the sheet of directions to shoot again.

    Returns
    -------
    callable
        (fabric, group) → the shots of the group with a revision, as JSON in one order, for a rule's parameter.

    Raises
    ------
    InputError
        A row is wrong, or names a direction that the rig's plan does not have.
    """
    sheet, rig = config["recapture"], config["rig"]
    wanted: dict[tuple[str, str], dict[str, int]] = {}
    rows = read_sheet(sheet)
    for row in rows:
        check(
            dict(row),
            "recapture",
            f"{sheet}: {row.get('fabric', '')} {row.get('theta', '')} {row.get('phi', '')}",
        )
        theta, phi = float(row["theta"]), float(row["phi"])
        if row["fabric"] not in fabrics or fabrics[row["fabric"]].folder is not None:
            raise InputError(f"{sheet}: '{row['fabric']}' is no fabric on the rig; correct the row")
        listed = rig_directions(rig, row["fabric"])
        if listed:
            found = listed.find_shots(theta, phi)
        else:
            found = grid.find_shots(rig["thetas"], rig["phis"], rig["meridians"], theta, phi)
        if not found:
            where = sheet_of(rig, row["fabric"]) or "the grid"
            raise InputError(f"{sheet}: θ = {theta:g}, φ = {phi:g} is no direction of {where}; correct the row")
        for group, name in found:
            shots = wanted.setdefault((row["fabric"], group), {})
            shots[name] = max(shots.get(name, 0), int(row["revision"]))
    return lambda fabric, group: json.dumps(wanted.get((fabric, group), {}), sort_keys=True)
