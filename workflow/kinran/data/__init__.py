"""Data: what the stages hand on, as values and as files."""
