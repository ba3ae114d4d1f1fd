"""What sensors do to the truth: every effect of :mod:`insemu.effects` at its place in the signal chain.

1. models left out (Earth rate, transport rate, gravity), mounting;
2. functions of the true signal, all of the same true signal and summed: scale factor, misalignment, g-sensitivity, ...;
3. what is added: bias, temperature, ramp, the stochastic model or the recorded signal, white noise, walks, vibration, outliers, ...;
4. bandwidth and decimation filter; 5. saturation; 6. quantization; 7. time stamps; 8. dropped samples.

Each effect says itself what it does (:meth:`insemu.effects.Effect.inject`) and where (:class:`insemu.effects.Stage`). Every effect draws from
its own child of the generator, so an effect added at the end leaves the others as they were.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from insemu import covariates
from insemu.effects import EFFECTS, Chain, EffectUse, Stage, passes
from insemu.emulate.errors import RecordedErrors, draw_errors
from insemu.errors import InputError
from insemu.noise import NoiseModel, Process
from insemu.records import ImuRecord, Trajectory

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TemperatureProfile:
    """Temperature against time, linear between points and constant outside.

    Parameters
    ----------
    t : (n,) array
        Times in s, increasing.
    degc : (n,) array
        Temperatures in degC.
    """

    t: tuple[float, ...]
    degc: tuple[float, ...]

    def __post_init__(self) -> None:
        t, degc = tuple(float(x) for x in self.t), tuple(float(x) for x in self.degc)
        if len(t) != len(degc) or not t:
            raise InputError(f"a temperature profile has {len(t)} times and {len(degc)} temperatures, expected as many")
        if not np.isfinite([*t, *degc]).all() or any(b <= a for a, b in pairwise(t)):
            raise InputError("a temperature profile needs finite numbers at increasing times")
        object.__setattr__(self, "t", t)
        object.__setattr__(self, "degc", degc)

    def at(self, t: ArrayLike) -> Array:
        """Temperature in degC at times in s."""
        return np.asarray(np.interp(np.asarray(t, dtype=float), self.t, self.degc))


@dataclass(frozen=True)
class Corrupted:
    """A corrupted record and the truth about its errors.

    Parameters
    ----------
    imu : ImuRecord
        What the sensor gives.
    errors : (n, 6) array
        Stochastic part drawn from the noise models or cut from a recorded signal, rad/s and m/s^2, columns in the
        order of :data:`insemu.records.AXES`; row k belongs to row k of the ideal record.
    components : mapping
        Axis to the (processes, n) signals that sum to its column of ``errors``; empty for recorded errors.
    kept : (m,) array of int
        Rows of the ideal record that the corrupted one still has (dropped samples leave gaps).
    """

    imu: ImuRecord
    errors: Array
    components: Mapping[str, Array] = field(default_factory=dict)
    kept: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))


def covariates_of(
    imu: ImuRecord,
    reference: Trajectory | None,
    temperature: TemperatureProfile | Array | None,
    models: Iterable[NoiseModel | Process],
) -> dict[str, Array]:
    """What levels of some models follow, from the ideal signals and the true motion.

    Parameters
    ----------
    imu : ImuRecord
        Ideal record.
    reference : Trajectory, optional
        At the rows of the record; tells the speed.
    temperature : TemperatureProfile or (n,) array, optional
        degC at the rows.
    models : iterable of NoiseModel
    """
    names = covariates.needed(NoiseModel((m,)) if isinstance(m, Process) else m for m in models)
    if not names:
        return {}
    out = covariates.of_imu(imu, names)
    if temperature is not None:
        out["temperature"] = temperature.at(imu.t) if isinstance(temperature, TemperatureProfile) else temperature
    if reference is not None:
        out["speed"] = np.linalg.norm(reference.vel_ned, axis=1)
    covariates.checked(names, out, "truth")
    return out


#: Place in the table: effects of one stage act in its order.
_PLACE = {name: k for k, name in enumerate(EFFECTS)}


def corrupt(
    imu: ImuRecord,
    truth: Mapping[str, NoiseModel | Process] | RecordedErrors | None,
    rng: np.random.Generator,
    *,
    effects: Sequence[EffectUse] = (),
    reference: Trajectory | None = None,
    temperature: TemperatureProfile | Array | None = None,
    errors: Array | None = None,
    realization: int = 0,
) -> Corrupted:
    """Turn an ideal record into what a sensor gives.

    Parameters
    ----------
    imu : ImuRecord
        Ideal record of any kind at a constant rate.
    truth : mapping of axis to NoiseModel, RecordedErrors or None
        What the sensor's noise really is, by axis or, as filters take it, by ``gyro`` and ``accel``; axes that are not named stay perfect.
    rng : numpy.random.Generator
        Each axis and each effect draws from its own child.
    effects : sequence of EffectUse
        Effects of the sensors ``gyro``, ``accel`` and ``imu``; those of ``gnss`` and of aids are
        passed over (:func:`~insemu.emulate.gnss_fixes` takes them). They act in the order of the signal chain, whatever their
        order here.
    reference : Trajectory, optional
        At the rows of the record; needed by effects that depend on motion, attitude or place.
    temperature : TemperatureProfile or (n,) array, optional
        degC at the rows; needed by effects of temperature, and recorded with the IMU.
    errors : (n, 6) array, optional
        Stochastic errors that were drawn elsewhere, instead of ``truth``.
    realization : int
        Which piece of a recorded signal is taken.

    Returns
    -------
    Corrupted

    Raises
    ------
    InputError
        An unknown axis, an effect that lacks what it needs, a recorded signal at another rate or too short.
    """
    n, dt = len(imu), imu.dt
    if errors is not None and truth is not None:
        raise InputError("both a truth and ready errors were given, expected one of them")
    known = covariates_of(imu, reference, temperature, truth.values() if isinstance(truth, Mapping) else ())
    drawn, components = draw_errors(truth, n, dt, rng, realization, known)
    if errors is not None:
        drawn = np.asarray(errors, dtype=float)
        if drawn.shape != (n, 6):
            raise InputError(f"errors have shape {drawn.shape}, expected ({n}, 6)")
    inertial = [use for use in effects if use.inertial]
    if not inertial and temperature is None:
        return Corrupted(_add(imu, drawn), drawn, components, np.arange(n))

    degc = temperature.at(imu.t) if isinstance(temperature, TemperatureProfile) else temperature
    if degc is not None and np.shape(degc) != (n,):
        raise InputError(f"temperature has shape {np.shape(degc)}, expected ({n},)")
    step = _intervals(imu)
    chain = Chain.of(imu, step, reference, degc)
    _run(chain, inertial, rng.spawn(len(inertial)), None if truth is None and errors is None else drawn)
    kept = np.nonzero(chain.keep)[0]
    if kept.size < 2:
        raise InputError("effect 'dropped_samples' leaves no data")
    gyro, accel = np.empty((2, kept.size, 3))
    passes.unload(chain.signal, step, kept, gyro, accel)
    if degc is not None and kept.size < n:
        degc = degc[kept]
    return Corrupted(ImuRecord(chain.stamps[kept], gyro, accel, imu.kind, degc, imu.sampling), drawn, components, kept)


def _run(
    chain: Chain, inertial: Sequence[EffectUse], children: Sequence[np.random.Generator], drawn: Array | None
) -> None:
    """Take the signals through the chain: every effect at its stage, the drawn errors (n, 6) with the noise."""
    order = sorted(range(len(inertial)), key=lambda k: (inertial[k].effect.stage, _PLACE[inertial[k].id]))
    reached: int = Stage.MODEL
    for k in [*order, None]:
        stage: int | None = Stage.LOSS + 1 if k is None else inertial[k].effect.stage
        assert stage is not None
        if reached < Stage.LAW <= stage:
            chain.leave_out()
            chain.respond()
        if reached < Stage.FILTER <= stage and drawn is not None:
            chain.signal += drawn.T
        reached = stage
        if k is not None:
            inertial[k].effect.inject(chain, inertial[k], children[k])
    chain.keep[0] = True


def _intervals(imu: ImuRecord) -> Array:
    """Intervals (n,) in s by which increments are divided and multiplied; empty for the other kinds."""
    return imu.widths(0.0)[:, 0] if imu.kind == "increment" else np.empty(0)


def _add(imu: ImuRecord, errors: Array) -> ImuRecord:
    errors = errors * imu.widths(0.0)
    return replace(imu, gyro=imu.gyro + errors[:, :3], accel=imu.accel + errors[:, 3:])
