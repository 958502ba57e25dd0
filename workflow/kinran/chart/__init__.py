"""The chart: accuracy against speed, and against what was captured."""
