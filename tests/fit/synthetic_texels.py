"""Synthetic texels with known lobes, for the tests: those of `kinran bench stability`."""

from kinran.bench.texels import grid, radiance, sampled, texels

__all__ = ["grid", "radiance", "sampled", "texels"]
