"""Figures and one self-contained HTML page, for experiments, signals, fits and gaps."""

from insemu.report.experiment import render_experiment
from insemu.report.fit import render_fits

__all__ = ["render_experiment", "render_fits"]
