"""kill -9 at every step of a capture: nothing is lost, nothing is shot twice."""

import signal
import subprocess
import sys
from pathlib import Path

from capture_bench import EXPOSURES, Bench, check, serving, small_plan
from capture_kills import campaign

from kinran.capture.journal import read
from kinran.data.capture_plan import write_plan

STEPS = 40
KILLS = 100


def test_killed_a_hundred_times(tmp_path: Path) -> None:
    """At random steps; `kinran bench rig-kills` does it for longer."""
    tally = campaign(tmp_path, KILLS, seed=12)
    assert (tally.lost, tally.reshot, tally.left) == (0, 0, 0)
    assert tally.kills == KILLS
    assert tally.adopted >= KILLS // 2


def test_killed_at_every_step(tmp_path: Path) -> None:
    """Host number k is killed before its k-th step, so that the deaths fall on all phases of a bracket."""
    plan = small_plan()
    bench = Bench(tmp_path)
    write_plan(tmp_path / "plan.json", plan)
    address = str(tmp_path / "socket")
    script = Path(__file__).with_name("capture_bench.py")
    codes = []
    with serving(bench, address, STEPS + 1):
        for kill_at in [*range(1, STEPS + 1), 0]:
            command = [sys.executable, str(script), address, str(tmp_path), str(kill_at)]
            codes.append(subprocess.run(command, stdout=subprocess.DEVNULL, timeout=120).returncode)
    assert codes == [-signal.SIGKILL] * STEPS + [0]

    manifest = bench.capture(plan, devices=None)
    numbers = check(tmp_path, plan, manifest)
    shots = len(manifest["shots"])
    assert shots == 16
    assert sorted(numbers) == list(range(len(numbers)))
    assert len(numbers) == shots * len(EXPOSURES) == len(bench.camera.fired)
    assert bench.camera.card() == []
    assert not (tmp_path / "quarantine").exists()
    assert not list(tmp_path.rglob("*.part"))
    records, size = read(tmp_path / "journal.jsonl")
    assert size == (tmp_path / "journal.jsonl").stat().st_size
    assert sum(record["t"] == "frame" and record["how"] == "adopted" for record in records) >= 3
    assert len(bench.firmware.jobs_done) < 400
