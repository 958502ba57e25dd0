"""What `kinran compile` has compiled is all that stages run; `tests/fit/test_prepare.py` holds that of the solver."""

import subprocess
import sys

from conftest import Project

MERGE = """
from kinran.__main__ import main
from kinran.bracket import entries, estimator, superpixels

entries.compile_all(5)
called = [estimator._kernel(5), estimator._ratio_sums, superpixels.combine, superpixels.fill]
compiled = [f.signatures for f in called]
plan, calibration = ["--plan", "captures/tiny/plan.json"], "results/tiny/calibration.json"
manifest = "captures/tiny/groups/{}.json".format
main(["calibrate", "again.json", *plan, "--manifests", manifest("calibration")])
inputs = [*plan, "--calibration", calibration, "--manifest", manifest("00")]
main(["merge-group", *inputs, "--receipt", "00.json", "s.zarr"])
print([f.__name__ for f, known in zip(called, compiled) if f.signatures != known or not f.stats.cache_hits])
"""


def test_a_merge_compiles_nothing(project: Project) -> None:
    subprocess.run([sys.executable, "-m", "kinran.bracket.entries", "5"], check=True)
    done = subprocess.run(
        [sys.executable, "-c", MERGE], cwd=project.folder, capture_output=True, text=True, check=False
    )
    assert (project.folder / "00.json").is_file(), done.stderr
    assert done.stdout.splitlines()[-1] == "[]", done.stderr
