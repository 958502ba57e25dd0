"""Snakemake looks at its jobs when one of them ends, and not ever more often."""

from pathlib import Path
from types import SimpleNamespace

from snakemake.settings.types import MaxJobsPerTimespan, SchedulingSettings

from kinran.run import owner


def test_a_workflow_is_executed_without_a_limit_of_jobs_a_second(tmp_path: Path) -> None:
    """The limit is set after the rules are read: it is gone when the scheduler is made."""
    seen = []
    workflow = SimpleNamespace(
        is_main_process=True,
        scheduling_settings=None,
        execution_settings=SimpleNamespace(lock=False),
        execute=lambda **options: seen.append(workflow.scheduling_settings.max_jobs_per_timespan),
    )
    owner.guard(workflow, SimpleNamespace(sound={}), tmp_path, RuntimeError)
    workflow.scheduling_settings = SchedulingSettings(max_jobs_per_timespan=MaxJobsPerTimespan.parse_choice("100/1s"))
    workflow.execute(executor_plugin=SimpleNamespace(common_settings=SimpleNamespace(dryrun_exec=False)))
    assert seen == [None]
