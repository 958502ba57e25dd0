"""From frames of a camera to linear radiance with its noise: calibration, merge and stack."""
