"""Estimators of lateral velocity, one a file."""
