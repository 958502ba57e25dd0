"""Drawings for pages and files: a canvas of marks, axes, and the plots of chart and report."""
