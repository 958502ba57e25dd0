"""What is compiled once for an installation, and what of it is no longer used."""

import os
from pathlib import Path

from kinran.run.compile import stale


def written(path: Path, time: int) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.touch()
    os.utime(path, (time, time))
    return path


def test_what_nothing_loads_any_more_is_stale(tmp_path: Path) -> None:
    """Other versions of the solver, what is older than its source, and what has no source; and nothing else."""
    solver, bracket = tmp_path / "fit" / "solver" / "__pycache__", tmp_path / "bracket" / "__pycache__"
    written(solver / "0123" / "solver_77" / "fused.fit_block-307.py311.1.nbc", 10)
    written(solver / "4567" / "solver_77" / "fused.fit_block-307.py311.1.nbc", 10)
    written(solver / "fused.cpython-311.pyc", 10)
    written(bracket.parent / "estimator.py", 20)
    written(bracket / "estimator._ratio_sums-217.py311.nbi", 30)
    written(bracket / "estimator.cpython-311.pyc", 10)
    old = written(bracket / "estimator._kernel.locals.merge-135.py311.1.nbc", 10)
    gone = written(bracket / "sites._fill-36.py311.nbi", 30)
    assert set(stale(tmp_path, "4567")) == {solver / "0123", old, gone}
