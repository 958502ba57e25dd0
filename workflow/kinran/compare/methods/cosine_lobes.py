"""Generalised cosine lobes [Filip2004], one and two."""

from kinran.compare.baselines import lafortune
from kinran.compare.method import Method

METHODS = (
    Method("Lafortune", "baseline", lambda t: lafortune.one(t.samples), 8, True),
    Method("Lafortune 2", "baseline", lambda t: lafortune.two(t.samples), 12, True),
)
