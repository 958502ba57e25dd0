"""The number of lights below which the slope model has one lobe."""

FEW_LIGHTS = 45
"""Fewest lights for which the lobes of the config are taken; with fewer the slope model has one lobe. `kinran bench
choice` takes two lobes for the brocade under 50 lights, and one under 30 (docs/fit.md); in between nothing was
measured."""
