"""Benchmarks: claims of speed and accuracy, measured on this machine; JSON out and a table."""
