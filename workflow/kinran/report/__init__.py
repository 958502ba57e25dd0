"""The report: HTML pages that need nothing else."""
