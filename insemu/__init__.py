"""insemu: an INS/GNSS emulation and filter-evaluation testbed.

A noise model is fitted from a signal, the same object corrupts an emulated flight and generates the filter's extra states, and
everything that is reported is a function of the pair (truth, belief).

Conventions, everywhere
-----------------------
Units
    SI and radians. Datasheet units (``0.032 deg/s/sqrt(Hz)``) exist only in files and on the command line and are converted once, in
    :mod:`insemu.units`.
Frames
    ``i`` inertial, ``e`` ECEF, ``n`` local north-east-down, ``b`` body forward-right-down, ``v`` vehicle. ``C_nb`` takes body to NED.
    Euler angles are roll, pitch, heading (``C_nb = Rz(heading) Ry(pitch) Rx(roll)``). ``w_ib_b`` is the angular rate of b with respect to i
    in b, ``f_ib_b`` the specific force (Groves' notation). A mounting ``C_vb`` takes IMU to vehicle axes.
Errors
    error = estimate - truth. Attitude: ``C_est = (I + [phi x]) C_true``, so ``phi' = -w_in x phi + C dw_ib - dw_in`` and
    ``dv' = -[f_n x] phi + C df + ...`` with dw_ib, df the estimated minus the true rate and specific force.
Sensors
    measured = (I + S + M) true + b + ... The lever arm ``l_b`` runs from IMU to antenna: ``p_ant = p + C_nb l_b``,
    ``v_ant = v + C_nb (w_eb_b x l_b)``. A positive time offset means that IMU stamps are late.
States
    Position (N, E, D metres), velocity, attitude, then the blocks of gyro x, y, z, then of accelerometer x, y, z. Offsets exist only in
    ``augment.StateLayout``.
Processes
    Parameters are continuous-time and rate-free where the process is. WN ``N`` is the root of the two-sided PSD (per-sample sigma
    N / sqrt(dt)). Sample k carries c x_k with ``x_k = Phi x_(k-1) + w_k``; an increment carries that times dt.
Wavelet variance
    Haar wavelet variance at scale 2^j samples is half the Allan variance at averages of m = 2^(j-1) samples.
Arrays
    Run first, then time, then component. Every stochastic function takes an ``rng``; runs, sensors and axes get children of one
    ``numpy.random.SeedSequence``, so run 7 is the same alone, in parallel, or among 1000.
"""

import sys as _sys
from importlib import import_module as _import
from types import ModuleType as _Module
from typing import Any as _Any

__version__ = "0.1.0"

#: Names at the top -> where they are: found when they are asked for, so that ``import insemu`` takes no time. What type they have says
#: ``__init__.pyi``.
_TOP = {
    **dict.fromkeys(
        "read examine fit select characterise run emulate find_gap solve require referee plot load".split(), "api"
    ),
    **dict.fromkeys("WN RW GM GM2 AR1 AR MA ARMA QN DR BI PWC SIN RC NoiseModel Process".split(), "noise"),
    **dict.fromkeys("Series ImuRecord GnssRecord Trajectory Recording".split(), "records"),
    **dict.fromkeys("Experiment Results".split(), "evaluate"),
    **dict.fromkeys("corrupt gnss_fixes ideal_imu".split(), "emulate"),
    **dict.fromkeys("register_filter NavigationFilter".split(), "filters"),
    "Scenario": "scenario",
    "InputError": "errors",
    "register_process": "noise.register",
}

__all__ = ["__version__", *_TOP]


class _Package(_Module):
    """The package, in which a function at the top is not replaced by the room of its name when that is imported."""

    def __setattr__(self, name: str, value: _Any) -> None:
        if not (name in _TOP and isinstance(value, _Module)):
            super().__setattr__(name, value)


_sys.modules[__name__].__class__ = _Package


def __getattr__(name: str) -> _Any:
    if name not in _TOP:
        raise AttributeError(f"module 'insemu' has no attribute '{name}'")
    room, _, own = _TOP[name].partition(".")
    return getattr(_import(f"insemu.{room}"), own or name)


def __dir__() -> list[str]:
    return sorted(__all__)
