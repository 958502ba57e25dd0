"""Orthogonal normals with a Fresnel factor, as far as the paper tells of [TVST05, TT06]."""

from kinran.baselines import crossed
from kinran.chart.method import Method

METHODS = (Method("crossed threads", "paper", lambda t: crossed.fit(t.samples), 12, True),)
