"""The fit: from samples of a stack to a material."""
