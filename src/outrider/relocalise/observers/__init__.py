"""Observers of a robot's pose: one file each."""
