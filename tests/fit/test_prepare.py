"""The solver is compiled once, by a process of its own, and no process runs what it compiled itself."""

import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

from kinran.fit import solver

Calls = list[list[str]]

EVERYTHING = """
import numpy as np
from dataclasses import replace
from synthetic_texels import grid, radiance, sampled, texels
from kinran.fit import bounded, gauss_newton, samples, slope
from kinran.fit.slope_lobes import Lobes
from kinran.fit.solver import fused, hessian, start, sums, turn

lights = grid(20, 12)
whole = replace(sampled(radiance(*texels(40), lights), lights), bounds=np.full((40, len(lights)), 1e-3, np.float32))
strided, few = whole.of(slice(None, None, 2)), sampled(whole.T[..., ::2], lights[::2])
assert not strided.T.flags.c_contiguous and not few.T.flags.c_contiguous
for some in (whole, strided, few):
    for lobes in (Lobes(), Lobes("gaussian", 2), Lobes("ggx", 1, bent=False)):
        fitted = slope.fit(some, lobes)
        fitted.predict(some.under)
        bounded.refit(fitted, some)
        gauss_newton.covariances(fitted, some)
bounded.as_pair(slope.fit(whole, Lobes()), Lobes("gaussian", 2))
samples.texels_first(np.ones((3, 2, 2, 3), np.float16), np.zeros((3, 2, 2, 3), np.uint8), np.ones(256, np.float32))
called = fused.fit_block, sums.summed, hessian.covariances, start.pair, turn.turn
print([f.__name__ for f in called if f.stats.cache_misses or not f.stats.cache_hits])
"""


def test_no_process_runs_what_it_compiled() -> None:
    """All that a fit calls comes from the cache, whatever the layout of its samples."""
    solver.prepare()
    tests = Path(__file__).parents[1]
    known = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tests.parent), str(tests / "helpers")])}
    done = subprocess.run([sys.executable, "-c", EVERYTHING], env=known, capture_output=True, text=True, check=False)
    assert done.stdout.strip() == "[]", done.stderr


@pytest.fixture
def compiler(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Calls]:
    """A cache that is empty, and a compiler that only takes its time; what it is called with."""

    def install(status: int = 0, folder: Path = tmp_path / "cache") -> Calls:
        calls: Calls = []

        def run(words: list[str], check: bool) -> SimpleNamespace:
            calls.append(words)
            time.sleep(0.2)
            return SimpleNamespace(returncode=status)

        monkeypatch.setattr(solver.config, "CACHE_DIR", str(folder))
        monkeypatch.setattr(solver.subprocess, "run", run)
        return calls

    return install


def prepare() -> None:
    """As another process does."""
    solver.prepare.__wrapped__()


def stamps(folder: Path) -> list[Path]:
    return list(folder.glob("compiled-*"))


def test_a_process_of_its_own_compiles_and_leaves_a_stamp(compiler: Callable[..., Calls], tmp_path: Path) -> None:
    calls = compiler()
    prepare()
    assert calls == [[sys.executable, "-m", "kinran.fit.solver.entries"]]
    assert len(stamps(tmp_path / "cache")) == 1
    prepare()
    assert len(calls) == 1


def test_jobs_that_start_together_compile_once(compiler: Callable[..., Calls]) -> None:
    """Four at a time: three wait for the first, and find its stamp."""
    calls = compiler()
    jobs = [threading.Thread(target=prepare) for _ in range(4)]
    start = time.monotonic()
    for job in jobs:
        job.start()
    for job in jobs:
        job.join()
    assert len(calls) == 1
    assert time.monotonic() - start > 0.2


def test_what_did_not_compile_leaves_no_stamp(compiler: Callable[..., Calls], tmp_path: Path) -> None:
    calls = compiler(status=1)
    prepare()
    assert not stamps(tmp_path / "cache")
    prepare()
    assert len(calls) == 2


def test_another_processor_has_a_stamp_of_its_own(
    compiler: Callable[..., Calls], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nodes of a cluster share the folder, not what is compiled."""
    calls = compiler()
    prepare()
    other = SimpleNamespace(magic_tuple=lambda: ("x86_64", "another", ""))
    monkeypatch.setattr(solver, "cpu_target", SimpleNamespace(target_context=SimpleNamespace(codegen=lambda: other)))
    prepare()
    assert len(calls) == len(stamps(tmp_path / "cache")) == 2


def test_a_cache_that_cannot_be_written_is_no_error(compiler: Callable[..., Calls], tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    calls = compiler(folder=tmp_path / "file" / "cache")
    prepare()
    assert calls == []


def test_a_cache_of_the_users_has_a_folder_for_this_version(tmp_path: Path) -> None:
    """NUMBA_CACHE_DIR outlives versions, and Numba itself would not see that an inlined function has changed."""
    said = "from kinran.fit.solver import config; print(config.CACHE_DIR)"
    done = subprocess.run(
        [sys.executable, "-c", said], env={"NUMBA_CACHE_DIR": str(tmp_path)}, capture_output=True, text=True, check=True
    )
    assert Path(done.stdout.strip()).parent == tmp_path
