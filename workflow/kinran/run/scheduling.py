"""How often Snakemake looks at its jobs."""

from typing import Any


def without_rate_limit(workflow: Any) -> None:
    """Take the limit of jobs a second from a workflow that is about to be executed.

    Its scheduler then looks at jobs when one of them ends. With the limit, which is 100 a second by default and of no
    use here, Snakemake 9.27 asks for another look a second after each look, and after each job that ends for one more,
    for ever (`JobScheduler.schedule`): after 284 of 704 jobs it looked at the rest 300 times a second, and had taken
    26 % of the processor time of the run. While the rules are read, the settings are not there yet.
    """
    workflow.scheduling_settings.max_jobs_per_timespan = None
