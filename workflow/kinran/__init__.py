"""Kinran: from a fabric under known lights to a material that a path tracer renders."""
