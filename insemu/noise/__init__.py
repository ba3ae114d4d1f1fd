"""Stochastic processes of inertial sensors and their sums.

A process says what it is once: its closed forms (Allan and Haar wavelet variance, PSD, autocovariance), a state block, and ``simulate``.
Sums come free: ``2*GM() + WN()``.
"""

from insemu.noise.block import StateBlock
from insemu.noise.files import axis_unit, load, save
from insemu.noise.parameters import Parameter
from insemu.noise.process import PROCESSES, SAME_RATE, NoiseModel, NotStationary, Process
from insemu.noise.processes.autoregressive import AR, AR1, ARMA, MA
from insemu.noise.processes.flicker import BI
from insemu.noise.processes.gauss_markov import GM
from insemu.noise.processes.sinusoid import SIN
from insemu.noise.processes.walks import DR, RC, RW
from insemu.noise.processes.white import QN, WN

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
    "SAME_RATE",
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

globals().update(PROCESSES)  # a process in a module of its own is found here, too
