"""Data that stages hand on, as values and as files."""
