"""Calibration: camera, lamp and colours of a capture, from its dark, white and chart frames."""
