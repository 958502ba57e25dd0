"""Orthogonal normals with a Fresnel factor, as far as the paper tells of [Takeda2005, Takeda2006]."""

from kinran.compare.baselines import crossed
from kinran.compare.method import Method

METHODS = (Method("crossed threads", "paper", lambda t: crossed.fit(t.samples), 12, True),)
