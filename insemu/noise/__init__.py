"""Stochastic processes of inertial sensors and their sums.

A process says what it is once: its closed forms (Allan and Haar wavelet variance, PSD, autocovariance), a state block, and ``simulate``.
Sums come free: ``2*GM() + WN()``.
"""

from insemu.noise.block import StateBlock
from insemu.noise.model import NoiseModel, axis_unit, load, save
from insemu.noise.processes import (
    AR,
    AR1,
    ARMA,
    BI,
    DR,
    GM,
    MA,
    PROCESSES,
    QN,
    RC,
    RW,
    SIN,
    WN,
    NotStationary,
    Parameter,
    Process,
)

__all__ = [
    "AR",
    "AR1",
    "ARMA",
    "BI",
    "DR",
    "GM",
    "MA",
    "PROCESSES",
    "QN",
    "RC",
    "RW",
    "SIN",
    "WN",
    "NoiseModel",
    "NotStationary",
    "Parameter",
    "Process",
    "StateBlock",
    "axis_unit",
    "load",
    "save",
]
