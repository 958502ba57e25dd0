"""Synthetic texels with known lobes, for the tests: those of `kinran bench stability`."""

from kinran.bench.texels import grid, radiance, texels

__all__ = ["grid", "radiance", "texels"]
