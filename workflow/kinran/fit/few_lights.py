"""How few lights leave the slope model one lobe."""

FEW_LIGHTS = 45
"""Fewest lights under which the config's lobes are taken; under fewer there is one slope lobe. `kinran bench choice`
takes two lobes for the brocade under 50 lights, and one under 30 (docs/fit.md); in between nothing was measured."""
