"""Baselines: other models of a fabric under many lights, fitted for the chart but never rendered."""
