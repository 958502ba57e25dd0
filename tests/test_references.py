"""Every key by which code and docs cite has an entry in docs/references.md."""

import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
REFERENCES = ROOT / "docs" / "references.md"
KEY = re.compile(r"\b[A-Z][a-z]+(?:[A-Z][a-z]+)*(?:19|20)\d\d\b")


def entries() -> list[str]:
    return re.findall(r"^\* \*\*(\w+)\*\*", REFERENCES.read_text(), re.MULTILINE)


def test_entries_are_sorted_and_their_keys_of_one_style() -> None:
    assert entries() == sorted(set(entries()))
    assert all(KEY.fullmatch(key) for key in entries())


def test_every_key_has_an_entry() -> None:
    done = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip("not a git checkout")
    known = set(entries())
    files = [ROOT / name for name in done.stdout.split("\0") if re.search(r"[.](py|md|h|cpp|smk|yaml|html)$", name)]
    cited = {key: path.name for path in files if path.is_file() for key in KEY.findall(path.read_text())}
    assert {key: name for key, name in cited.items() if key not in known} == {}
