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
from kinran.base.project import ROOT
from kinran.base.sheets import read_sheet
from kinran.run.config import ADAPTIVE, check, lobes_of, read_fabrics, sheet_of

LOCK = ".snakemake/adaptive.lock"
"""File that a run locks, and the workflow that it starts with it."""
MARK = ".snakemake/adaptive.started"
"""File that is there while the workflow runs: if nobody holds the lock, that run was killed."""


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
        config = _config()
        names = [row["fabric"] for row in read_sheet(config["fabrics"]) if row["source"] == "rig"]
        with _alone() as lock:
            for name in names:
                if not _sheet(config, name).exists():
                    _propose(config, name)
            for name in names:
                while _round(config, name, options.cores, lock):
                    pass
                print(saved(config, name))


def _config() -> dict[str, Any]:
    """Read and check the config.

    Raises
    ------
    InputError
        It is missing or wrong, or asks for another plan, another model, or no held-out lights.
    """
    try:
        config: dict[str, Any] = yaml.safe_load(Path("config.yaml").read_text(encoding="utf-8"))
    except (OSError, yaml.YAMLError) as error:
        raise InputError(f"{Path('config.yaml').resolve()}: cannot be read ({error})") from None
    check(config, "config", "config.yaml")
    if config["rig"]["plan"] != ADAPTIVE:
        raise InputError(f"config.yaml: rig.plan is {config['rig']['plan']}; set it to {ADAPTIVE}")
    if config["fit"]["model"] != "slope" or not config["holdout"]:
        raise InputError(
            f"config.yaml: fit.model {config['fit']['model']}, holdout {config['holdout']}: an adaptive plan takes"
            " lobes of the model slope, and is judged by lights held out; set both"
        )
    return config


def _sheet(config: dict[str, Any], name: str) -> Path:
    sheet = sheet_of(config["rig"], name)
    assert sheet
    return sheet


def _round(config: dict[str, Any], name: str, cores: int, lock: int) -> bool:
    """Run the workflow as far as the error of a fabric, and ask for a further group; returns whether there is one."""
    targets = [f"results/{name}/{file}" for file in ("evaluation.json", "fit/prior.json")]
    snakemake = [sys.executable, "-m", "snakemake", "--snakefile", str(ROOT / "Snakefile")]
    mark = Path(MARK)
    if mark.exists():
        subprocess.run([*snakemake, "--unlock", "--quiet", "all"], check=False)
    mark.touch()
    command = [*snakemake, "--cores", str(cores), "--quiet", "rules", "--", *targets]
    failed = subprocess.run(command, check=False, pass_fds=(lock,)).returncode
    mark.unlink()
    if failed:
        raise InputError(f"{name}: the run did not finish; the messages above and the folder logs say why")
    before = _sheet(config, name).read_bytes()
    _propose(config, name)
    return _sheet(config, name).read_bytes() != before


def _propose(config: dict[str, Any], name: str) -> None:
    """Call `kinran propose` on a fabric's sheet."""
    sheet, rig = _sheet(config, name), config["rig"]
    options = [f"--error={rig['error']}", f"--most={rig['most']}", f"--holdout={config['holdout']}"]
    if sheet.exists():
        results = f"results/{name}"
        fabric = f"{results}/needed" if config["fit"]["texels"] == "needed" else results
        options += [f"--fabric={fabric}", f"--prior={results}/fit/prior.json"]
        options += [f"--evaluation={results}/evaluation.json"]
        lobes = lobes_of(config, read_fabrics(config)[name])
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


def saved(config: dict[str, Any], name: str) -> str:
    """Return what a fabric took, in words: its last error, and how many directions the grid of the config has more."""
    rig, last = config["rig"], read_json(_sheet(config, name).with_suffix(".json"))[-1]
    took = f"{name}: {last['directions']} directions, error {last['error']:.3f} (wanted: {rig['error']:g})"
    if not {"thetas", "phis"} <= rig.keys():
        return took
    whole = (len(rig["thetas"]) - 1) * rig["phis"] + 1
    fewer = f"{whole - last['directions']} fewer than" if last["directions"] < whole else "no fewer than"
    return f"{took}; {fewer} the grid of config.yaml, which has {whole}"
