"""Capture: plan the shots and take them, or take photographs with known lights in their place."""
