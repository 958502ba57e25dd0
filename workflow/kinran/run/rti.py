"""Run the pipeline on a folder of photographs with known lights: material, evaluation, render, report."""

import logging
import os
import re
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import yaml

from kinran.base.files import InputError, read_json
from kinran.base.project import ROOT
from kinran.calibrate.white_card import find_card
from kinran.capture.photograph_set import Known, PhotographSet, inspect
from kinran.data import photographs
from kinran.data.verdict import told
from kinran.run.cost_of_a_set import predicted
from kinran.run.snakemake import run_snakemake

log = logging.getLogger(__name__)

WORK = ".kinran"
"""Folder in OUT with the config, the sheets and the bookkeeping of the run."""


@dataclass(frozen=True)
class Inputs:
    folder: Annotated[Path, "FOLDER", "photographs of any kind, and one .lp"]
    chart: Annotated[
        Path | None,
        "--chart FILE",
        "photograph of a colour chart under the same light; without it, the encoding's colours are believed",
    ] = None
    flat: Annotated[
        Path | None,
        "--flat FOLDER",
        "photographs of a white card under the same lights, named or in order as the set; they even out the lamps",
    ] = None


@dataclass(frozen=True, kw_only=True)
class Options(Known):
    holdout: Annotated[int, "--holdout N", "hold every Nth light out; 0: none"] = 8
    chart_corners: Annotated[
        str,
        "--chart-corners X,Y,X,Y,X,Y,X,Y",
        "x,y of its corners from the top left, dark skin's first, then around; without it, it is found",
    ] = ""
    lamp: Annotated[str, "whose spectrum lights the chart: xenon, D50, D65, A, …"] = ""
    cores: Annotated[int, "processor cores to use (default: all)"] = os.cpu_count() or 1


def main(
    inputs: Inputs, out: Annotated[Path, "--out OUT", "folder of the results"], options: Options = Options()
) -> None:
    """Write the config and run Snakemake on it."""
    work = prepare(inputs, out, options)
    if run_snakemake(["--directory", str(work), "--cores", str(options.cores), "--quiet", "rules"]):
        raise InputError(f"{out.resolve()}: the run did not finish; the messages above and {work / 'logs'} say why")
    print(f"material    {out / 'material.exr'}")
    print(f"evaluation  {out / 'evaluation.json'}")
    print(f"report      {out / 'report.html'}")
    print(told(out.name, read_json(out / "evaluation.json")))


def prepare(inputs: Inputs, out: Path, options: Options) -> Path:
    """Check a set, write its config and sheets into OUT, and return the working directory of the run.

    The results of the fabric are OUT itself: `results/<fabric>` in the working directory leads there.
    """
    distances, out = asdict(options.distances), out.resolve()
    found = inspect(inputs.folder.resolve(), options, options.holdout)
    for sentence in predicted(found, options):
        log.info(sentence)
    if inputs.flat:
        check_card(inputs.flat.resolve(), found)
    fabric = re.sub(r"[^a-z0-9_-]+", "-", out.name.lower()).strip("-_") or "fabric"
    work = out / WORK
    try:
        (work / "config").mkdir(parents=True, exist_ok=True)
        (work / "results").mkdir(exist_ok=True)
        link = work / "results" / fabric
        if not link.is_symlink():
            link.symlink_to(out, target_is_directory=True)
        defaults = yaml.safe_load((ROOT / "config.yaml").read_text(encoding="utf-8"))
        defaults.update(holdout=options.holdout)
        defaults["rig"]["device"] = "none"
        defaults["scene"]["template"] = str(ROOT / defaults["scene"]["template"])
        (work / "config.yaml").write_text(yaml.safe_dump(defaults, sort_keys=False), encoding="utf-8")
        row = {
            "fabric": fabric,
            "source": str(inputs.folder.resolve()),
            "encoding": options.encoding,
            "crop": options.crop,
            "regions": "",
            "seeds": "",
            **{name: "" if value is None else f"{value:.9f}" for name, value in distances.items()},
            "chart": str(inputs.chart.resolve()) if inputs.chart else "",
            "chart_corners": options.chart_corners,
            "lamp": options.lamp,
            "lp": str(options.lp.resolve()) if options.lp else "",
            "mask": str(options.mask.resolve()) if options.mask else "",
            "max_mp": f"{options.max_mp:g}" if options.max_mp else "",
            "flat": str(inputs.flat.resolve()) if inputs.flat else "",
        }
        rows = ["\t".join(row), "\t".join(row.values())]
        (work / "config" / "fabrics.tsv").write_text("\n".join(rows) + "\n", encoding="utf-8")
        (work / "config" / "recapture.tsv").write_text("fabric\ttheta\tphi\trevision\treason\n", encoding="utf-8")
    except OSError as error:
        raise InputError(f"{out}: cannot be written to ({error.strerror}); choose another output folder") from None
    return work


def check_card(folder: Path, found: PhotographSet) -> None:
    """Check that each light of a set has a photograph of the card, of the set's size.

    Raises
    ------
    InputError
        One is missing, or of another size.
    """
    for frames in find_card(folder, [light.name for light in found.lights]).values():
        for path in frames:
            if (size := photographs.size(path)) != found.size:
                raise InputError(
                    f"{path}: is {size[0]}x{size[1]} but the set {found.size[0]}x{found.size[1]}; photograph the card"
                    " as the set"
                )
