"""Flipped bits in the files of a run: none is silent."""

from pathlib import Path

import pytest
from small_run import write_run

from benchmarks import flips
from kinran.base.files import InputError


def test_no_flipped_bit_is_silent(tmp_path: Path) -> None:
    """Twenty in each kind of file; of those in frames, `kinran verify` sees what the merge does not."""
    write_run(tmp_path)
    counts, silent = flips.campaign(tmp_path, 140, seed=5)
    print("\n" + flips.table(counts))
    assert silent == []
    assert {name: sum(row.values()) for name, row in counts.items()} == dict.fromkeys(flips.READERS, 20)
    for name in ("stack", "material", "labels", "maps", "json", "meshes"):
        assert counts[name]["named"] >= 15, name
        assert counts[name]["named"] + counts[name]["harmless"] == 20
    assert counts["frames"]["named"] + counts["frames"]["verify"] + counts["frames"]["harmless"] == 20


def test_each_outcome_is_told_from_the_others(tmp_path: Path) -> None:
    """The bit is put back, whatever comes of it."""

    def refuse(path: Path) -> str:
        raise InputError(f"{path.name if path.read_bytes() == b'c' else path}: is damaged")

    path = tmp_path / "a"
    path.write_bytes(b"b")
    assert flips.flip(path, 0, Path.read_bytes, b"b'b'") == "silent"
    assert flips.flip(path, 0, lambda path: path.read_bytes().upper()[:0], b"b''") == "harmless"
    assert flips.flip(path, 1, refuse, b"") == "named"
    assert flips.flip(path, 0, refuse, b"") == "unnamed"
    assert path.read_bytes() == b"b"
    with pytest.raises(InputError, match="has no files of stack"):
        flips.campaign(tmp_path, 7, seed=0)
