"""How few lights leave the slope model one lobe."""

FEW_LIGHTS = 45
"""Under so many lights there is one slope lobe, whatever the config says: two explode."""
