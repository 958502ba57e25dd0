"""Runs: the whole pipeline, its configuration, its tests, its benchmarks, and a check of the machine."""
