"""Two fabrics through a real SLURM, of one machine: `./kinran test slurm`.

A virtual fabric and a set of photographs go to their reports twice: locally, and through the scheduler, where the
controlling process, a job and a whole node are killed on the way. Both must give the same bytes.
"""

import hashlib
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenEXR
import yaml
from cluster import Cluster, missing
from numpy.typing import NDArray
from PIL import Image

from kinran.base.project import ROOT

CORES = 4
"""Cores of a virtual node."""
LONGEST_RUN_S = 1800
"""Longest time of a run, in seconds; on two cores with a load of 25 it took 22 minutes."""
MOST_SUBMISSIONS = 12
"""Most submissions for a fabric."""
COSTS = re.compile(r'"(?:[a-z_]*seconds[a-z_]*|peak_mb)": [^,}\n]*')
"""Fields of JSON that say what a job cost, which no two runs share."""
PAGES = ("report.html",)
"""Files that print and draw these costs: all else in them comes from files that are compared."""
ROUNDING = {"render.exr": 1e-6, "render.png": 1, "sweep.png": 1}
"""Largest difference of rendered pictures, in their values: threads add samples in another order each time, and two
local renders of one scene differ by 1e-7 too."""


class SetUpError(Exception):
    """Lack of something that the suite needs on its machine."""


class Checks:
    """What was found, one line each."""

    def __init__(self) -> None:
        self.start = time.monotonic()
        self.passed = self.failed = 0

    def check(self, holds: bool, claim: str, found: object = "") -> None:
        """Note whether a claim holds, and what was found."""
        self.passed, self.failed = self.passed + holds, self.failed + (not holds)
        self.say(f"{'ok    ' if holds else 'FAILED'}  {claim}{f': {found}' if str(found) else ''}")

    def say(self, words: str) -> None:
        """Print words with the seconds since the start."""
        print(f"{time.monotonic() - self.start:6.0f} s  {words}", flush=True)


def main() -> int:
    """Run the suite; returns the exit status."""
    checks = Checks()
    with tempfile.TemporaryDirectory(prefix="kinran-slurm.") as name:
        folder = Path(name)
        try:
            site = set_up(folder)
        except SetUpError as error:
            print(f"kinran test slurm: {error}", file=sys.stderr)
            return 2
        checks.say("set up: packages of Debian, and the executor of requirements-slurm.txt")
        local = project(folder / "local")
        run(local, os.environ, "--cores", "2")
        checks.check(finished(local), "a local run makes both reports")
        (folder / "cluster").mkdir()
        try:
            with Cluster(folder / "cluster", cores=CORES) as cluster:
                cluster.environment["PYTHONPATH"] = str(site)
                checks.say(f"SLURM is up: {' '.join(cluster.idle_nodes())}")
                through_slurm(cluster, folder, checks)
                on_one_node(cluster, folder, checks)
                through_any_scheduler(cluster, folder, checks)
        except (RuntimeError, subprocess.TimeoutExpired) as error:
            checks.check(False, "the suite comes to its end", error)
        left = [int(entry.name) for entry in Path("/proc").iterdir() if entry.name.isdigit() and mentions(entry, name)]
        checks.check(not left, "no process is left", left or "")
    print(f"{checks.passed} passed, {checks.failed} failed")
    return int(checks.failed > 0)


def set_up(folder: Path) -> Path:
    """Install what is missing; return the folder with the executors, apart from .venv, where they slow each start.

    Raises
    ------
    SetUpError
        It cannot be installed.
    """
    if os.getuid() != 0:
        raise SetUpError("daemons of SLURM switch users; run it as root")
    if packages := missing():
        command = ["apt-get", "install", "-y", "-qq", "--no-install-recommends", *packages]
        quiet = {**os.environ, "DEBIAN_FRONTEND": "noninteractive", "RUNLEVEL": "1"}
        for words in (["apt-get", "update", "-qq"], command):
            if shutil.which("apt-get"):
                subprocess.run(words, env=quiet, stdout=subprocess.DEVNULL, check=False)
        if missing():
            raise SetUpError(
                f"needs {', '.join(missing())}: apt-get install --no-install-recommends {' '.join(packages)}"
            )
    site = folder / "site"
    command = [str(Path(sys.executable).parent / "uv"), "pip", "install", "--quiet", "--require-hashes", "--no-deps"]
    file = ROOT / "requirements-slurm.txt"
    if subprocess.run([*command, "--target", str(site), "-r", str(file)], check=False).returncode:
        raise SetUpError(f"could not install {file.name}; the message above says why")
    return site


def project(folder: Path) -> Path:
    """Write a project with a virtual fabric and a set of photographs."""
    config = yaml.safe_load((ROOT / "config.yaml").read_text())
    config["rig"].update(thetas=[0, 20, 40, 60, 80], phis=8)
    config["virtual"].update(texels=16, samples=1)
    config["fit"].update(compare=[])
    template = (ROOT / config["scene"]["template"]).read_text()
    for name, value in {"width": "64", "height": "48", "spp": "2"}.items():
        template = re.sub(rf'(<default name="{name}" value=)"[0-9]+"', rf'\1"{value}"', template)
    config["scene"]["template"] = "small.xml"
    (folder / "config").mkdir(parents=True)
    (folder / "small.xml").write_text(template)
    (folder / "config.yaml").write_text(yaml.safe_dump(config))
    photographs(folder / "photographs")
    rows = [
        "fabric\tsource\tencoding\tcrop\tregions\tseeds",
        "woven\trig\t\t\t2\t",
        "photographed\tphotographs\tsrgb\t\t2\t",
    ]
    (folder / "config" / "fabrics.tsv").write_text("\n".join(rows) + "\n")
    (folder / "config" / "recapture.tsv").write_text("fabric\ttheta\tphi\trevision\treason\n")
    return folder


def photographs(folder: Path, side: int = 24, count: int = 20) -> None:
    """Write photographs of two kinds of thread, rounded and shiny, under lights on a spiral."""
    folder.mkdir()
    z = 0.3 + 0.65 * (np.arange(count) + 0.5) / count
    turn = np.arange(count) * np.pi * (3 - 5**0.5)
    lights = np.stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z], 1)
    row, column = np.mgrid[:side, :side]
    gold = (row // 6 + column // 6) % 2 == 0
    slope = 0.3 * np.sin(2 * np.pi * column / 6)
    normals = np.stack([-slope, 0 * slope, np.ones_like(slope)], -1) / np.hypot(1, slope)[..., None]
    colour = np.where(gold[..., None], [0.6, 0.45, 0.12], [0.3, 0.05, 0.1])
    for k, light in enumerate(lights):
        half = light + np.array([0, 0, 1])
        towards = np.clip(normals @ (half / np.linalg.norm(half)), 0, 1)
        lobe = np.where(gold, 0.8, 0.1) * np.exp((towards - 1) / 0.02)
        value = colour * (0.5 * np.clip(normals @ light, 0, 1) + lobe)[..., None]
        Image.fromarray((np.clip(value, 0, 1) ** (1 / 2.2) * 255).round().astype(np.uint8)).save(
            folder / f"p{k:02d}.png"
        )
    lines = [f"p{k:02d}.png {x:.6f} {y:.6f} {z:.6f}" for k, (x, y, z) in enumerate(lights)]
    (folder / "lights.lp").write_text("\n".join([str(count), *lines]) + "\n")


def through_slurm(cluster: Cluster, folder: Path, checks: Checks) -> None:
    """Both fabrics, with everything killed once that can be."""
    work = project(folder / "slurm")
    profile = "--profile", str(ROOT / "profiles" / "slurm")
    options = *profile, "--cores", str(CORES)
    first = start(work, cluster.environment, *options)
    until(lambda: len(cluster.jobs()) > 0, first)
    os.killpg(first.pid, signal.SIGKILL)
    first.wait()
    checks.say(f"killed the controlling process; jobs that run on: {' '.join(cluster.jobs())}")
    # what docs/cluster.md says after a crash
    names = cluster.command("squeue", "-h", "-o", "%i %j").splitlines()
    cluster.command("scancel", *(row.split()[0] for row in names if row.split()[1].startswith("kinran")))
    until(lambda: not cluster.command("squeue", "-h").strip())

    before = len(cluster.log())
    second = start(work, cluster.environment, *options)
    killed = until(lambda: next((job for job in cluster.jobs() if cluster.kill_job(job)), None), second)
    checks.say(f"killed -9 the stage of job {killed}")
    job, node = until(lambda: next(((j, n) for j, n in cluster.jobs().items() if j != killed), None), second)
    checks.say(f"crashed node {node} under job {job}: {cluster.crash_node(node)} processes killed")
    until(lambda: second.poll() is not None)
    checks.check(second.returncode == 0 and finished(work), "the run finishes by itself", f"exit {second.returncode}")
    states = {row_of(line)["JobId"]: row_of(line)["JobState"] for line in cluster.log()[before:]}
    gone = ("FAILED", "NODE_FAIL")  # the node that crashes next may be its own
    checks.check(states.get(killed) in gone, "the killed job failed", states.get(killed))
    checks.check(states.get(job) == "NODE_FAIL", "the job of the crashed node failed", states.get(job))
    if states.get(job) != "NODE_FAIL" or second.returncode:
        print(tail(work / "run.log"), flush=True)
    done = [state for state in states.values() if state == "COMPLETED"]
    checks.check(
        len(done) <= 2 * MOST_SUBMISSIONS, f"at most {MOST_SUBMISSIONS} submissions a fabric", f"{len(done)} for 2"
    )
    same(folder / "local", work, checks)
    again = run(work, cluster.environment, "--dry-run", *profile)
    checks.check("Nothing to be done" in again, "nothing is left to do")
    checks.check("missing provenance" not in again, "Snakemake knows where all of it came from")
    cluster.start_node(node)
    until(lambda: node in cluster.idle_nodes())
    checks.say(f"{node} is back")


def on_one_node(cluster: Cluster, folder: Path, checks: Checks) -> None:
    """A fabric whose files are copied to a node and back, by the script that docs/cluster.md names."""
    work = project(folder / "copied")
    script = ROOT / "profiles" / "slurm" / "on_one_node.sh"
    words = [
        "sbatch",
        "--wait",
        "--chdir",
        str(work),
        "--cpus-per-task",
        "2",
        "--mem",
        "3000",
        "--output",
        "copied.log",
    ]
    done = subprocess.run(
        [*words, str(script), str(ROOT), "photographed"], env=cluster.environment, check=False, timeout=LONGEST_RUN_S
    )
    checks.check(done.returncode == 0, "a fabric is made on a node's own disk", f"exit {done.returncode}")
    if done.returncode:
        print(tail(work / "copied.log"), flush=True)
    same(folder / "local", work, checks, "photographed")
    again = run(work, cluster.environment, "--dry-run", "--cores", "1", "results/photographed/report.html")
    checks.check("Nothing to be done" in again, "what came back is up to date")


def through_any_scheduler(cluster: Cluster, folder: Path, checks: Checks) -> None:
    """A fabric by the profile for other schedulers, whose commands are those of SLURM here."""
    work = project(folder / "generic")
    options = "--profile", str(ROOT / "profiles" / "generic"), "--cores", str(CORES)
    run(work, cluster.environment, *options, "results/photographed/labels.exr")
    labels = [digest(folder / name / "results" / "photographed" / "labels.exr") for name in ("local", "generic")]
    checks.check(labels[0] == labels[1], "profiles/generic makes the labels of a local run")


def run(work: Path, environment: "os._Environ[str] | dict[str, str]", *options: str) -> str:
    """Run Snakemake to its end, and return what it says."""
    process = start(work, environment, *options)
    until(lambda: process.poll() is not None)
    text = (work / "run.log").read_text()
    if process.returncode:
        raise RuntimeError(f"{' '.join(options)}: exit {process.returncode}\n{tail(work / 'run.log')}")
    return text


def start(work: Path, environment: "os._Environ[str] | dict[str, str]", *options: str) -> "subprocess.Popen[bytes]":
    """Start Snakemake in a process group of its own, with its words in run.log."""
    command = [sys.executable, "-m", "snakemake", "-s", str(ROOT / "Snakefile"), "-d", str(work), *options]
    with (work / "run.log").open("wb") as log:
        return subprocess.Popen(
            command, env=dict(environment), stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True
        )


def until(found: Callable[[], object], running: "subprocess.Popen[bytes] | None" = None):
    """Wait for something and return it.

    Raises
    ------
    RuntimeError
        The time is up, or a process that should run on has ended.
    """
    end = time.monotonic() + LONGEST_RUN_S
    while not (value := found()):
        if running is not None and running.poll() is not None:
            raise RuntimeError(f"the run ended too early, with {running.returncode}")
        if time.monotonic() > end:
            raise RuntimeError(f"nothing happened within {LONGEST_RUN_S} s")
        time.sleep(0.2)
    return value


def finished(work: Path) -> bool:
    """Whether both fabrics have their reports, and the overview names them."""
    pages = [work / "results" / name / "report.html" for name in ("woven", "photographed")]
    return all(page.is_file() for page in [*pages, work / "results" / "report.html"])


def same(local: Path, work: Path, checks: Checks, fabric: str = "") -> None:
    """Check that both runs made the same files, but for what they say of their costs."""
    one, two = (files(folder / "results" / fabric) for folder in (local, work))
    differ = sorted(one.keys() ^ two.keys()) + sorted(
        name for name in one.keys() & two.keys() if not alike(one[name], two[name])
    )
    claim = f"the bytes of a local run, in {len(one)} files{f' of {fabric}' if fabric else ''}"
    checks.check(len(one) > 10 and not differ, claim, ", ".join(differ))


def files(results: Path) -> dict[str, Path]:
    """Files of a run by their names, without benchmarks."""
    found = [path for path in results.rglob("*") if path.is_file() and not is_cost(path)]
    return {str(path.relative_to(results)): path for path in found}


def alike(one: Path, two: Path) -> bool:
    """Whether two files are the same, but for costs and for the rounding of a rendered picture."""
    if one.name in PAGES or digest(one) == digest(two):
        return True
    if one.name not in ROUNDING:
        return False
    first, second = picture(one), picture(two)
    return first.shape == second.shape and bool(np.abs(first - second).max() <= ROUNDING[one.name])


def picture(path: Path) -> NDArray[np.float64]:
    """Values of a rendered picture, (y, x, channel)."""
    if path.suffix == ".exr":
        channels = OpenEXR.File(str(path)).channels()
        return np.dstack([channels[name].pixels for name in sorted(channels)]).astype(float)
    return np.asarray(Image.open(path), float)


def is_cost(path: Path) -> bool:
    """Whether a file holds nothing but what a job cost."""
    return "benchmarks" in path.parts or path.suffix == ".tsv"


def digest(path: Path) -> str:
    """Digest of a file; of JSON, without costs, and without the checksum at its end, which is over them, too."""
    content = path.read_bytes()
    if path.suffix == ".json":
        content = COSTS.sub("", content.decode()).rstrip().encode()
    return hashlib.sha256(content).hexdigest()


def row_of(line: str) -> dict[str, str]:
    """Fields of a line that SLURM writes of a job that ended."""
    return dict(word.split("=", 1) for word in line.split() if "=" in word)


def mentions(process: Path, folder: str) -> bool:
    """Whether a process runs something in a folder."""
    try:
        return int(process.name) != os.getpid() and folder.encode() in (process / "cmdline").read_bytes()
    except OSError:
        return False


def tail(path: Path) -> str:
    """Return the end of a log."""
    return path.read_text(errors="replace")[-4000:] if path.exists() else f"{path} is missing"


if __name__ == "__main__":
    sys.exit(main())
