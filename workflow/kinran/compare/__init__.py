"""Comparison: methods charted by accuracy, time, memory and bytes."""
