"""Lateral velocity: all estimators on courses they were not tuned on, with cars that nobody here modelled."""
