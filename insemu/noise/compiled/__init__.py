"""Compiled parts of the processes: wavelet variances by address, small matrix products, draws."""

from insemu.noise.compiled.curves import call, callback_of, compiled, evaluate
from insemu.noise.compiled.doubling import arma, coefficients_of, copy, multiply
from insemu.noise.compiled.draws import driven, first_order, rational_filter, running_sum, standard_normal

__all__ = [
    "arma",
    "call",
    "callback_of",
    "coefficients_of",
    "compiled",
    "copy",
    "driven",
    "evaluate",
    "first_order",
    "multiply",
    "rational_filter",
    "running_sum",
    "standard_normal",
]
