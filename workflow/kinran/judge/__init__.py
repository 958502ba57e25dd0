"""Judgement: materials against photographs that no fit has seen."""
