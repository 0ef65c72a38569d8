"""From a region and what is asked of the errors to a gain and its certificate: the one door to the solver.

Nothing here is needed to run an observer or to check a certificate; install outrider[design] for it.
How a gain is chosen, and what the proof says, is in docs/proofs.md.
"""

from outrider.design._solve import Design, Problem, Solved
from outrider.design.bounds import bound, smallest
from outrider.design.observers import certify, constant_velocity, high_gain, multi_stage
from outrider.design.prove import prove
from outrider.design.published import Theta, by_theta, orientation
from outrider.design.stages import certify_schedule, certify_speed, line, position, speed, table
from outrider.design.synthesis import Entry, Weights, synthesise

__all__ = [
    "Design",
    "Entry",
    "Problem",
    "Solved",
    "Theta",
    "Weights",
    "bound",
    "by_theta",
    "certify",
    "certify_schedule",
    "certify_speed",
    "constant_velocity",
    "high_gain",
    "line",
    "multi_stage",
    "orientation",
    "position",
    "prove",
    "smallest",
    "speed",
    "synthesise",
    "table",
]
