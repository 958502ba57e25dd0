"""kill -9 in the middle of a merge job: no half shard, and the next run writes what an undisturbed one would have."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from known_scene import Capture

from kinran.__main__ import main

KILLED = """
import os, signal, sys
from pathlib import Path
from kinran.data import radiance_stack as stack
from kinran.__main__ import main

step, calls = sys.argv[1], int(sys.argv[2])
owner, name = (stack.ShardWriter, "add") if step == "add" else (Path, "replace")
real = getattr(owner, name)

def deadly(*args):
    global calls
    calls -= step == "add" or ".part-" not in str(args[1])  # Zarr renames in the scratch folder
    if calls < 0:
        os.kill(os.getpid(), signal.SIGKILL)
    return real(*args)

setattr(owner, name, deadly)
main(sys.argv[3:])
"""
"""A merge job that dies before picture or before renamed file number so many."""


def files(folder: Path) -> dict[str, bytes]:
    """Shards by their names."""
    paths = [path for name in ("radiance", "flags") for path in (folder / name).rglob("*") if path.is_file()]
    return {str(path.relative_to(folder)): path.read_bytes() for path in paths}


@pytest.mark.parametrize(("step", "calls", "left"), [("add", 5, 0), ("replace", 0, 0), ("replace", 1, 1)])
def test_no_half_shard_is_left(capture: Capture, tmp_path: Path, step: str, calls: int, left: int) -> None:
    """Killed while it collects a shard, before the first file is named, and between the two of a shard."""
    calibration = tmp_path / "calibration.json"
    manifests = [str(path) for path in capture.manifests]
    assert main(["calibrate", str(calibration), "--plan", str(capture.plan_path), "--manifests", *manifests]) == 0
    options = ["--plan", str(capture.plan_path), "--calibration", str(calibration)]
    job = ["merge-group", *options, "--manifest", str(capture.manifest("00"))]
    assert main([*job, str(tmp_path / "whole.zarr")]) == 0
    whole = files(tmp_path / "whole.zarr")
    out = tmp_path / "killed.zarr"
    command = [sys.executable, "-c", KILLED, step, str(calls), *job, str(out)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    assert subprocess.run(command, stderr=subprocess.DEVNULL, env=environment).returncode == -signal.SIGKILL
    found = files(out)
    assert len(found) == left
    assert all(whole[name] == content for name, content in found.items())
    assert main([*job, str(out)]) == 0
    assert files(out) == whole
