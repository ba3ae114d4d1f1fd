"""Stochastic processes of inertial sensors and their sums.

A process says what it is once: its closed forms (Allan and Haar wavelet variance, PSD, autocovariance), a state block, and ``simulate``.
Sums come free: ``2*GM() + WN()``.
"""

from insemu.noise.block import StateBlock
from insemu.noise.clock import Clock
from insemu.noise.files import axis_unit, load, save
from insemu.noise.follow import KNOWN as COVARIATES
from insemu.noise.follow import LARGEST_LOG_GAIN, LARGEST_LOG_TIME, Follows, require_constant
from insemu.noise.onward import Source, check_held, sources
from insemu.noise.others import kind_of
from insemu.noise.parameters import Parameter
from insemu.noise.process import PROCESSES, SAME_RATE, NoiseModel, NotStationary, Process, register
from insemu.noise.processes.autoregressive import AR, AR1, ARMA, MA
from insemu.noise.processes.flicker import BI
from insemu.noise.processes.gauss_markov import GM
from insemu.noise.processes.sinusoid import SIN
from insemu.noise.processes.walks import DR, RC, RW
from insemu.noise.processes.white import QN, WN
from insemu.noise.shared import CommonDraws, Seen, shared_processes
from insemu.noise.spread import Spread, load_spread, process_label, with_factors

__all__ = [
    "AR",
    "AR1",
    "ARMA",
    "BI",
    "COVARIATES",
    "DR",
    "GM",
    "LARGEST_LOG_GAIN",
    "LARGEST_LOG_TIME",
    "MA",
    "PROCESSES",
    "QN",
    "RC",
    "RW",
    "SAME_RATE",
    "SIN",
    "WN",
    "Clock",
    "CommonDraws",
    "Follows",
    "NoiseModel",
    "NotStationary",
    "Parameter",
    "Process",
    "Seen",
    "Source",
    "Spread",
    "StateBlock",
    "axis_unit",
    "check_held",
    "kind_of",
    "load",
    "load_spread",
    "process_label",
    "register",
    "require_constant",
    "save",
    "shared_processes",
    "sources",
    "with_factors",
]

globals().update(PROCESSES)  # a process in a module of its own is found here, too
