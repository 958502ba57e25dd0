"""Capture: plan the shots and take them, or use photographs with known lights instead."""
