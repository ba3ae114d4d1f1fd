"""Solve a recording: filter, smoother, calibration, and what a minute without GNSS costs, judged by the fixes themselves."""

from insemu.solve.against import Comparison, compare_with
from insemu.solve.beliefs import CALIBRATION, GRADES, Candidate, candidates
from insemu.solve.files import summary, way_of_solution, worst_outages, write
from insemu.solve.outages import HORIZONS, Gap, Outages, cut_everywhere
from insemu.solve.solution import KNOWS, Mounting, Scored, Solution, solve

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
    "candidates",
    "compare_with",
    "cut_everywhere",
    "solve",
    "summary",
    "way_of_solution",
    "worst_outages",
    "write",
]
