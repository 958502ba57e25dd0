"""Results shared between runs: what is taken, what is made anew, and what happens to a folder that is in trouble."""

import errno
import logging
import os
import subprocess
import sys
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinran.base import shared_results
from kinran.base.shared_results import key, made

CODE = "kinran.base.frames"
PARTS = {"whole/part": b"a result" * 40, "other": b""}
VALUE = {"gain": 0.1 + 0.2, "of": ["b", "a"]}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The shared folder."""
    folder = tmp_path / "shared"
    folder.mkdir()
    monkeypatch.setenv("KINRAN_CACHE", str(folder))
    monkeypatch.setattr(shared_results, "_said", set())
    return folder


def use(to: Path, follows: Any = 1, while_made: Callable[[], object] = lambda: None) -> bool:
    """Whether a result had to be made in a folder; it is right in any case."""
    calls = []

    def make() -> dict[str, Any]:
        calls.append(1)
        while_made()
        for name, content in PARTS.items():
            (to / name).parent.mkdir(parents=True, exist_ok=True)
            (to / name).write_bytes(content)
        return VALUE

    assert made("a result", CODE, lambda: follows, {name: to / name for name in PARTS}, make) == VALUE
    assert {name: (to / name).read_bytes() for name in PARTS} == PARTS
    assert {path.name for path in to.iterdir()} == {"whole", "other"}
    return bool(calls)


def test_nothing_is_shared_unasked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("KINRAN_CACHE", raising=False)
    assert use(tmp_path / "a")
    assert use(tmp_path / "b")


def test_what_one_made_the_other_takes(folder: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO)
    assert use(tmp_path / "a")
    assert not caplog.messages
    assert not use(tmp_path / "b")
    (entry,) = folder.iterdir()
    assert entry.name == f"frames-{key(CODE, 1)}.zip"
    assert caplog.messages == [f"a result: taken from the cache, {entry}"]
    assert use(tmp_path / "c", follows=2)


@dataclass(frozen=True)
class Options:
    """Some options."""

    size: float = 1.5
    names: tuple[str, ...] = ("a", "bc")


def test_each_part_of_what_it_follows_from_counts() -> None:
    one = np.arange(6, dtype=np.float32)
    flipped = one.copy()
    flipped.view(np.uint32)[3] ^= 1
    values = [
        *(one, flipped, one.view(np.int32), one.reshape(2, 3), one.reshape(3, 2), one[:0], one[::2], one.tolist()),
        *(None, "None", True, 1, 1.0, "1", {"a": 1}, {"b": 1}, {}, []),
        *([1, [2]], [[1], 2], [1, 2], [1, 23], [12, 3], ["12"], ["1", "2"]),
        *(Options(), Options(2.5), Options(names=("ab", "c")), [Options(), None], 0.1 + 0.2, 0.3),
    ]
    assert len({key(CODE, value) for value in values}) == len(values)
    assert key(CODE, (one[::2], Options())) == key(CODE, [one[::2].copy(), {"names": ["a", "bc"], "size": 1.5}])
    with pytest.raises(TypeError, match="Path: has no content"):
        key(CODE, [Path("a")])


def test_code_packages_and_processor_count(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "requirements.txt").write_text("numpy==3\n")
    keys = {key(CODE, 1), key("kinran.base.distances", 1)}
    with monkeypatch.context() as patch:
        patch.setattr(shared_results, "digest", lambda module: "other")
        keys.add(key(CODE, 1))
    for name, value in {
        "ROOT": tmp_path,
        "platform.machine": lambda: "riscv64",
        "sys.version_info": type("V", (), {"major": 3, "minor": 99}),
    }.items():
        with monkeypatch.context() as patch:
            patch.setattr(f"kinran.base.shared_results.{name}", value)
            shared_results.environment.cache_clear()
            keys.add(key(CODE, 1))
    shared_results.environment.cache_clear()
    assert len(keys) == 6
    assert key(CODE, 1) in keys


def test_a_flipped_bit_is_never_taken(folder: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """In each byte of an entry: the result is made anew, or was not touched."""
    use(tmp_path / "a")
    (entry,) = folder.iterdir()
    sound, anew = entry.read_bytes(), 0
    for k in range(len(sound)):
        entry.write_bytes(sound[:k] + bytes([sound[k] ^ 1 << k % 8]) + sound[k + 1 :])
        anew += use(tmp_path / "b")
    assert anew > 0.8 * len(sound)  # the rest are dates and rights that nobody reads
    assert f"{entry}: is damaged" in caplog.text
    assert not use(tmp_path / "c")  # the last one took its place


@pytest.mark.parametrize("left", [0, 100, -1])
def test_a_cut_entry_is_made_anew(folder: Path, tmp_path: Path, left: int) -> None:
    use(tmp_path / "a")
    (entry,) = folder.iterdir()
    entry.write_bytes(entry.read_bytes()[:left])
    assert use(tmp_path / "b")
    assert not use(tmp_path / "b")


def test_another_result_under_its_name_is_not_taken(folder: Path, tmp_path: Path) -> None:
    """A sound ZIP, of which one part is another than its index says."""
    use(tmp_path / "a")
    (entry,) = folder.iterdir()
    with zipfile.ZipFile(entry) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(entry, "w") as archive:
        for name, content in parts.items():
            archive.writestr(name, content.replace(b"a result", b"A result"))
    assert use(tmp_path / "b")


def test_what_fails_is_not_shared(folder: Path, tmp_path: Path) -> None:
    def fail() -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        use(tmp_path / "a", while_made=fail)
    assert list(folder.iterdir()) == []


def test_two_at_once_are_both_right(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The second begins while the first one makes it, or writes it to the folder, and is done before it."""
    assert use(tmp_path / "a", while_made=lambda: use(tmp_path / "b"))
    write, inside = zipfile.ZipFile.write, []

    def slow(archive: zipfile.ZipFile, *part: Any) -> None:
        if not inside:
            inside.append(1)
            assert use(tmp_path / "d", follows=2)
        write(archive, *part)

    monkeypatch.setattr(zipfile.ZipFile, "write", slow)
    assert use(tmp_path / "c", follows=2)
    assert len(list(folder.iterdir())) == 2
    assert not use(tmp_path / "e")
    assert not use(tmp_path / "f", follows=2)


KILLED = """
import os, sys, zipfile
from pathlib import Path
from kinran.base.shared_results import made
path = Path(sys.argv[1])
zipfile.ZipFile.writestr = lambda *part: os._exit(9)
made("a result", "kinran.base.frames", lambda: 1, {"other": path}, lambda: path.write_bytes(b"half") and None)
"""


def test_a_killed_writer_leaves_nothing_to_take(folder: Path, tmp_path: Path) -> None:
    done = subprocess.run([sys.executable, "-c", KILLED, str(tmp_path / "x")], check=False)
    assert done.returncode == 9
    assert [path.suffix for path in folder.iterdir()] == [".part"]
    assert use(tmp_path / "a")
    assert not use(tmp_path / "b")


@pytest.mark.parametrize("folder", ["/proc/self", "/nowhere/at/all"])
def test_a_folder_that_cannot_be_written_fails_nothing(
    folder: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Nobody can write to /proc/self. It is said once."""
    monkeypatch.setenv("KINRAN_CACHE", folder)
    monkeypatch.setattr(shared_results, "_said", set())
    assert use(tmp_path / "a")
    assert use(tmp_path / "b")
    (message,) = caplog.messages
    assert folder in message


def test_a_full_disk_fails_nothing(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def full(*part: Any) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(zipfile.ZipFile, "write", full)
    assert use(tmp_path / "a")
    assert list(folder.iterdir()) == []
    assert caplog.messages == [f"{folder}: cannot be written to (No space left on device); nothing new is shared"]


def test_an_output_folder_in_trouble_damages_no_entry(folder: Path, tmp_path: Path) -> None:
    """An error on the way out is no fault of the entry, which stays."""
    use(tmp_path / "a")
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "other").mkdir()
    with pytest.raises(IsADirectoryError):
        made("a result", CODE, lambda: 1, {"other": tmp_path / "b" / "other"}, lambda: VALUE)
    assert not use(tmp_path / "c")


@pytest.mark.parametrize(("of_folder", "of_entry"), [(0o770, 0o660), (0o755, 0o644), (0o700, 0o600)])
def test_the_folder_says_who_shares(folder: Path, tmp_path: Path, of_folder: int, of_entry: int) -> None:
    """By the umask of many clusters none but its writer could read an entry, or say that it is in use."""
    folder.chmod(of_folder)
    before = os.umask(0o077)
    try:
        use(tmp_path / "a")
    finally:
        os.umask(before)
    (entry,) = folder.iterdir()
    assert entry.stat().st_mode & 0o777 == of_entry


def test_what_is_in_use_is_not_pruned(folder: Path, tmp_path: Path) -> None:
    """By the line of docs/workflow.md."""
    use(tmp_path / "a", follows=1)
    use(tmp_path / "a", follows=2)
    (folder / ".killed.part").write_bytes(b"half")
    for path in folder.iterdir():
        os.utime(path, (0, 0))
    assert not use(tmp_path / "b", follows=2)
    subprocess.run('find "$KINRAN_CACHE" -type f -mtime +90 -delete', shell=True, check=True)
    assert [path.name for path in folder.iterdir()] == [f"frames-{key(CODE, 2)}.zip"]
