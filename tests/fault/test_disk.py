"""A disk that is full, fails or can only be read, and memory that runs out: one sentence, and nothing half written.

The errors are the kernel's own: writing to /dev/full finds no space, and reading /proc/self/mem at 0 fails with EIO.
"""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from kinran.__main__ import main
from kinran.base import page, pictures
from kinran.base.exr import read_exr, write_exr
from kinran.base.files import InputError, atomic, check_comment, read_json, sha256, write_json
from kinran.base.npz import read_npz
from kinran.scene.mesh import write_mesh
from kinran.virtual.scan import write_scan

PICTURE: NDArray[np.float32] = np.random.default_rng(2).random((64, 64)).astype(np.float32)
VERTICES = np.random.default_rng(3).random((3000, 3))
FACES = np.arange(3000).reshape(-1, 3)


def write_npz(path: Path) -> None:
    """As fits write their tiles."""
    with atomic(path) as temporary, temporary.open("wb") as file:
        np.savez(file, allow_pickle=False, a=PICTURE)


def write_html(path: Path) -> None:
    """As a report is written, with much in it."""
    template = path.parents[1] / "template.html"
    template.write_text("x" * 100_000)
    page.write_page(path, template, {})


WRITERS: dict[str, Callable[[Path], Any]] = {
    "a.exr": lambda path: write_exr(path, {"R": PICTURE}),
    "a.json": lambda path: write_json(path, PICTURE.tolist()),
    "a.npz": write_npz,
    "a.png": lambda path: pictures.write_png(path, (255 * PICTURE).astype(np.uint8)),
    "mesh.ply": lambda path: write_mesh(path, VERTICES, FACES, VERTICES[:, :2]),
    "scan.ply": lambda path: write_scan(path, VERTICES, FACES),
    "a.html": write_html,
}


@pytest.mark.parametrize("name", WRITERS)
def test_a_full_disk_is_a_sentence_with_the_name_of_the_file(tmp_path: Path, name: str) -> None:
    """What stood there before stays, and the temporary file is removed."""
    path = tmp_path / "results" / name
    path.parent.mkdir()
    path.write_text("old")
    path.with_name(f".{path.stem}.{os.getpid()}.part{path.suffix}").symlink_to("/dev/full")
    with pytest.raises(InputError, match=rf"{name}: cannot be written: the disk is full \(no space left\); free some"):
        WRITERS[name](path)
    assert [each.name for each in path.parent.iterdir()] == [name]
    assert path.read_text() == "old"


def test_a_disk_that_is_full_of_shards(tmp_path: Path) -> None:
    """A real, small file system, mounted for a process alone."""
    program = (
        "import numpy as np; from pathlib import Path; from kinran.data.radiance import Radiance;"
        "from kinran.data.radiance_stack import write_shards;"
        "v = np.random.default_rng(1).random((8, 128, 128, 3), np.float32);"
        f"write_shards(Path('{tmp_path}/silk.zarr'), 0, Radiance(v, np.zeros(v.shape, np.uint8)))"
    )
    mounted = (
        f'mount -t tmpfs -o size=512k tmpfs {tmp_path} && {sys.executable} -c "{program}"; find {tmp_path} -type f'
    )
    done = in_namespace(mounted)
    assert f"InputError: {tmp_path}/silk.zarr: cannot be written: the disk is full (no space left)" in done.stderr
    assert done.stdout == ""


def test_results_that_can_only_be_read(tmp_path: Path) -> None:
    """A stage says which folder, and does not begin."""
    command = f"{sys.executable} -m kinran scan {tmp_path}/silk/scan.ply"
    done = in_namespace(f"mount --bind {tmp_path} {tmp_path} && mount -o remount,bind,ro {tmp_path} && {command}")
    assert done.stderr.splitlines()[-1].startswith(f"kinran scan: {tmp_path}/silk: cannot be written to (Read-only")
    assert done.returncode == 2


def in_namespace(command: str) -> "subprocess.CompletedProcess[str]":
    """Run a command of the shell that may mount."""
    unshare = ["unshare", "--mount", *([] if os.geteuid() == 0 else ["--map-root-user"])]
    if subprocess.run([*unshare, "true"], capture_output=True, check=False).returncode:
        pytest.skip("no mounts for this user")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    return subprocess.run([*unshare, "sh", "-c", command], capture_output=True, text=True, check=False, env=environment)


@pytest.mark.parametrize("read", [read_json, read_exr, read_npz, check_comment], ids=lambda read: read.__name__)
def test_a_disk_that_fails_is_a_sentence_with_the_name_of_the_file(tmp_path: Path, read: Callable[[Path], Any]) -> None:
    path = tmp_path / "damaged.json"
    path.symlink_to("/proc/self/mem")
    with pytest.raises(InputError, match=r"damaged\.json: (cannot be read|is no)"):
        read(path)


def test_a_digest_names_the_file_of_a_disk_that_fails(tmp_path: Path) -> None:
    """Not as a sentence: the repair of a capture goes on without that file."""
    path = tmp_path / "damaged.json"
    path.symlink_to("/proc/self/mem")
    with pytest.raises(OSError, match="Input/output error") as caught:
        sha256(path)
    assert caught.value.filename == str(path)


def test_memory_that_runs_out_is_a_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    program = (
        "import resource; resource.setrlimit(resource.RLIMIT_AS, (900_000_000,) * 2);"
        "import numpy as np, kinran.virtual.scan as scan; from kinran.__main__ import main;"
        "scan.main = lambda out: np.ones(10**9);"
        "scan.main.__annotations__ = {'out': __import__('typing').Annotated[str, 'OUT', 'file']};"
        "raise SystemExit(main(['scan', 'x']))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    said = "kinran scan: memory has run out; run fewer jobs at once (--cores), or ask for more of it"
    assert (done.returncode, done.stderr.splitlines()) == (2, [said])


def test_an_error_of_the_disk_that_nobody_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """The command's door names the file where the system does."""

    def fail(*_: object) -> None:
        raise OSError(28, "No space left on device", "/data/x")

    monkeypatch.setattr("kinran.virtual.scan.write_scan", fail)
    assert main(["scan", str(tmp_path / "scan.ply")]) == 2
    assert "kinran scan: /data/x: the disk is full (no space left); free some space and run it again" in caplog.text
