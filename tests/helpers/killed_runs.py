"""A campaign of kill -9 on whole runs: a small project is run, killed, and run again, until it is done.

What was made is then compared with an undisturbed run, byte for byte but for what a run says of itself.
"""

import contextlib
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from PIL import Image

from kinran.base import frames
from kinran.base.exr import read_exr
from kinran.base.project import ROOT
from kinran.data.light import LpLight
from kinran.data.light_files import write_lp

PHOTOGRAPHED, ON_RIG = "cloth", "woven"
LIGHTS, SIDE = 20, 16
CONFIG = {
    "fabrics": "config/fabrics.tsv",
    "recapture": "config/recapture.tsv",
    "holdout": 8,
    "rig": {
        "device": "virtual",
        "thetas": [0, 25, 50],
        "phis": 8,
        "exposures": [25, 250, 4000],
        "meridians": 4,
        "lamp_mm": 600,
        "field_mm": 4.8,
    },
    "virtual": {"texels": 16, "samples": 1, "seed": 7},
    "fit": {"model": "slope", "compare": ["lambert"], "regions": "all", "jobs": 2, "residual": "none"},
    "scene": {"template": "small.xml", "scan": "generated"},
}
FRONT = "import sys; from kinran.run.snakemake import run_snakemake; sys.exit(run_snakemake(sys.argv[1:]))"
"""What `kinran rti`, `kinran demo` and `kinran adaptive` do around their Snakemake."""
COSTS = re.compile("[a-z_]*seconds[a-z_]*|peak_mb|session|run")
"""Fields of JSON that say what a job cost, and which session or run it was."""
ROUNDING = {"render.exr": 1e-6, "render.png": 1, "sweep.png": 1}
"""Largest difference of rendered pictures: threads add samples in another order each time, and no two local runs share
them either."""
OF_A_RUN = ("benchmarks", "card", "superseded", "journal.jsonl", "journal.copy.jsonl", "live.json", "report.html")
"""Folders and files that tell of sessions and costs: benchmarks, the virtual camera's card, journals, pages."""
SIDECAR = ".jsonl"
"""Suffix of the sidecars of brackets, which hold lines of the journal."""
JOBS = (1, 4)
"""A kill comes after so many jobs more, least and most: so runs get on, however fast the machine is."""
LATER_S = 1.5
"""Most seconds from the last of these to the kill."""
GIVE_UP_S = 900.0
"""Seconds after which a run counts as stuck."""


@dataclass
class Tally:
    """What a campaign did and found.

    Attributes
    ----------
    kills
        Kills of each kind: of a job, of Snakemake, of Snakemake with its jobs, of the command around it.
    stages
        Stages that ran at a kill.
    runs, projects
        Times that a run was begun, and projects that were finished.
    files
        Files of a project that were compared.
    differ
        Files that were not those of the undisturbed run, or missing, or too many.
    """

    kills: dict[str, int] = field(default_factory=dict)
    stages: dict[str, int] = field(default_factory=dict)
    runs: int = 0
    projects: int = 0
    files: int = 0
    differ: list[str] = field(default_factory=list)


def make_project(folder: Path) -> None:
    """Make a project of a fabric on the virtual rig and of one in photographs."""
    (folder / "config").mkdir(parents=True)
    template = (ROOT / "scenes" / "drape.xml").read_text()
    for name, value in {"width": "32", "height": "24", "spp": "1"}.items():
        template = re.sub(rf'(<default name="{name}" value=)"[0-9]+"', rf'\1"{value}"', template)
    (folder / "small.xml").write_text(template)
    (folder / "config.yaml").write_text(yaml.safe_dump(CONFIG))
    rows = ["fabric\tsource\tencoding\tcrop\tregions\tseeds", f"{ON_RIG}\trig\t\t\t2\t"]
    rows.append(f"{PHOTOGRAPHED}\t{folder / 'photographs'}\tsrgb\t\t2\t")
    (folder / "config" / "fabrics.tsv").write_text("\n".join(rows) + "\n")
    (folder / "config" / "recapture.tsv").write_text("fabric\ttheta\tphi\trevision\treason\n")
    take_photographs(folder / "photographs")


def take_photographs(folder: Path) -> None:
    """Write photographs of a cloth of two colours under lights all around, and their .lp."""
    folder.mkdir(parents=True)
    k = np.arange(LIGHTS) + 0.5
    directions = frames.direction(np.arccos(1 - 0.6 * k / LIGHTS), k * np.pi * (3 - 5**0.5))
    lights = [LpLight(f"p{i:02d}", tuple(d), f"p{i:02d}.png") for i, d in enumerate(directions.tolist())]
    y, x = np.mgrid[1 : -1 : SIDE * 1j, -1 : 1 : SIDE * 1j]
    normal = np.stack([-0.4 * x, -0.4 * y, np.ones_like(x)], -1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    colour = np.where((x < 0)[..., None], [0.5, 0.1, 0.08], [0.1, 0.2, 0.4])
    for light in lights:
        half = np.array(light.direction) + np.array([0.0, 0.0, 1.0])
        gloss = np.clip(normal @ (half / np.linalg.norm(half)), 0, 1) ** 30
        value = colour * np.clip(normal @ np.array(light.direction), 0, 1)[..., None] + 0.25 * gloss[..., None]
        Image.fromarray(np.round(255 * np.clip(value, 0, 1) ** (1 / 2.2)).astype(np.uint8)).save(folder / light.file)
    write_lp(folder / "lights.lp", lights)


def begin(folder: Path, log: Path) -> "subprocess.Popen[bytes]":
    """Begin a run of a project, as a command around Snakemake does."""
    options = ["--directory", str(folder), "--cores", "2", "--quiet", "rules"]
    with log.open("ab") as said:
        return subprocess.Popen(
            [sys.executable, "-c", FRONT, *options], stdout=said, stderr=said, start_new_session=True
        )


def campaign(folder: Path, kills: int, seed: int, say: Callable[[str], None] = print) -> Tally:
    """Kill runs of the small project until so many kills are done, and compare each project when it is finished."""
    chance, tally = random.Random(seed), Tally()
    work, whole = folder / "project", folder / "undisturbed"
    if not whole.exists():
        make_project(work)
        if begin(work, folder / "undisturbed.log").wait():
            raise RuntimeError((folder / "undisturbed.log").read_text()[-2000:])
        work.rename(whole)  # files hold paths, so that all projects are made in the same folder
    while sum(tally.kills.values()) < kills:
        make_project(work)
        log = folder / f"killed.{tally.projects}.log"
        code = 1
        while code:
            tally.runs += 1
            front = begin(work, log)
            code = disturb(front, chance, tally, kills)
            if code and sum(tally.kills.values()) >= kills and tally.runs > 2 * kills + 20:
                raise RuntimeError(f"it does not finish: {log.read_text()[-2000:]}")
        tally.projects += 1
        found = differences(whole, work)
        tally.files = len(files(whole))
        tally.differ += [f"{tally.projects}: {name}" for name in found]
        say(f"project {tally.projects}: {sum(tally.kills.values())} kills, {tally.runs} runs, differ: {found}")
        shutil.rmtree(work)
    return tally


def disturb(front: "subprocess.Popen[bytes]", chance: random.Random, tally: Tally, kills: int) -> int:
    """Kill something of a run, each time that a few jobs more were begun, until it ends; returns its exit code."""
    began, due, seen, wanted = time.monotonic(), 0.0, set[int](), chance.randint(*JOBS)
    while front.poll() is None:
        time.sleep(0.05)
        if time.monotonic() > began + GIVE_UP_S:
            front.kill()
            raise RuntimeError("a run is stuck")
        if sum(tally.kills.values()) >= kills:
            continue
        found = processes(front.pid)
        jobs = [pid for pid, words in found.items() if "-m kinran " in words and "bash" not in words]
        seen.update(jobs)
        if len(seen) < wanted:
            due = time.monotonic() + chance.uniform(0, LATER_S)
        snakemake = [pid for pid, words in found.items() if "-m snakemake" in words and "bash" not in words]
        if len(seen) < wanted or time.monotonic() < due or not jobs or not snakemake:
            continue
        kind = chance.choice(["job", "job", "snakemake", "all", "front"])
        victims = {"job": [chance.choice(jobs)], "snakemake": snakemake, "all": list(found), "front": [front.pid]}[kind]
        for pid in victims:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        tally.kills[kind] = tally.kills.get(kind, 0) + 1
        for stage in (stage_of(found[pid]) for pid in (victims if kind == "job" else jobs)):
            tally.stages[stage] = tally.stages.get(stage, 0) + 1
        seen, wanted = set(jobs), len(jobs) + chance.randint(*JOBS)
    return front.wait()


def stage_of(words: str) -> str:
    """Name of the stage of a command line."""
    return words.split("-m kinran ")[1].split()[0]


def processes(parent: int) -> dict[int, str]:
    """Command lines of all processes below one, by their numbers."""
    children: dict[int, list[int]] = {}
    words = {}
    for path in Path("/proc").glob("[0-9]*"):
        try:
            stat = (path / "stat").read_text().rpartition(")")[2].split()
            words[int(path.name)] = (path / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
        except OSError:
            continue
        children.setdefault(int(stat[1]), []).append(int(path.name))
    found, todo = [], [parent]
    while todo:
        found += (below := children.get(todo.pop(), []))
        todo += below
    return {pid: words[pid] for pid in found}


def files(folder: Path) -> dict[str, Path]:
    """Files of a project that do not tell of one run alone, by their names."""
    found = [path for part in ("captures", "results") for path in (folder / part).rglob("*") if path.is_file()]
    return {
        str(path.relative_to(folder)): path
        for path in found
        if not set(path.relative_to(folder).parts) & set(OF_A_RUN) and path.suffix != SIDECAR
    }


def differences(one: Path, two: Path) -> list[str]:
    """Names of the files in which two projects differ."""
    first, second = files(one), files(two)
    both = first.keys() & second.keys()
    return sorted(first.keys() ^ second.keys()) + sorted(name for name in both if not alike(first[name], second[name]))


def alike(one: Path, two: Path) -> bool:
    """Whether two files are the same, but for costs and sessions, and for the rounding of a rendered picture."""
    if one.name not in ROUNDING or one.read_bytes() == two.read_bytes():
        return content(one) == content(two)
    first, second = picture(one), picture(two)
    return first.shape == second.shape and bool(np.abs(first - second).max() <= ROUNDING[one.name])


def picture(path: Path) -> NDArray[np.float64]:
    """Values of a rendered picture."""
    if path.suffix == ".exr":
        return np.dstack([plane for _, plane in sorted(read_exr(path).items())]).astype(float)
    return np.asarray(Image.open(path), float)


def content(path: Path) -> bytes:
    """Content of a file without what it says of costs and sessions."""
    data = path.read_bytes()
    if path.suffix == ".json":
        return json.dumps(without_costs(json.loads(data))).encode()
    if path.suffix == ".npz":
        with zipfile.ZipFile(path) as archive:
            names = [name for name in sorted(archive.namelist()) if not COSTS.fullmatch(name.removesuffix(".npy"))]
            return b"".join(archive.read(name) for name in names)
    return data


def without_costs(value: Any) -> Any:
    """Return JSON without the fields of `COSTS`."""
    if isinstance(value, dict):
        return {key: without_costs(part) for key, part in value.items() if not COSTS.fullmatch(key)}
    return [without_costs(part) for part in value] if isinstance(value, list) else value
