"""Noise models as other programs take them: Kalibr and OpenVINS, VINS-Fusion, Gazebo, RotorS (PX4), KF-GINS, GTSAM, MATLAB, gnss-ins-sim.

Each of these knows white noise and one slow process per sensor triad: a random walk, or a Gauss-Markov process. The axes are combined by their
root mean square, and every writer states the formula by which the program uses its numbers, so that a model can be read back by simulating it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from insemu.errors import InputError, nearest
from insemu.noise import NoiseModel, require_constant
from insemu.units import conversion

#: Correlation time that stands for none in programs that want one, s: longer than any mission.
ENDLESS = 1.0e6


@dataclass(frozen=True)
class Triad:
    """What a sensor triad is for these programs, SI.

    Parameters
    ----------
    white : float
        Density N of the white noise, unit/sqrt(Hz) (two-sided).
    sigma, time : float
        Standard deviation and correlation time (s) of the Gauss-Markov process; a random walk K has ``sigma = K sqrt(time / 2)``.
    walk : float
        Density K of the random walk that the slow part is over times well below ``time``, unit sqrt(Hz).
    turn_on : float
        Standard deviation of the turn-on bias.
    """

    white: float
    sigma: float
    time: float
    walk: float
    turn_on: float


def reduce_models(
    models: Mapping[str, NoiseModel], rate_hz: float, record_s: float
) -> tuple[dict[str, Triad], list[str]]:
    """Reduce the models of axes to one white noise and one slow process per sensor.

    Parameters
    ----------
    models : mapping of axis to NoiseModel
        ``gyro_x`` .. ``accel_z``, or ``gyro`` and ``accel``.
    rate_hz : float
        Sampling rate.
    record_s : float
        Length of the record, s: a walk that was not found is written as the largest that such a record hides below its white noise,
        K = sqrt(3) N / T, because these programs divide by it.

    Returns
    -------
    dict of "gyro" and "accel" to Triad, list of str
        What cannot be said in full.

    Raises
    ------
    InputError
        No axis of either sensor; a rate or length that is not positive; a process that follows a covariate.
    """
    if not (rate_hz > 0 and record_s > 0):
        raise InputError(f"the rate is {rate_hz} Hz and the record {record_s} s long, expected positive numbers")
    require_constant(models.values(), "another program")
    out: dict[str, Triad] = {}
    notes: list[str] = []
    for sensor in ("gyro", "accel"):
        axes = [m for name, m in models.items() if name.startswith(sensor)]
        if not axes:
            continue
        parts = [_reduced(m, 1.0 / rate_hz) for m in axes]
        white, walk2, turn_on = (math.sqrt(float(np.mean([p[k] for p in parts]))) for k in (0, 1, 2))
        times = [p[3] for p in parts if p[3]]
        time = float(np.exp(np.mean(np.log(times)))) if times else ENDLESS
        if walk2 == 0.0:
            walk2 = math.sqrt(3.0) * white / record_s
            notes.append(
                f"{sensor}: no slow process; written is the largest walk that {record_s:g} s of its white noise would hide"
            )
        others = sorted({p.symbol for m in axes for p in m} - {"WN", "RW", "GM", "AR1", "RC"})
        if others:
            notes.append(f"{sensor}: {', '.join(others)} enter by what they resemble over a second")
        if any(sum(p.symbol in ("GM", "AR1", "RW") for p in m) > 1 for m in axes):
            notes.append(f"{sensor}: several slow processes become one with the same short-time walk")
        out[sensor] = Triad(white, walk2 * math.sqrt(time / 2.0), time, walk2, turn_on)
    if not out:
        raise InputError("holds no axis of a gyroscope or an accelerometer")
    return out, notes


def _reduced(model: NoiseModel, dt: float) -> tuple[float, float, float, float]:
    """Squares of white density, short-time walk and turn-on bias; correlation time of the strongest Gauss-Markov process (0: none)."""
    white = walk = turn_on = time = strongest = 0.0
    for process in model:
        if process.symbol == "RC":
            turn_on += process.parameters["sigma"] ** 2
            continue
        n2, k2 = process.as_white_and_walk(dt)
        white, walk = white + n2, walk + k2
        if process.symbol in ("GM", "AR1") and k2 > strongest:
            strongest, time = k2, float(process.correlation_time(dt) or 0.0)
    return white, walk, turn_on, time


Writer = Callable[[Mapping[str, Triad], float], str]


def _kalibr(triads: Mapping[str, Triad], rate_hz: float) -> str:
    lines = [
        "# continuous time: white noise of density N (N sqrt(rate) a sample), bias walk of density K (K sqrt(dt) a step)"
    ]
    for sensor, name in (("accel", "accelerometer"), ("gyro", "gyroscope")):
        if sensor in triads:
            lines += [
                f"{name}_noise_density: {triads[sensor].white:.9g}",
                f"{name}_random_walk: {triads[sensor].walk:.9g}",
            ]
    return "\n".join([*lines, f"update_rate: {rate_hz:g}", 'rostopic: "/imu0"']) + "\n"


def _vins(triads: Mapping[str, Triad], rate_hz: float) -> str:
    lines = ["# per sample: a step adds acc_n^2 to every measurement and (acc_w dt)^2 to the bias"]
    for sensor, short in (("accel", "acc"), ("gyro", "gyr")):
        if sensor in triads:
            t = triads[sensor]
            lines += [f"{short}_n: {t.white * math.sqrt(rate_hz):.9g}", f"{short}_w: {t.walk * math.sqrt(rate_hz):.9g}"]
    return "\n".join(lines) + "\n"


def _gazebo(triads: Mapping[str, Triad], rate_hz: float) -> str:
    out = [
        "<!-- a sample: stddev; dynamic bias b: b exp(-dt/tau) + sqrt(-s^2 tau/2 expm1(-2 dt/tau)) w; bias_stddev drawn once -->",
        f"<update_rate>{rate_hz:g}</update_rate>", "<imu>",
    ]  # fmt: skip
    for sensor, name in (("gyro", "angular_velocity"), ("accel", "linear_acceleration")):
        if sensor not in triads:
            continue
        t = triads[sensor]
        noise = (
            f'<noise type="gaussian"><mean>0</mean><stddev>{t.white * math.sqrt(rate_hz):.9g}</stddev>'
            f"<bias_mean>0</bias_mean><bias_stddev>{t.turn_on:.9g}</bias_stddev><dynamic_bias_stddev>{t.walk:.9g}</dynamic_bias_stddev>"
            f"<dynamic_bias_correlation_time>{t.time:.9g}</dynamic_bias_correlation_time></noise>"
        )
        out += [f"  <{name}>", *(f"    <{a}>{noise}</{a}>" for a in "xyz"), f"  </{name}>"]
    return "\n".join([*out, "</imu>"]) + "\n"


def _rotors(triads: Mapping[str, Triad], rate_hz: float) -> str:
    out = ["<!-- gazebo_imu_plugin of RotorS and PX4: continuous densities; the bias as in Gazebo -->"]
    for sensor, name in (("gyro", "gyroscope"), ("accel", "accelerometer")):
        if sensor in triads:
            t = triads[sensor]
            keys = {
                "NoiseDensity": t.white,
                "RandomWalk": t.walk,
                "BiasCorrelationTime": t.time,
                "TurnOnBiasSigma": t.turn_on,
            }
            out += [f"<{name}{k}>{v:.9g}</{name}{k}>" for k, v in keys.items()]
    return "\n".join(out) + "\n"


def _kfgins(triads: Mapping[str, Triad], rate_hz: float) -> str:
    """One correlation time for both sensors: the gyroscope's; the accelerometer keeps its short-time walk."""
    time = triads["gyro"].time if "gyro" in triads else next(iter(triads.values())).time
    out = ["# bias of density 2 std^2 / corrtime", "imunoise:"]
    for sensor, white, bias, unit, walk_unit, std_unit in (
        ("gyro", "arw", "gbstd", "rad/s/sqrt(Hz)", "deg/sqrt(h)", "deg/h"),
        ("accel", "vrw", "abstd", "m/s^2/sqrt(Hz)", "m/s/sqrt(h)", "mGal"),
    ):
        if sensor in triads:
            t = triads[sensor]
            n = t.white * conversion(unit, walk_unit)
            s = t.walk * math.sqrt(time / 2.0) * conversion("rad/s" if sensor == "gyro" else "m/s^2", std_unit)
            out += [
                f"  {white}: [{n:.9g}, {n:.9g}, {n:.9g}]  # {walk_unit}",
                f"  {bias}: [{s:.9g}, {s:.9g}, {s:.9g}]  # {std_unit}",
            ]
    out += [
        "  gsstd: [0.0, 0.0, 0.0]  # ppm, not known from a record at rest",
        "  asstd: [0.0, 0.0, 0.0]  # ppm, likewise",
    ]
    return "\n".join([*out, f"  corrtime: {time / 3600.0:.9g}  # h"]) + "\n"


def _gtsam(triads: Mapping[str, Triad], rate_hz: float) -> str:
    out = [
        "# continuous time: squared densities of PreintegrationCombinedParams",
        "import numpy as np",
        "",
        "",
        "def set_noise(params):",
    ]
    for sensor, white, walk in (
        ("accel", "setAccelerometerCovariance", "setBiasAccCovariance"),
        ("gyro", "setGyroscopeCovariance", "setBiasOmegaCovariance"),
    ):
        if sensor in triads:
            t = triads[sensor]
            out += [
                f"    params.{white}({t.white**2:.9g} * np.eye(3))",
                f"    params.{walk}({t.walk**2:.9g} * np.eye(3))",
            ]
    return "\n".join(out) + "\n"


def _matlab(triads: Mapping[str, Triad], rate_hz: float) -> str:
    out = [
        "% imuSensor of MATLAB; two-sided densities: N sqrt(rate) a sample, K / sqrt(rate) a step of the walk",
        f'imu = imuSensor("accel-gyro", "SampleRate", {rate_hz:g});',
    ]
    for sensor, name, kind in (("gyro", "Gyroscope", "gyroparams"), ("accel", "Accelerometer", "accelparams")):
        if sensor in triads:
            t = triads[sensor]
            out.append(
                f'imu.{name} = {kind}("NoiseType", "double-sided", "NoiseDensity", {t.white:.9g}, "RandomWalk", {t.walk:.9g});'
            )
    return "\n".join(out) + "\n"


def _gnss_ins_sim(triads: Mapping[str, Triad], rate_hz: float) -> str:
    out = [
        "# imu_err of gnss-ins-sim: white noise arw / sqrt(dt); drift b: (1 - dt/corr) b + std sqrt(1 - exp(-2 dt/corr)) w"
    ]
    out += ["import numpy as np", "", "imu_err = {"]
    for sensor, walk, unit, walk_unit, std_unit in (
        ("gyro", "gyro_arw", "rad/s/sqrt(Hz)", "deg/sqrt(h)", "deg/h"),
        ("accel", "accel_vrw", "m/s^2/sqrt(Hz)", "m/s/sqrt(h)", "m/s^2"),
    ):
        if sensor in triads:
            t = triads[sensor]
            n = t.white * conversion(unit, walk_unit)
            s = t.sigma * conversion("rad/s" if sensor == "gyro" else "m/s^2", std_unit)
            out += [
                f'    "{sensor}_b": np.zeros(3),', f'    "{walk}": np.full(3, {n:.9g}),  # {walk_unit}',
                f'    "{sensor}_b_stability": np.full(3, {s:.9g}),  # {std_unit}', f'    "{sensor}_b_corr": np.full(3, {t.time:.9g}),  # s',
            ]  # fmt: skip
    return "\n".join([*out, "}"]) + "\n"


#: Program -> its writer.
PROGRAMS: Mapping[str, Writer] = {
    "kalibr": _kalibr,
    "openvins": _kalibr,
    "vins-fusion": _vins,
    "gazebo": _gazebo,
    "rotors": _rotors,
    "px4": _rotors,
    "kf-gins": _kfgins,
    "gtsam": _gtsam,
    "matlab": _matlab,
    "gnss-ins-sim": _gnss_ins_sim,
}


def spell(
    models: Mapping[str, NoiseModel], program: str, *, rate_hz: float, record_s: float = 3600.0
) -> tuple[str, list[str]]:
    """Write noise models in the words of another program.

    Parameters
    ----------
    models : mapping of axis to NoiseModel
        SI.
    program : str
        Key of :data:`PROGRAMS`.
    rate_hz : float
        Sampling rate of the sensor there.
    record_s : float
        Length of the record that the models come from, s; see :func:`reduce_models`.

    Returns
    -------
    str, list of str
        The text, and what it cannot say.

    Raises
    ------
    InputError
        An unknown program; as :func:`reduce_models`.
    """
    if program not in PROGRAMS:
        raise InputError(f"unknown program '{program}'" + nearest(program, PROGRAMS))
    triads, notes = reduce_models(models, rate_hz, record_s)
    return PROGRAMS[program](triads, rate_hz), notes
