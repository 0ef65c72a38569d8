"""Gains and proofs of the package, made anew."""
