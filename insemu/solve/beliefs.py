"""What may be believed about the sensors of a recording: generic grades, a sensor's card, a fit, and the grade that the innovations ask for."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy  # whose parts are imported when they are used
from numpy.typing import NDArray

from insemu import yamlfile
from insemu.augment import TURN_ON, Extras, per_axis, with_turn_on
from insemu.errors import InputError
from insemu.filters import FilterOptions, InitialSigma, Innovations, LooselyCoupledEKF, likeliest
from insemu.noise import NoiseModel, load
from insemu.prepared import Drive
from insemu.records import AXES, GnssRecord
from insemu.scenario import Design, shipped_designs, validated

Array = NDArray[np.float64]

#: Designs that work on a unit of which nothing is known.
GRADES = ("UAV MEMS", "phone", "consumer MEMS", "industrial MEMS", "tactical grade", "navigation grade")
#: Calibration states that are tried, and how uncertain the lever arm is where nobody states it, m.
CALIBRATION: Mapping[str, Any] = {
    "gyro_scale": 0.01,
    "accel_scale": 0.01,
    "gyro_misalignment": 0.0175,
    "accel_misalignment": 0.0175,
}
LEVER_ARM = 0.5
#: Clock offsets that are looked at, and how far apart at first, s.
OFFSETS, OFFSET_STEP = 0.4, 0.05
#: The likelihood is taken over so many seconds at most, with the covariance propagated every so many seconds.
LIKELIHOOD_S, STEP_S = 900.0, 0.1
#: How factors were found, in words.
HOW = "by maximum likelihood of the innovations"
#: The logarithm of a factor is weighed like a normal deviate of this width.
PRIOR = 3.0
#: A second search for factors begins where walks are larger by this and white noises smaller (logarithm): on a UAV the likelihood has a maximum
#: with hardly any walk, too, 18 nats below the one with much of it.
AWAY = 1.5


@dataclass(frozen=True)
class Candidate:
    """One belief, with the factors on the standard deviations of the fixes that go with it.

    Parameters
    ----------
    name : str
    belief : mapping of axis to NoiseModel
    extras : Extras
        Further states.
    position, velocity : float
        Factors on the stated standard deviations.
    about : str
        What was added or found.
    """

    name: str
    belief: Mapping[str, NoiseModel]
    extras: Extras
    position: float = 1.0
    velocity: float = 1.0
    about: str = ""

    def filter(self, drive: Drive, **options: object) -> LooselyCoupledEKF:
        """Its filter for a drive."""
        made = FilterOptions(extras=self.extras, **options)  # type: ignore[arg-type]
        return LooselyCoupledEKF(self.belief, drive.imu.dt, lever_arm=drive.lever_arm, options=made)

    def start_sigma(self, drive: Drive) -> InitialSigma:
        """What is believed of the start: a place found without a lever arm that is a state is no better known than that."""
        sigma = drive.aligned.sigma
        return replace(sigma, position=np.hypot(sigma.position, self.extras.lever_arm))

    def fixes(self, gnss: GnssRecord) -> GnssRecord:
        """The fixes with the standard deviations that go with it."""
        position, velocity = gnss.pos_std_ned, gnss.vel_std_ned
        return replace(
            gnss,
            pos_std_ned=None if position is None else self.position * position,
            vel_std_ned=None if velocity is None else self.velocity * velocity,
        )

    def calibrating(self) -> Candidate:
        """The same with scale factors and misalignments as states."""
        return replace(self, name=f"{self.name} + calibration", extras=replace(self.extras, **CALIBRATION))


def candidates(
    designs: Sequence[str] = (), sensor: str = "", model: str = "", *, lever_arm_known: bool = False
) -> list[Candidate]:
    """What is tried: the generic grades, and what the user names.

    Parameters
    ----------
    designs : sequence of str
        Further designs of ``insemu designs``.
    sensor : str
        A sensor card, or its file.
    model : str
        File of models as ``insemu fit -o`` writes it.
    lever_arm_known : bool
        Whether the lever arm is left as it is given.

    Raises
    ------
    InputError
        No such design, sensor or file; a design that has to be fitted first.
    """
    extras = Extras(lever_arm=0.0 if lever_arm_known else LEVER_ARM)
    out = []
    for name in dict.fromkeys((*GRADES, *designs)):
        if name not in shipped_designs():
            raise InputError(f"no design '{name}' comes with insemu (`insemu designs` lists them)", where="--designs")
        sources = Design.model_validate(name).sources()
        if not all(isinstance(s, NoiseModel) for s in sources.values()):
            raise InputError(
                f"'{name}' has to be fitted to a static log first: insemu fit LOG -o models.yaml, then --models models.yaml",
                where="--designs",
            )
        out.append(Candidate(name, {a: s for a, s in sources.items() if isinstance(s, NoiseModel)}, extras))
    if sensor:
        of_card = validated(Design, yamlfile.Document("--sensor", {"sensor": sensor}, {})).sources()
        out.append(_with_turn_on(sensor, {a: s for a, s in of_card.items() if isinstance(s, NoiseModel)}, extras))
    if model:
        out.append(_with_turn_on(model, load(model), extras))
    return out


def _with_turn_on(name: str, models: Mapping[str, NoiseModel], extras: Extras) -> Candidate:
    """A belief with a turn-on bias on the axes whose model has none."""
    belief = with_turn_on(models)
    bare = belief != per_axis(models)
    about = (
        f"turn-on biases of {np.degrees(TURN_ON['gyro']):g} deg/s and {TURN_ON['accel']:g} m/s^2 are added, which a static log does not show"
        if bare
        else ""
    )
    return Candidate(name, belief, extras, about=about)


def innovations_of(drive: Drive) -> Callable[..., Innovations]:
    """A function of a candidate, and of seconds by which the IMU is late: the innovations over the first :data:`LIKELIHOOD_S`.

    It raises ``InputError`` where the filter diverges. The fixes are the same whatever the offset, and the start is as uncertain as the
    offset makes it.
    """
    every = max(1, round(STEP_S / drive.imu.dt))
    drive = replace(drive, imu=drive.imu.rows(drive.imu.t <= drive.aligned.t + LIKELIHOOD_S))

    def run(candidate: Candidate, late: float = 0.0) -> Innovations:
        ekf = candidate.filter(drive, covariance_every=every, output_every=1000 * every)
        imu, gnss = drive.flown(ekf)
        gnss = gnss.rows((gnss.t > imu.t[0] + OFFSETS) & (gnss.t < imu.t[-1] - OFFSETS))
        sigma = candidate.start_sigma(drive)
        moved = np.abs(drive.aligned.state.vel_ned) * OFFSETS
        sigma = replace(sigma, position=np.hypot(sigma.position, moved))
        fixes = candidate.fixes(replace(gnss, t=gnss.t + late))
        found = ekf.run(imu, fixes, drive.aligned.state, sigma, aids=drive.aids).fixes
        return Innovations.of(found).rows(found.accepted)

    return run


def likelihood_of(drive: Drive) -> Callable[..., float]:
    """As :func:`innovations_of`, but their log-likelihood: -inf where the filter diverges."""
    run = innovations_of(drive)

    def value(candidate: Candidate, late: float = 0.0) -> float:
        try:
            found = float(run(candidate, late).log_density().sum())
        except InputError:
            return -np.inf
        return found if np.isfinite(found) else -np.inf

    return value


def clock_offset(candidate: Candidate, drive: Drive) -> tuple[float, float]:
    """By how much the stamps of the IMU are late, s, by maximum likelihood, and its standard deviation from the curvature there.

    A latency state would be cheaper, but it is linearised about an offset that it does not know yet.
    """
    value = likelihood_of(drive)
    grid = np.arange(-OFFSETS, OFFSETS + 1e-9, OFFSET_STEP)
    best = float(grid[int(np.argmax([value(candidate, late) for late in grid]))])
    bounds = (best - OFFSET_STEP, best + OFFSET_STEP)
    late = float(
        scipy.optimize.minimize_scalar(
            lambda x: -value(candidate, x), bounds=bounds, method="bounded", options={"xatol": 5e-4}
        ).x
    )
    step = 0.2 * OFFSET_STEP
    bend = (2.0 * value(candidate, late) - value(candidate, late - step) - value(candidate, late + step)) / step**2
    return late, float(1.0 / np.sqrt(bend)) if bend > 0 else np.inf


def adapted(
    base: Candidate, drive: Drive, *, by_axis: bool = False, away: float = 0.0, overstated: bool = False
) -> Candidate:
    """White noise and walk of gyroscopes and accelerometers and the noise of the fixes as the innovations ask for.

    Factors on a belief, and two on the stated standard deviations of the fixes, by maximum likelihood of the innovations. The latter are
    at least 1 unless the fixes may be ``overstated``: innovations do not show errors that last, which a receiver that smooths its fixes
    states.

    Parameters
    ----------
    base : Candidate
        Of white noise and a random walk on every axis: a generic grade, or what was adapted before.
    drive : Drive
        With a start.
    by_axis : bool
        One factor on the white noise of each axis, for a vehicle shakes some more than others; else one for each kind of sensor.
    away : float
        The search begins at walks larger and white noises smaller by this (logarithm).
    overstated : bool
        Whether the fixes may scatter by less than they state.
    """
    run = innovations_of(drive)
    with_velocity = drive.gnss.vel_std_ned is not None
    axes = AXES if by_axis else ("gyro", "accel")
    words = (*(f"{a} white noise" for a in axes), "gyro walk", "accel walk")

    def at(x: Array) -> Candidate:
        f = dict(zip((*words, "position", "velocity"), np.exp(x).tolist(), strict=False))
        belief = {
            a: _scaled(m, f[f"{a if by_axis else a.split('_')[0]} white noise"], f[f"{a.split('_')[0]} walk"])
            for a, m in base.belief.items()
        }
        position, velocity = base.position * f["position"], base.velocity * f.get("velocity", 1.0)
        name = "adapted by axis" if by_axis else "adapted to the scatter of the fixes" if overstated else "adapted"
        return replace(base, name=name, belief=belief, position=position, velocity=velocity)

    # what was adapted before has its factors on the fixes already
    floors = [-np.inf] * 2 if overstated else [-np.log(base.position), -np.log(base.velocity)]
    least = np.array([-np.inf] * len(words) + floors[: 1 + with_velocity])
    start = np.zeros(least.size)
    start[: len(words)] = [away if w.endswith("walk") else -away for w in words]
    found = likeliest(lambda x: run(at(x)), start, PRIOR, least).x
    factors = ", ".join(f"{w} x {np.exp(v):.2g}" for w, v in zip(words, found, strict=False))
    before = base.about.removesuffix(f", {HOW}")
    about = f"{before}, then {factors}" if by_axis and before else f"{base.name} with {factors}"
    return replace(at(found), about=f"{about}, {HOW}")


def _scaled(model: NoiseModel, white: float, walk: float) -> NoiseModel:
    """A model of white noise and walk with factors on both; the turn-on bias stays."""
    factors = {"N": white, "K": walk}
    parts = [p.with_parameters({k: v * factors[k] for k, v in p.parameters.items()}) for p in model]
    return NoiseModel(tuple(parts))
