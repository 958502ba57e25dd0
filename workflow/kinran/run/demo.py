"""Run the whole pipeline with the project's config: by default the virtual rig, with no hardware and no data."""

import os
from typing import Annotated

from kinran.base.files import InputError, read_json
from kinran.base.project import ROOT
from kinran.data.verdict import told
from kinran.run.snakemake import run_snakemake


def main(cores: Annotated[int, "processor cores to use (default: all)"] = os.cpu_count() or 1) -> None:
    """Run Snakemake, and print where the report and the picture are."""
    if run_snakemake(["--cores", str(cores), "--quiet", "rules"], folder=ROOT):
        raise InputError("the run did not finish; the messages above and the folder logs say why")
    print(told("brocade", read_json(ROOT / "results" / "brocade" / "evaluation.json")))
    print("open results/report.html; the picture is results/brocade/render.png")
