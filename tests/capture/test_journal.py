"""The journal: what was written is read, what was torn is cut, what was damaged is refused."""

import errno
import os
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinran.base.files import InputError
from kinran.capture.journal import Journal, line, parse, read

RECORDS = [{"t": "intent", "shot": "t05_p000", "k": i, "name": "金襴"} for i in range(5)]

values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda children: st.lists(children) | st.dictionaries(st.text(), children),
    max_leaves=10,
)


@given(st.dictionaries(st.text(), values))
def test_line_round_trip(record: dict[str, Any]) -> None:
    assert parse(line(record)) == record
    assert line(record).count(b"\n") == 1


@given(st.data())
def test_any_changed_byte_is_found(data: st.DataObject) -> None:
    text = bytearray(line(RECORDS[0]))
    place = data.draw(st.integers(0, len(text) - 1))
    text[place] ^= data.draw(st.integers(1, 255))
    assert parse(bytes(text)) is None


def test_append_and_read(tmp_path: Path) -> None:
    path = tmp_path / "a" / "journal.jsonl"
    with Journal(path) as journal:
        journal.append(RECORDS[0])
        journal.append(*RECORDS[1:])
    with Journal(path) as journal:
        assert journal.records == RECORDS
        assert journal.torn == 0


@pytest.mark.parametrize("cut", [1, 5, 20, len(line(RECORDS[4])) - 1])
def test_a_torn_tail_is_cut_before_the_next_record(tmp_path: Path, cut: int) -> None:
    path = tmp_path / "journal.jsonl"
    with Journal(path) as journal:
        journal.append(*RECORDS)
    os.truncate(path, path.stat().st_size - cut)
    with Journal(path) as journal:
        assert journal.records == RECORDS[:4]
        assert journal.torn == len(line(RECORDS[4])) - cut
        journal.append(RECORDS[0])
    assert read(path) == ([*RECORDS[:4], RECORDS[0]], path.stat().st_size)


@pytest.mark.parametrize("tail", [b"\0" * 4096, line(RECORDS[1])[:20] + b"\0" * 9])
def test_a_tail_of_nuls_is_cut(tmp_path: Path, tail: bytes) -> None:
    """A file system that lost its power leaves it."""
    path = tmp_path / "journal.jsonl"
    path.write_bytes(line(RECORDS[0]) + tail)
    with Journal(path) as journal:
        assert journal.records == RECORDS[:1]
        assert journal.torn == len(tail)
        journal.append(RECORDS[1])
    assert read(path)[0] == RECORDS[:2]


@pytest.mark.parametrize("tail", [b"noise\n", line(RECORDS[1])[:-1] + b"\r\n", b"\0\0\xff", b" 00000000\n"])
def test_more_than_one_torn_line_is_never_cut(tmp_path: Path, tail: bytes) -> None:
    """A line that has its end was whole once."""
    path = tmp_path / "silk" / "journal.jsonl"
    path.parent.mkdir()
    path.write_bytes(line(RECORDS[0]) + tail)
    with pytest.raises(InputError, match=r"line 2 is damaged; run `kinran rig repair silk`"):
        Journal(path)
    assert path.read_bytes() == line(RECORDS[0]) + tail


def test_damage_before_sound_records_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    text = bytearray(b"".join(line(record) for record in RECORDS))
    text[len(line(RECORDS[0])) + 3] ^= 1
    path.write_bytes(text)
    with pytest.raises(InputError, match="line 2 is damaged"):
        Journal(path)
    assert path.read_bytes() == bytes(text)


def test_two_processes(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    with Journal(path), pytest.raises(InputError, match="another capture"):
        Journal(path)
    with Journal(path):
        pass


def test_a_full_disk_leaves_no_half_record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "journal.jsonl"
    real = os.write

    def full(file: int, data: bytes) -> int:
        if len(data) < 20:
            raise OSError(errno.ENOSPC, "No space left on device")
        return real(file, data[: len(data) - 10])

    with Journal(path) as journal:
        journal.append(RECORDS[0])
        monkeypatch.setattr(os, "write", full)
        with pytest.raises(OSError, match="No space"):
            journal.append(*RECORDS[1:])
        monkeypatch.undo()
        assert journal.records == RECORDS[:1]
    assert read(path) == (RECORDS[:1], path.stat().st_size)


def test_a_folder_that_cannot_be(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written to"):
        Journal(tmp_path / "file" / "journal.jsonl")
