"""Shoot and fit fabrics group by group, each where the fit so far is least sure, until the error is as wanted.

A round is the workflow as it always runs, and then `kinran propose`, which appends a group to the fabric's sheet of
directions. The sheet is all that a round adds to the state of the workflow, and it is whole or as it was: so a run that
was killed goes on where it was, and nothing is shot or fitted twice.
"""

import fcntl
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import chdir, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import yaml

from kinran.base.files import InputError, read_json
from kinran.run.config import ADAPTIVE, lobes_of, rig_directions, sheet_of
from kinran.run.fabrics import read_rows
from kinran.run.snakemake import run_snakemake

LOCK = ".snakemake/adaptive.lock"
"""File that a run locks, and the workflow that it starts with it."""


@dataclass(frozen=True)
class Options:
    folder: Annotated[Path, "working folder, with config.yaml"] = Path()
    cores: Annotated[int, "processor cores to use (default: all)"] = os.cpu_count() or 1


def main(options: Options = Options()) -> None:
    """Bring each fabric on the rig to the wanted error or to the most directions, and say what that took.

    Raises
    ------
    InputError
        The config does not ask for an adaptive plan, another run is at work, or a step failed.
    """
    with chdir(options.folder):
        settings, broken = _settings()
        with _alone() as lock:
            for name, own in settings.items():
                if not _sheet(own, name).exists():
                    _propose(own, name)
            for name, own in settings.items():
                while _round(own, name, options.cores, lock):
                    pass
                print(saved(own, name))
        if broken:
            raise InputError("; ".join(broken.values()))


def _settings() -> tuple[dict[str, dict[str, Any]], dict[str, str]]:
    """Return the settings of the fabrics with an adaptive plan, by name, and what is wrong with broken rows.

    Raises
    ------
    InputError
        The config is missing or wrong, or no fabric has an adaptive plan, or one has another model or no held-out
        lights.
    """
    try:
        config: dict[str, Any] = yaml.safe_load(Path("config.yaml").read_text(encoding="utf-8"))
    except (OSError, yaml.YAMLError) as error:
        raise InputError(f"{Path('config.yaml').resolve()}: cannot be read ({error})") from None
    rows, broken = read_rows(config)
    on_rig = {name: row for name, row in rows.items() if row.cells["source"] == "rig"}
    found = {name: row for name, row in on_rig.items() if row.settings["rig"]["plan"] == ADAPTIVE}
    if not found and not broken:
        raise InputError(f"config.yaml: rig.plan is {config['rig']['plan']}; set it to {ADAPTIVE}")
    for row in found.values():
        model, holdout = row.settings["fit"]["model"], row.settings["holdout"]
        if model != "slope" or not holdout:
            raise InputError(
                f"{row.own}: fit.model {model}, holdout {holdout}: an adaptive plan takes"
                " lobes of the model slope, and is judged by lights held out; set both"
            )
    return {name: row.settings for name, row in found.items()}, broken


def _sheet(settings: dict[str, Any], name: str) -> Path:
    sheet = sheet_of(settings["rig"], name)
    assert sheet
    return sheet


def _round(settings: dict[str, Any], name: str, cores: int, lock: int) -> bool:
    """Run the workflow as far as the error of a fabric, and ask for a further group; returns whether there is one."""
    targets = [f"results/{name}/{file}" for file in ("evaluation.json", "fit/prior.json")]
    if run_snakemake(["--cores", str(cores), "--quiet", "rules", "--", *targets], files=(lock,)):
        raise InputError(f"{name}: the run did not finish; the messages above and the folder logs say why")
    before = _sheet(settings, name).read_bytes()
    _propose(settings, name)
    return _sheet(settings, name).read_bytes() != before


def _propose(settings: dict[str, Any], name: str) -> None:
    """Call `kinran propose` on a fabric's sheet."""
    sheet, rig = _sheet(settings, name), settings["rig"]
    options = [f"--error={rig['error']}", f"--most={rig['most']}", f"--holdout={settings['holdout']}"]
    if sheet.exists():
        results = f"results/{name}"
        fabric = f"{results}/needed" if settings["fit"]["texels"] == "needed" else results
        options += [f"--fabric={fabric}", f"--prior={results}/fit/prior.json"]
        options += [f"--evaluation={results}/evaluation.json"]
        listed = rig_directions(rig, name)
        assert listed
        lobes = lobes_of(settings["fit"], listed.count)
        if lobes is None:
            options += [f"--choice={results}/fit/choice.json"]
        else:
            options += [f"--lobes={lobes[0]}", f"--tail={lobes[1]}"]
    if subprocess.run([sys.executable, "-m", "kinran", "propose", *options, str(sheet)], check=False).returncode:
        raise InputError(f"{sheet}: got no further group; the message above says why")


@contextmanager
def _alone() -> Iterator[int]:
    """Hold the lock of the working folder, and return its descriptor, which the workflow inherits.

    Raises
    ------
    InputError
        Another run holds it, or a workflow that another run started.
    """
    Path(LOCK).parent.mkdir(exist_ok=True)
    with Path(LOCK).open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(f"{Path().resolve()}: another kinran adaptive is at work here; wait for it") from None
        yield file.fileno()


def saved(settings: dict[str, Any], name: str) -> str:
    """Return what a fabric took, in words: its last error, and how many directions more its grid has."""
    rig, last = settings["rig"], read_json(_sheet(settings, name).with_suffix(".json"))[-1]
    took = f"{name}: {last['directions']} directions, error {last['error']:.3f} (wanted: {rig['error']:g})"
    if not {"thetas", "phis"} <= rig.keys():
        return took
    whole = (len(rig["thetas"]) - 1) * rig["phis"] + 1
    fewer = f"{whole - last['directions']} fewer than" if last["directions"] < whole else "no fewer than"
    return f"{took}; {fewer} the grid of config.yaml, which has {whole}"
