"""Segmentation: regions of one kind of thread."""
