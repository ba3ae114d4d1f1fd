"""Solve a recording: filter, smoother, calibration, and what a minute without GNSS costs, judged by the fixes themselves."""

from insemu.solve.against import Comparison, compare_with
from insemu.solve.beliefs import CALIBRATION, GRADES, Candidate, candidates
from insemu.solve.files import summary, way_of_solution, worst_outages, write
from insemu.solve.outages import HORIZONS, Gap, Outages, cut_everywhere
from insemu.solve.solution import KNOWS, Mounting, Scored, Solution, biases_of, flown, solve

__all__ = [
    "CALIBRATION",
    "GRADES",
    "HORIZONS",
    "KNOWS",
    "Candidate",
    "Comparison",
    "Gap",
    "Mounting",
    "Outages",
    "Scored",
    "Solution",
    "biases_of",
    "candidates",
    "compare_with",
    "cut_everywhere",
    "flown",
    "solve",
    "summary",
    "way_of_solution",
    "worst_outages",
    "write",
]
