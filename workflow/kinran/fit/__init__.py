"""Fits of a material to a fabric's samples, and what they rest on: priors, choices, a residual, uncertainty."""
