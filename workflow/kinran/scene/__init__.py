"""Scenes: the mesh of a cloth, what a scene needs of a fabric, and pictures of it."""
