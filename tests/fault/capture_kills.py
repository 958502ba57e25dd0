"""A campaign of kill -9: hosts are killed before random steps of their captures, one after the other.

Run as a script it starts hosts as forks of itself, which costs a hundredth of a new interpreter: a line of JSON asks
for one, a line answers with its exit code.
"""

import json
import os
import random
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from capture_bench import EXPOSURES, Bench, check, host, serving, small_plan

from kinran.capture.bit_rot import verify
from kinran.capture.journal import JOURNAL, read
from kinran.data.capture_plan import Plan, write_plan

REACH = 60
"""A host is killed before one of so many steps: a bracket has about 40, so that the deaths fall on all of them."""


@dataclass
class Tally:
    """What a campaign did and found.

    Attributes
    ----------
    kills, captures, frames, adopted
        Hosts that were killed, groups that were finished all the same, their frames, and those that were taken from the
        card of a dead host.
    lost
        Frames that the camera took, and that are nowhere any more.
    reshot
        Frames that it took more than were planned.
    left
        Files on the card after the end of a group.
    """

    kills: int = 0
    captures: int = 0
    frames: int = 0
    adopted: int = 0
    lost: int = 0
    reshot: int = 0
    left: int = 0

    def add(self, bench: Bench, plan: Plan) -> None:
        """Count a finished group, after checking that its frames are whole and in their places."""
        taken = check(bench.root, plan, bench.capture(plan, devices=None))
        assert len(taken) == len(set(taken)) == 16 * len(EXPOSURES)
        assert verify(bench.root)[1] == []
        assert not list(bench.root.rglob("*.part"))
        there = {json.loads(path.read_bytes())["number"] for path in bench.root.rglob("*.raw")}
        records, size = read(bench.root / JOURNAL)
        assert size == (bench.root / JOURNAL).stat().st_size
        self.captures += 1
        self.frames += len(taken)
        self.adopted += sum(record["t"] == "frame" and record["how"] == "adopted" for record in records)
        self.lost += len(set(range(len(bench.camera.fired))) - there)
        self.reshot += len(bench.camera.fired) - len(taken)
        self.left += len(bench.camera.card())


def campaign(folder: Path, kills: int, seed: int) -> Tally:
    """Capture a group again and again, until so many hosts are killed."""
    chance, plan, tally = random.Random(seed), small_plan(), Tally()
    with hosts() as run:
        while tally.kills < kills:
            bench = Bench(folder / "silk")
            warm(bench)
            write_plan(bench.root / "plan.json", plan)
            code = -signal.SIGKILL
            while code == -signal.SIGKILL:
                kill_at = chance.randint(1, REACH) if tally.kills < kills else 0
                with serving(bench, str(folder / "socket"), 1):
                    code = run.one(folder / "socket", bench.root, kill_at)
                tally.kills += code == -signal.SIGKILL
            assert code == 0
            tally.add(bench, plan)
            shutil.rmtree(bench.root)
    return tally


def warm(bench: Bench) -> None:
    """Light the lamp an hour before: the hosts would spend most of their time in waiting for it."""
    with bench.devices() as (rig, _):
        rig.hello()
        rig.lamp(True)
    bench.firmware.advance(3600)


class Hosts:
    """The process that starts hosts."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process

    def one(self, address: Path, root: Path, kill_at: int) -> int:
        """Run a host to its end, and return its exit code, as `subprocess.Popen.returncode`."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps([str(address), str(root), kill_at]) + "\n")
        self._process.stdin.flush()
        return int(self._process.stdout.readline())


@contextmanager
def hosts() -> Iterator[Hosts]:
    """Start the process that starts hosts; it ends with the block."""
    command = [sys.executable, __file__]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        yield Hosts(process)


def fork_hosts() -> None:
    """Fork a host for each line, and write its exit code."""
    for text in sys.stdin:
        address, root, kill_at = json.loads(text)
        child = os.fork()
        if not child:
            host(address, Path(root), kill_at)
            os._exit(0)
        print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)


if __name__ == "__main__":
    fork_hosts()
