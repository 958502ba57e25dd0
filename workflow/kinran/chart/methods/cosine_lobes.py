"""Generalised cosine lobes [FH04], one and two."""

from kinran.baselines import lafortune
from kinran.chart.method import Method

METHODS = (
    Method("Lafortune", "baseline", lambda t: lafortune.one(t.samples), 8, True),
    Method("Lafortune 2", "baseline", lambda t: lafortune.two(t.samples), 12, True),
)
