"""Brackets: the frames of a shot at several exposures, merged to radiance with its noise."""
