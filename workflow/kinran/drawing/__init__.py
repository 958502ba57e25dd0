"""Drawings for pages and files: a canvas of marks, axes, and the plots that the chart and the report are made of."""
