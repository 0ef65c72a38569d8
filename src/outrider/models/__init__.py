"""Equations of motion: one file a model, pure component-wise functions over a NamedTuple of states."""
