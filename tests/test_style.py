"""What a reader cannot check by eye: style, types, and that nothing names one machine or an address."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


def run(*command: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run([sys.executable, "-m", *command], cwd=ROOT, capture_output=True, text=True, check=False)


@pytest.mark.parametrize(
    "command",
    [
        ("ruff", "check", "."),
        ("ruff", "format", "--check", "."),
        ("mypy", "workflow/kinran", "plugins/kinran_bsdf", "benchmarks", "examples"),
        ("snakefmt", "--check", "Snakefile", "workflow"),
    ],
    ids=lambda command: " ".join(command[:2]),
)
def test_tool_is_content(command: tuple[str, ...]) -> None:
    done = run(*command)
    assert done.returncode == 0, done.stdout + done.stderr


def test_snakemake_lint() -> None:
    done = run("snakemake", "--lint")
    assert done.returncode == 0, done.stdout + done.stderr


def tracked() -> list[Path]:
    done = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip("not a git checkout")
    return [ROOT / name for name in done.stdout.split("\0") if name and (ROOT / name).is_file()]


def test_no_large_files() -> None:
    assert [path.name for path in tracked() if path.stat().st_size > 1_000_000] == []


def test_requirements_are_pinned_with_hashes_and_no_address() -> None:
    for name in ("requirements.txt", "requirements-uv.txt"):
        text = (ROOT / name).read_text()
        assert "://" not in text
        assert "index-url" not in text
        names = re.findall(r"^[A-Za-z0-9][^\n]*", text, re.MULTILINE)
        assert names
        assert all("==" in line and line.rstrip().endswith("\\") for line in names)


def test_modules_stay_short() -> None:
    long = [p.name for p in (ROOT / "workflow" / "kinran").rglob("*.py") if len(p.read_text().splitlines()) > 420]
    assert long == []
