"""Many virtual fabrics through the workflow: what of the processor time is the work of stages, and what is overhead.

Each fabric has a seed, motif and threads of its own. Every stage notes its processor time as it ends; what the run took
beyond the sum of these is Snakemake, shells and starts of Python. What a stage spends on its imports is counted apart.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import yaml

from kinran.__main__ import STAGES
from kinran.base.files import InputError, write_json
from kinran.base.project import ROOT
from kinran.capture import grid
from kinran.run.resources import COSTS, Size

RULES = {"merge-group": "merge"}
"""Rules whose stage has another name."""
EACH = ("merge-group", "mesh", "scan", "overview")
"""Stages whose cost is that of a job; a fabric has one cost of the others, whatever jobs share it."""
MOTIFS = ("comma", "waves", "lozenges")
THREADS = ("red", "indigo", "moss")
NOTE = '''"""Note what a stage took as it ends, beside those of the other stages."""
import atexit, json, os, resource, sys
def note():
    if sys.orig_argv[1:3] == ["-m", "kinran"]:
        used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
        cpu, mb = sum(use.ru_utime + use.ru_stime for use in used), max(use.ru_maxrss for use in used) / 1024
        line = json.dumps({"stage": sys.orig_argv[3], "cpu_s": cpu, "peak_mb": mb, "start": START, "end": time.time()})
        with open(os.environ["KINRAN_NOTES"], "a") as notes:
            notes.write(line + "\\n")
import time
START = time.time()
atexit.register(note)
'''
"""A `sitecustomize` for the jobs of a run."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the benchmark."""
    parser.add_argument("--fabrics", type=int, default=20, help="number of fabrics (20)")
    parser.add_argument("--texels", type=int, default=80, help="texels of a fabric along a side (80)")
    parser.add_argument("--samples", type=int, default=32, help="samples a texel of the virtual camera (32)")
    parser.add_argument("--phis", type=int, default=24, help="azimuths of the light (24; the paper has 72)")
    parser.add_argument("--cores", type=int, default=os.cpu_count() or 1, help="cores of the run (all)")
    parser.add_argument("--folder", type=Path, help="where to keep the run; a temporary folder if not given")
    parser.add_argument("--out", type=Path, help="results (.json)")


def main(args: argparse.Namespace) -> None:
    """Run, print a table, write JSON.

    Raises
    ------
    InputError
        The run did not finish.
    """
    with tempfile.TemporaryDirectory(prefix="kinran-fabrics-") as scratch:
        folder = args.folder or Path(scratch)
        config = write_project(folder, args.fabrics, args.texels, args.samples, args.phis)
        rig = config["rig"]
        plan = grid.plan_grid("f000", rig["thetas"], rig["phis"], (1.0,), rig["meridians"])
        size = Size(args.texels**2, len(plan.lights))
        results = measured(folder, args.cores, args.fabrics, size) | {"fabrics": args.fabrics, **asdict(size)}
    print_table(results)
    if args.out:
        write_json(args.out, results)


def write_project(folder: Path, fabrics: int, texels: int, samples: int, phis: int) -> dict[str, Any]:
    """Write a working folder with the config of the project and so many virtual fabrics, no two alike; the config."""
    own = folder / "config" / "fabrics"
    own.mkdir(parents=True, exist_ok=True)
    config: dict[str, Any] = yaml.safe_load((ROOT / "config.yaml").read_text(encoding="utf-8"))
    config["rig"]["phis"] = phis
    config["virtual"].update(texels=texels, samples=samples)
    config["scene"]["template"] = str(ROOT / config["scene"]["template"])
    (folder / "config.yaml").write_text(yaml.safe_dump(config, sort_keys=False), encoding="utf-8")
    rows = ["fabric\tsource\tencoding\tcrop\tregions\tseeds"]
    for k in range(fabrics):
        virtual = {"seed": 7 + k, "motif": MOTIFS[k % 3], "threads": THREADS[k // 3 % 3]}
        (own / f"f{k:03d}.yaml").write_text(yaml.safe_dump({"virtual": virtual}), encoding="utf-8")
        rows.append(f"f{k:03d}\trig\t\t\t4\t")
    (folder / "config" / "fabrics.tsv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    (folder / "config" / "recapture.tsv").write_text("fabric\ttheta\tphi\trevision\treason\n", encoding="utf-8")
    return config


def measured(folder: Path, cores: int, fabrics: int, size: Size) -> dict[str, Any]:
    """Run the workflow in a folder with so many fabrics of a size, and return what it took: all in all, and by stage.

    Raises
    ------
    InputError
        The run did not finish.
    """
    with tempfile.TemporaryDirectory(prefix="kinran-notes-") as scratch:
        (Path(scratch) / "sitecustomize.py").write_text(NOTE, encoding="utf-8")
        notes = Path(scratch) / "notes.jsonl"
        notes.touch()
        search = os.pathsep.join(filter(None, (scratch, os.environ.get("PYTHONPATH"))))
        environment = {**os.environ, "PYTHONPATH": search, "KINRAN_NOTES": str(notes)}
        command = [sys.executable, "-m", "snakemake", "--snakefile", str(ROOT / "Snakefile"), "--directory"]
        before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
        finished = subprocess.run(
            [*command, str(folder), "--cores", str(cores), "--quiet", "rules"], env=environment, check=False
        )
        wall, after = time.monotonic() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
        if finished.returncode:
            raise InputError(f"{folder}: the run did not finish; the messages above and {folder / 'logs'} say why")
        lines = [json.loads(line) for line in notes.read_text(encoding="utf-8").splitlines()]
    total = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    stages: dict[str, dict[str, float]] = {}
    for line in lines:
        row = stages.setdefault(line["stage"], {"jobs": 0, "cpu_s": 0.0, "peak_mb": 0.0})
        row["jobs"] += 1
        row["cpu_s"] += line["cpu_s"]
        row["peak_mb"] = max(row["peak_mb"], line["peak_mb"])
    for name, row in stages.items():
        row["imports_s"] = row["jobs"] * imports_of(name)
        row["model_s"] = model_of(name, row["jobs"], fabrics, size)
    work = sum(row["cpu_s"] for row in stages.values())
    return {
        "cpu_s": total,
        "wall_s": wall,
        "stages_s": work,
        "overhead_s": total - work,
        "overhead": (total - work) / total,
        "imports": sum(row["imports_s"] for row in stages.values()) / total,
        "stages": stages,
    }


def model_of(stage: str, jobs: float, fabrics: int, size: Size) -> float:
    """Return the processor seconds of a stage's jobs by the costs that clusters are asked by; 0 without any."""
    cost = COSTS.get(RULES.get(stage, stage))
    return cost.time(size) * (jobs if stage in EACH else fabrics) if cost else 0.0


def imports_of(stage: str) -> float:
    """Return the processor seconds that a process takes to import the module of a stage."""
    if stage not in STAGES and stage != "render":
        return 0.0
    module = STAGES[stage][0] if stage in STAGES else "kinran.scene.render"
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, "-c", f"import {module}"], check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def print_table(results: dict[str, Any]) -> None:
    """Print what a run took."""
    print(f"{'stage':14} {'jobs':>6} {'CPU s':>9} {'model':>9} {'imports':>9} {'peak MB':>9}")
    for name, row in sorted(results["stages"].items(), key=lambda pair: -pair[1]["cpu_s"]):
        model, imports = row["model_s"], row["imports_s"]
        print(f"{name:14} {row['jobs']:6.0f} {row['cpu_s']:9.1f} {model:9.1f} {imports:9.1f} {row['peak_mb']:9.0f}")
    print(f"{'overhead':14} {'':6} {results['overhead_s']:9.1f}   {results['overhead']:.1%} of the run")
    print(f"{'all':14} {'':6} {results['cpu_s']:9.1f}   in {results['wall_s'] / 60:.1f} min")
