"""The fabrics of a config: the rows of its sheets, and what they name.

What is wrong with the config or with a whole sheet is an error. What is wrong with a row, or with what it names, is
wrong with one fabric, and is kept by its name: the others go on.
"""

import hashlib
import json
import os
import re
import shlex
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from kinran.base import encoding
from kinran.base.distances import Distances
from kinran.base.files import NAME, InputError
from kinran.base.sheets import each_row
from kinran.capture import grid
from kinran.capture.assembly import CALIBRATION
from kinran.data.capture_plan import list_group_names, read_plan
from kinran.data.light_files import find_lights
from kinran.run.config import check, own_settings, read_schema, rig_directions, sheet_of
from kinran.run.reference_shots import CardShots, ChartShot

OF_PHOTOGRAPHS = ("lamp_mm", "field_mm", "camera_mm", "chart", "chart_corners", "lamp", "mask", "max_mp", "flat")
"""Columns of the sheet of fabrics that it need not have."""
GENERATED = "generated"
"""The scan that stands for a simulated one."""
MESHES = "_meshes"
"""Folder, among the results, of the meshes that fabrics share; no fabric can have its name."""


@dataclass(frozen=True)
class FabricRow:
    """A fabric: its row of the sheet, and its settings.

    Attributes
    ----------
    name
        Name of the fabric and of its folders.
    folder
        Folder of its photographs; None where it lies on the rig.
    lp
        File of the lights of its photographs; None where it lies beside them.
    mask
        Mask of its photographs; None for the one beside them, if there is one.
    max_mp
        Most megapixels of the material; larger photographs are averaged. None to keep them all.
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
    card
        White card under its lights.
    lights
        Number of different light directions.
    light_groups
        Groups of its capture that hold lights.
    all_groups
        Groups of lights, and the calibration group of the rig.
    settings
        Sections of the config, with what the fabric has of its own.
    """

    name: str
    folder: Path | None
    lp: Path | None
    mask: Path | None
    max_mp: float | None
    encoding: str
    crop: str
    regions: int | None
    seeds: str
    distances: Distances
    chart: ChartShot
    card: CardShots
    lights: int
    light_groups: tuple[str, ...]
    all_groups: tuple[str, ...]
    settings: dict[str, Any]

    @property
    def models(self) -> list[str]:
        """Models that are fitted: that of the material first, then those that it is compared with."""
        return list(dict.fromkeys([self.settings["fit"]["model"], *self.settings["fit"]["compare"]]))

    @property
    def scan(self) -> Path | None:
        """Scan of the cloth; None for a generated one."""
        scan = self.settings["scene"]["scan"]
        return None if scan == GENERATED else Path(scan)

    @property
    def lp_option(self) -> str:
        """Options of `kinran ingest` for the file of lights."""
        return f"--lp {shlex.quote(str(self.lp))}" if self.lp else ""

    @property
    def mesh(self) -> str:
        """Name of the mesh of its scan, which it shares with all fabrics of that scan."""
        if self.scan is None:
            return GENERATED
        path = os.path.normpath(self.scan).encode()
        return f"{re.sub(r'[^a-z0-9]+', '-', self.scan.stem.lower())}-{hashlib.sha256(path).hexdigest()[:8]}"

    @property
    def region_option(self) -> str:
        """Options of `kinran segment`."""
        count = "" if self.regions is None else f"--count {self.regions} "
        return f"{count}--seeds={shlex.quote(self.seeds)}" if self.seeds else count

    @property
    def light_options(self) -> str:
        """Options of `kinran ingest` for lights, mask and size: distances, their files, and the most megapixels."""
        given = {name.replace("_", "-"): value for name, value in asdict(self.distances).items() if value is not None}
        mask = f"--mask {shlex.quote(str(self.mask))}" if self.mask else ""
        most = f"--max-mp {self.max_mp:g}" if self.max_mp else ""
        words = [*(f"--{name} {value:.9g}" for name, value in given.items()), self.lp_option, mask, most]
        return " ".join(filter(None, words))


@dataclass(frozen=True)
class Fabrics:
    """What the sheets of a config say.

    Attributes
    ----------
    sound
        Fabrics by name, in the order of the sheet.
    broken
        What is wrong with the others, in a sentence each, by name. A row without a name of its own has that of its
        line, which no fabric can have.
    again
        Revisions of shots that are to be taken again, by (fabric, group).
    """

    sound: dict[str, FabricRow]
    broken: dict[str, str]
    again: dict[tuple[str, str], dict[str, int]]

    def revisions(self, fabric: str, group: str) -> str:
        """Return the shots of a group with a revision, as JSON in one order, for a rule's parameter."""
        return json.dumps(self.again.get((fabric, group), {}), sort_keys=True)


@dataclass(frozen=True)
class SheetRow:
    """A row of the sheet of fabrics that fits its schema.

    Attributes
    ----------
    where
        Sheet and line, for messages.
    cells
        Its cells by column.
    settings
        Sections of the config, with what the fabric has of its own.
    own
        File of the fabric's settings, or `config.yaml` where it has none.
    """

    where: str
    cells: dict[str, str]
    settings: dict[str, Any]
    own: str


def read_fabrics(config: dict[str, Any], place: Path = Path()) -> Fabrics:
    """Check the config, and read the sheets that it names.

    Parameters
    ----------
    config
        The config, whose defaults are filled in.
    place
        Folder of captures and results.

    Raises
    ------
    InputError
        The config is wrong, or a sheet as a whole. What is wrong with a fabric is returned.
    """
    rows, broken = read_rows(config)
    sound: dict[str, FabricRow] = {}
    for name, row in rows.items():
        try:
            sound[name] = _fabric(row, place)
        except InputError as error:
            broken[name] = str(error)
    again = _read_revisions(config["recapture"], sound, broken)
    return Fabrics(sound, broken, again)


def read_rows(config: dict[str, Any]) -> tuple[dict[str, SheetRow], dict[str, str]]:
    """Check the config, and read the sheet of fabrics and their settings, but nothing else that rows name.

    Returns
    -------
    dict, dict
        The rows by the name of their fabric, and what is wrong with the others, as `Fabrics` has it.

    Raises
    ------
    InputError
        The config is wrong, or the sheet has no rows, or other columns than it can have.
    """
    check(config, "config", "config.yaml")
    sheet = config["fabrics"]
    rows: dict[str, SheetRow] = {}
    broken: dict[str, str] = {}
    lines: dict[str, int] = {}
    for row in each_row(sheet):
        name = row.cells.get("fabric", "")
        key = name if NAME.fullmatch(name) else f"_line_{row.line}"
        where = f"{sheet}: line {row.line}: fabric '{name}'"
        if key in lines:
            rows.pop(key, None)
            broken[key] = (
                f"{sheet}: fabric '{name}' stands twice, in lines {lines[key]} and {row.line};"
                " give each a name of its own"
            )
            continue
        lines[key] = row.line
        if not row.wrong:
            _check_columns(sheet, row.cells)
        try:
            if row.wrong:
                raise InputError(row.wrong)
            check(row.cells, "fabric", where)
            rows[key] = SheetRow(where, row.cells, *own_settings(config, row.cells, where))
        except InputError as error:
            broken[key] = str(error)
    if not lines:
        raise InputError(f"{sheet}: has no fabric; add a row")
    return rows, broken


def _check_columns(sheet: str, cells: dict[str, str]) -> None:
    """Refuse a sheet whose columns are not those of the schema: that is wrong with all rows."""
    rules = read_schema("fabric")
    missing = [name for name in rules["required"] if name not in cells]
    unknown = [name for name in cells if name not in rules["properties"]]
    if missing or unknown:
        wrong = (
            f"has no column '{missing[0]}'" if missing else f"has a column '{unknown[0]}', which is none of a sheet's"
        )
        raise InputError(f"{sheet}: {wrong}; see workflow/schemas/fabric.schema.yaml")


def _fabric(row: SheetRow, place: Path) -> FabricRow:
    """Read what a row names."""
    scene, name = row.settings["scene"], row.cells["fabric"]
    if not Path(scene["template"]).is_file():
        raise InputError(f"{row.own}: scene.template: {scene['template']} is no file; name a scene for fabric '{name}'")
    if scene["scan"] != GENERATED and not (
        Path(scene["scan"]).is_file() or (place / "results" / name / "scan.ply").is_file()
    ):
        raise InputError(f"{row.own}: scene.scan: {scene['scan']} is no file; name a scan for fabric '{name}'")
    return _on_rig(row) if row.cells["source"] == "rig" else _of_photographs(row, place)


def _regions(row: SheetRow) -> int | None:
    return int(row.cells["regions"]) if row.cells["regions"] else None


def _on_rig(row: SheetRow) -> FabricRow:
    cells, rig = row.cells, row.settings["rig"]
    if given := [name for name in OF_PHOTOGRAPHS if cells.get(name)]:
        raise InputError(
            f"{row.where}: {given[0]}: lies on the rig, whose distances and chart are those of its settings;"
            " leave the cell empty"
        )
    try:
        if listed := rig_directions(rig, cells["fabric"]):
            names, count = listed.group_names, listed.count
        else:
            names = grid.group_names(rig["thetas"], rig["phis"], rig["meridians"])
            count = (len(rig["thetas"]) - 1) * rig["phis"] + 1
    except InputError as error:
        raise InputError(f"fabric '{cells['fabric']}': {error}") from None
    return FabricRow(
        name=cells["fabric"],
        folder=None,
        lp=None,
        mask=None,
        max_mp=None,
        encoding="",
        crop="",
        regions=_regions(row),
        seeds=cells["seeds"],
        distances=Distances(),
        chart=ChartShot(None, rig["chart_corners"], rig["lamp"]),
        card=CardShots(),
        lights=count,
        light_groups=tuple(name for name in names if name != CALIBRATION),
        all_groups=tuple(names),
        settings=row.settings,
    )


def _of_photographs(row: SheetRow, place: Path) -> FabricRow:
    cells, name = row.cells, row.cells["fabric"]
    folder = Path(cells["source"])
    encoded = cells["encoding"] or "srgb"
    try:
        encoding.parse(encoded)
    except InputError as error:
        raise InputError(f"{row.where}: encoding: {error}") from None
    chart = ChartShot(
        folder / cells["chart"] if cells.get("chart") else None, cells.get("chart_corners", ""), cells.get("lamp", "")
    )
    if chart.file is None and (chart.corners or chart.lamp):
        raise InputError(f"{row.where}: chart: has none; name its photograph, or leave its corners and its lamp empty")
    lp = Path(cells["lp"]) if cells.get("lp") else None
    count = _count_lights(row, folder, lp, place)
    if chart.file and not (chart.file.is_file() or (place / "results" / name / "calibration.json").is_file()):
        raise InputError(f"{row.where}: chart: {chart.file} is no file; correct it")
    card = CardShots(folder / cells["flat"] if cells.get("flat") else None)
    if card.folder and not (card.folder.is_dir() or (place / "results" / name / "calibration.json").is_file()):
        raise InputError(f"{row.where}: flat: {card.folder} is no folder; correct it")
    groups = tuple(list_group_names(count))
    lamp, field, camera = (
        float(cells[key]) if cells.get(key) else None for key in ("lamp_mm", "field_mm", "camera_mm")
    )
    return FabricRow(
        name=name,
        folder=folder,
        lp=lp,
        mask=Path(cells["mask"]) if cells.get("mask") else None,
        max_mp=float(cells["max_mp"]) if cells.get("max_mp") else None,
        encoding=encoded,
        crop=cells["crop"],
        regions=_regions(row),
        seeds=cells["seeds"],
        distances=Distances(lamp, field, camera),
        chart=chart,
        card=card,
        lights=count,
        light_groups=groups,
        all_groups=groups,
        settings=row.settings,
    )


def _count_lights(row: SheetRow, folder: Path, lp: Path | None, place: Path) -> int:
    """Return the number of a set's lights; where its folder is gone, that of what was captured of it."""
    try:
        return len(find_lights(folder, lp).lights)
    except (InputError, OSError) as error:
        captured = place / "captures" / row.cells["fabric"] / "plan.json"
        if captured.is_file():
            return len(read_plan(captured).lights)
        raise InputError(f"{row.where}: source: {error}") from None


def _read_revisions(
    sheet: str, sound: dict[str, FabricRow], broken: dict[str, str]
) -> dict[tuple[str, str], dict[str, int]]:
    """Read the sheet of directions to shoot again; a fabric with a wrong row goes from `sound` to `broken`."""
    again: dict[tuple[str, str], dict[str, int]] = {}
    for row in each_row(sheet):
        name = row.cells.get("fabric", "")
        if name in broken:
            continue
        try:
            if row.wrong:
                raise InputError(row.wrong)
            where = f"{sheet}: line {row.line}: fabric '{name}'"
            check(row.cells, "recapture", where)
            if name not in sound or sound[name].folder is not None:
                raise InputError(f"{where}: is no fabric on the rig; correct the row")
            for group, shot in _shots(sound[name], float(row.cells["theta"]), float(row.cells["phi"]), where):
                shots = again.setdefault((name, group), {})
                shots[shot] = max(shots.get(shot, 0), int(row.cells["revision"]))
        except InputError as error:
            key = name if name in sound else f"_recapture_line_{row.line}"
            broken[key] = str(error)
            sound.pop(key, None)
    return again


def _shots(fabric: FabricRow, theta: float, phi: float, where: str) -> list[tuple[str, str]]:
    """Return the shots of a direction, each with its group."""
    rig = fabric.settings["rig"]
    if listed := rig_directions(rig, fabric.name):
        found = listed.find_shots(theta, phi)
    else:
        found = grid.find_shots(rig["thetas"], rig["phis"], rig["meridians"], theta, phi)
    if not found:
        of = sheet_of(rig, fabric.name) or "the grid"
        raise InputError(f"{where}: θ = {theta:g}, φ = {phi:g} is no direction of {of}; correct the row")
    return found
