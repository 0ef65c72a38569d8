"""From a region and what is asked of the errors to a gain and its certificate: the one door to the solver.

Nothing here is needed to run an observer or to check a certificate; install outrider[design] for it.
How a gain is chosen, and what the proof says, is in docs/proofs.md.
"""

from outrider.design._solve import Design, Problem, Solved
from outrider.design.bounds import bound, exact, smallest
from outrider.design.observers import (
    certify_speed,
    certify_table,
    constant_velocity,
    high_gain,
    multi_stage,
    position,
    speed,
    table,
)
from outrider.design.prove import prove
from outrider.design.synthesis import Entry, synthesise

__all__ = [
    "Design",
    "Entry",
    "Problem",
    "Solved",
    "bound",
    "certify_speed",
    "certify_table",
    "constant_velocity",
    "exact",
    "high_gain",
    "multi_stage",
    "position",
    "prove",
    "smallest",
    "speed",
    "synthesise",
    "table",
]
