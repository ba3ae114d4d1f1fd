"""Figures and one self-contained HTML page, for experiments, signals, fits and gaps."""

from insemu.report.experiment import render_experiment

__all__ = ["render_experiment"]
