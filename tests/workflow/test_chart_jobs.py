"""The chart as jobs: one a kind of method, none of them in a plain run."""

import re
from pathlib import Path

from conftest import ROOT, Project


def planned(project: Project, *options: str) -> dict[str, int]:
    """Number of jobs of each rule."""
    text = project.run(*options, "--dry-run", "--quiet", "rules")
    return {rule: int(count) for rule, count in re.findall(r"^(\w+) +(\d+)$", text, re.MULTILINE)}


def test_a_job_for_each_kind_of_method(project: Project) -> None:
    kinds = list(Path(ROOT / "workflow" / "kinran" / "compare" / "methods").glob("[a-z]*.py"))
    jobs = planned(project, "chart")
    assert jobs["chart_kind"] == len(kinds)
    assert (jobs["chart_default"], jobs["chart_regions"], jobs["chart_fabric"], jobs["charts"]) == (1, 1, 1, 1)
    assert not {"fit", "merge", "capture", "segment"} & set(jobs)


def test_without_the_virtual_rig_no_labels_are_counted(project: Project) -> None:
    project.configure(lambda config: config["rig"].update(device="none"))
    assert "chart_regions" not in planned(project, "chart")


def test_one_table_that_is_gone_is_one_job(project: Project) -> None:
    there = project.folder / "results" / "tiny" / "chart" / "linear.csv"
    there.parent.mkdir()
    there.write_text("method\n")
    jobs = planned(project, "results/tiny/chart.csv")
    kinds = list(Path(ROOT / "workflow" / "kinran" / "compare" / "methods").glob("[a-z]*.py"))
    assert jobs["chart_kind"] == len(kinds) - 1
