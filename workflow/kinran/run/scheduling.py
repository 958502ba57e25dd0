"""How often Snakemake looks at its jobs."""

from typing import Any


def without_rate_limit(workflow: Any) -> None:
    """Take the limit of jobs a second from a workflow, so that its scheduler looks at them when one of them ends.

    With the limit, which is 100 a second by default and of no use here, Snakemake 9.27 asks for another look a second
    after each look, and after each job that ends for one more, for ever (`JobScheduler.schedule`): after 284 of 704
    jobs it looked at the rest 300 times a second, and had taken 26 % of the processor time of the run.
    """
    if workflow.scheduling_settings is not None:
        workflow.scheduling_settings.max_jobs_per_timespan = None
