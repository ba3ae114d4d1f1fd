"""Effects spliced into recordings that others made: real drives, and the motion of another program, through ``insemu gap``.

python -m benchmarks.foreign.spliced --recordings 30 --workers 2 --log results/spliced.jsonl     # real drives and another program's motion in turns
python -m benchmarks.foreign.spliced --bases rtkexp_drive --recordings 10 --seed 100              # one of them
python -m benchmarks.foreign.spliced --halves                                                     # the real drives as they are, half by half

A real drive is held against its nominal model first, and what is found there is believed from then on. Then one effect is put into the recording
at twice the size at which it is worth ``WORTH`` nats, and the question is whether it is named first. Into the motion of another program (fixtures of
the shared data folder), a unit of :mod:`benchmarks.foreign.sensors` puts its noise beforehand. How an effect acts is written here anew.
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import scipy.signal
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import Progress

from benchmarks.foreign import sensors
from benchmarks.trial.score import interval
from insemu.gap import Finding, GapReport, Nominal, find_gap, load_measured, load_nominal
from insemu.gap.beliefs.refined import refined_nominal
from insemu.gap.drive import FIRST, Flown
from insemu.gap.evidence.surrogate import PLAIN, FixNoise, Surrogate
from insemu.gap.problems import drive_without
from insemu.gap.problems.known_effects import colour_of
from insemu.records import GnssRecord, ImuRecord, Recording
from insemu.work import Lines, processes, run_items
from tests.real_gaps import cases
from tests.shared_data import root

Array = NDArray[np.float64]
#: Motion that another program made, with the sigma of its fixes: files of the shared data folder.
MADE = ("car_100hz", "uav_100hz")
REAL = ("rtkexp_drive", "ublox_mixed_nominal", "thor75_uav_flight")
#: An effect is spliced at twice the size at which it is worth this, nats.
WORTH = 20.0
#: What moves faster counts as vibration where an effect's worth is measured, Hz.
CALM_HZ = 8.0
#: Seconds of another program's motion.
SPAN_S = 360.0
DEG = math.pi / 180.0
#: Effects that are spliced: neither the real drives nor the made motion record a temperature.
SHAPES = [key for key in sensors.SHAPED if key[0] != "temperature"]


@dataclass(frozen=True)
class Base:
    """A recording without the effect, what is believed of it, and its motion in the time of the fixes.

    Parameters
    ----------
    recording, nominal : Recording, Nominal
    t : (n,) array
        s.
    attitude, rate : (n, 3, 3), (n, 3) arrays
        Of the body, to NED; its rate of turn over the interval up to each time, rad/s.
    """

    recording: Recording
    nominal: Nominal
    t: Array
    attitude: Array
    rate: Array


@dataclass(frozen=True)
class Splice:
    """An effect put into a recording."""

    base: str
    seed: int

    @property
    def key(self) -> str:
        """Everything that the answer depends on."""
        return f"{self.base}-{self.seed}"


@cache
def base_of(name: str, seed: int) -> Base:
    """A real drive with what was found in it taken for known, or another program's motion with the noise of a drawn unit.

    Parameters
    ----------
    name : str
        One of :data:`REAL` or :data:`MADE`.
    seed : int
        Of the noise of made motion.
    """
    measured, nominal = real(name) if name in REAL else _made(name, seed)
    if name in REAL:
        report = find_gap(measured, nominal, rng=np.random.default_rng(1), hold_out=False, pictures=False)
        nominal = refined_nominal(nominal, report, measured.imu.dt)
    # the IMU put right: its stamps are those of the fixes, its axes those of the vehicle
    prepared = Flown.of(*drive_without(measured, nominal.parted())).prepared
    imu = prepared.imu
    rate = imu.as_increments().gyro / np.diff(imu.t, prepend=imu.t[0] - imu.dt)[:, None]
    return Base(measured, nominal, imu.t, np.stack([_matrix(q) for q in prepared.result.nav[:, 6:10]]), rate)


def real(name: str) -> tuple[Recording, Nominal]:
    """A real drive and the belief that docs/gap.md shows for it.

    Parameters
    ----------
    name : str
        One of :data:`REAL`.
    """
    with tempfile.TemporaryDirectory() as folder:
        believed = cases(Path(folder))[name]
        measured = load_measured(str(root() / "real" / f"{name}.npz"))
        assert isinstance(measured, Recording)
        return measured, load_nominal(believed)


def _made(name: str, seed: int) -> tuple[Recording, Nominal]:
    """Six minutes of another program's motion, seen by a drawn unit."""
    rng = np.random.default_rng([seed, 21])
    unit = sensors.draw_unit(rng)
    with np.load(root() / "fixtures" / "inertial" / f"{name}.npz") as file:
        data = {k: file[k] for k in ("time", "lla", "vel_ned", "rph", "gyro_incr", "accel_incr")}
    begin = int(rng.integers(20_000, data["time"].size - round(SPAN_S * 100.0) - 1))
    rows = slice(begin, begin + round(SPAN_S * 100.0))
    t, dt, n = data["time"][rows], sensors.IMU_DT, round(SPAN_S * 100.0)
    signals = []
    for name_, white, bias, walk in (
        ("gyro_incr", unit.gyro_white, unit.gyro_bias, unit.gyro_walk),
        ("accel_incr", unit.accel_white, unit.accel_bias, unit.accel_walk),
    ):
        drift = np.cumsum(rng.standard_normal((n, 3)), axis=0) * walk * math.sqrt(dt)
        signals.append(
            data[name_][rows]
            + rng.standard_normal((n, 3)) * white * math.sqrt(dt)
            + (drift + bias * rng.standard_normal(3)) * dt
        )
    every = round(100.0 / unit.fix_rate)
    at = np.arange(every, n - 1, every)
    C = np.stack([_from_rph(x) for x in data["rph"][rows][[*at, *(at - 1), *(at + 1)]] * DEG])
    now, before, after = C[: at.size], C[at.size : 2 * at.size], C[2 * at.size :]
    noise = rng.standard_normal((at.size, 3)) * unit.position
    llh = _moved(data["lla"][rows][at] * (DEG, DEG, 1.0), now @ unit.lever + noise)
    velocity = data["vel_ned"][rows][at] + (after - before) @ unit.lever / (2.0 * dt)
    ones = np.ones((at.size, 3))
    fixes = GnssRecord(
        t[at],
        llh,
        velocity + rng.standard_normal((at.size, 3)) * unit.velocity,
        unit.position * ones,
        unit.velocity * ones,
    )
    with tempfile.TemporaryDirectory() as folder:
        file_ = Path(folder) / "belief.yaml"
        file_.write_text(json.dumps(unit.belief()), encoding="utf-8")
        nominal = load_nominal(file_)
    return Recording(ImuRecord(t, signals[0], signals[1], "increment"), fixes), nominal


def _from_rph(angles: Array) -> Array:
    """Body to NED from roll, pitch and heading."""
    (cr, cp, ch), (sr, sp, sh) = np.cos(angles), np.sin(angles)
    return np.array(
        [
            [cp * ch, sr * sp * ch - cr * sh, cr * sp * ch + sr * sh],
            [cp * sh, sr * sp * sh + cr * ch, cr * sp * sh - sr * ch],
            [-sp, sr * cp, cr * cp],
        ]
    )


def _matrix(q: Array) -> Array:
    """Body to NED from a quaternion, scalar first."""
    w, x, y, z = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _moved(llh: Array, ned: Array) -> Array:
    """Places moved by metres, radii of the ellipsoid of WGS-84."""
    a, e2 = 6378137.0, 6.69437999014e-3
    w = np.sqrt(1.0 - e2 * np.sin(llh[:, 0]) ** 2)
    meridian, normal = a * (1.0 - e2) / w**3 + llh[:, 2], a / w + llh[:, 2]
    return llh + np.stack([ned[:, 0] / meridian, ned[:, 1] / (normal * np.cos(llh[:, 0])), -ned[:, 2]], axis=1)


def drawn(rng: np.random.Generator) -> sensors.Hidden:
    """An effect of known shape."""
    effect, sensor = SHAPES[rng.integers(len(SHAPES))]
    axis = "xyz"[rng.integers(3)]
    if effect == "misalignment":
        axis = str(rng.choice(list(sensors.NEIGHBOURS)))
    elif effect == "g_sensitivity":
        axis += "xyz"[rng.integers(3)]
    elif sensor == "imu":
        axis = ""
    value = sensors.SHAPED[effect, sensor] * float(rng.choice([-1.0, 1.0]))
    return sensors.Hidden(effect, sensor, axis, {"value": value})


def put(base: Base, h: sensors.Hidden) -> Recording:
    """The recording with an effect in it, as it would have been recorded.

    Parameters
    ----------
    base : Base
    h : Hidden
    """
    measured, value = base.recording, h.values["value"]
    imu, gnss = measured.imu, measured.gnss
    assert gnss is not None
    if h.effect == "imu_gnss_time_offset":
        return replace(measured, imu=replace(imu, t=imu.t + value), reference=None)
    if h.effect == "lever_arm":
        arm = np.zeros(3)
        arm["xyz".index(h.axis)] = value
        # before the start nobody looks at the fixes
        at = np.clip(np.searchsorted(base.t, gnss.t - 0.5 * imu.dt), 0, base.t.size - 1)
        place = base.attitude[at] @ arm
        vel = None if gnss.vel_ned is None else gnss.vel_ned + _received(base, _swing(base, arm))
        return replace(measured, gnss=replace(gnss, llh=_moved(gnss.llh, place), vel_ned=vel))
    first = "xyz".index(h.axis[0])
    source = {
        "scale_factor": imu.gyro if h.sensor == "gyro" else imu.accel,
        "misalignment": imu.gyro if h.sensor == "gyro" else imu.accel,
        "g_sensitivity": imu.accel,
    }[h.effect]
    other = {"scale_factor": first, "g_sensitivity": "xyz".index(h.axis[-1])}.get(h.effect, -1)
    if other < 0:
        other = sensors.NEIGHBOURS[h.axis][1]
    signals = {"gyro": imu.gyro.copy(), "accel": imu.accel.copy()}
    signals[h.sensor][:, first] += value * source[:, other]
    return replace(measured, imu=replace(imu, **signals))


def _swing(base: Base, arm: Array) -> Array:
    """Velocity (n, 3) of the antenna about the IMU, NED, m/s: the rate of turn at a time is the mean of those before and after."""
    after = np.append(base.rate[1:], base.rate[-1:], axis=0)
    return np.asarray(np.einsum("nij,nj->ni", base.attitude, np.cross(0.5 * (base.rate + after), arm)))


def _received(base: Base, velocity: Array) -> Array:
    """What the receiver of this drive makes of a velocity (n, 3), at its fixes (f, 3): it is behind, and smoothed, by what is known of it."""
    gnss, dt, lag = base.recording.gnss, float(np.median(np.diff(base.t))), 0.0
    assert gnss is not None
    for use in base.nominal.parted().effects:
        if use.id == "gnss_velocity_lag":
            lag += use.scalar("lag")
        if use.id == "gnss_velocity_filter":
            velocity = velocity.copy()
            for k, tau in enumerate(np.array(use["tau"])):
                if tau > 0.0:
                    keep = math.exp(-dt / tau)
                    begun = [keep * velocity[0, k]]
                    velocity[:, k] = scipy.signal.lfilter([1.0 - keep], [1.0, -keep], velocity[:, k], zi=begun)[0]
    return np.stack([np.interp(gnss.t - lag, base.t, v) for v in velocity.T], axis=1)


def sized(base: Base, seed: int) -> sensors.Hidden:
    """An effect at twice the size at which it is worth :data:`WORTH`, of those that the motion shows.

    Parameters
    ----------
    base : Base
    seed : int
    """
    rng = np.random.default_rng([seed, 22])
    # which fixes are outliers is another question, and would be another answer with the effect
    bare = replace(base.nominal, effects=tuple(u for u in base.nominal.effects if u.id not in FIRST)).parted()
    clean = Flown.of(*drive_without(base.recording, bare))
    prepared, noise = clean.prepared, FixNoise(np.ones(6), PLAIN)
    if (colour := colour_of(bare.effects)) is not None:
        # slow errors of the fixes that are known hide what a filter would see that took the rest of their noise for all of it
        loud, noise = FixNoise(np.ones(6), colour, known=True).split(Surrogate.of(prepared.result).sigma())
        prepared = replace(prepared, factors=prepared.factors * loud)
    still = Surrogate.of(prepared.on(_calm(clean.recording)).result)
    while True:
        h = drawn(rng)
        recording, _ = drive_without(put(base, h), bare)
        half = _difference(still, Surrogate.of(prepared.on(_calm(recording)).result), noise)
        factor = 2.0 * math.sqrt(WORTH / max(half, 1e-12))
        if factor < 100.0:
            return h.scaled(factor)


def _difference(one: Surrogate, other: Surrogate, noise: FixNoise) -> float:
    """Half the squared difference of the innovations of two runs, whitened for a noise of the fixes: nats."""
    _, here, there = np.intersect1d(one.t, other.t, return_indices=True)
    d = np.zeros_like(one.nu)
    d[here] = np.where((one.use[here] == 1) & (other.use[there] == 1), other.nu[there] - one.nu[here], 0.0)
    white, _ = one.whiten(d[:, :, None], noise.factor, noise.colour)
    return 0.5 * float(np.sum(white**2))


def _calm(recording: Recording) -> Recording:
    """A recording without vibration, which two runs a millisecond apart sample differently and which tells nobody anything."""
    imu = recording.imu
    widths = np.diff(imu.t, prepend=imu.t[0] - imu.dt)[:, None]
    per_second = 1.0 if imu.kind != "increment" else widths
    sections = scipy.signal.butter(4, min(CALM_HZ, 0.4 / imu.dt), fs=1.0 / imu.dt, output="sos")
    gyro, accel = (
        scipy.signal.sosfiltfilt(sections, x / per_second, axis=0) * per_second for x in (imu.gyro, imu.accel)
    )
    return replace(recording, imu=replace(imu, gyro=gyro, accel=accel))


def answer(job: Splice) -> dict[str, Any]:
    """What is said of a recording with an effect in it, as plain data."""
    base = base_of(job.base, 0 if job.base in REAL else job.seed)
    h = sized(base, job.seed)
    begun = time.process_time()
    report = find_gap(put(base, h), base.nominal, rng=np.random.default_rng(job.seed), hold_out=False, pictures=False)
    return {
        "base": job.base,
        "seed": job.seed,
        "hidden": h.plain(),
        "verdict": report.verdict,
        "findings": [s.to_json() for s in report.findings],
        "right": [_is(s.effect, s.sensor, s.axes, h) for s in report.findings],
        "held": [any((m.effect, m.sensor) == (h.effect, h.sensor) for m in s.members) for s in report.findings],
        "inside": [_inside(s.to_json(), h) for s in report.findings],
        "seconds": time.process_time() - begun,
    }


def _is(effect: str, sensor: str, axes: Sequence[str], h: sensors.Hidden) -> bool:
    return (effect, sensor) == (h.effect, h.sensor) and (not h.axis or not axes or h.axis[0] in axes)


def _inside(finding: dict[str, Any], h: sensors.Hidden) -> bool | None:
    names = {"imu_gnss_time_offset": "offset"}.get(h.effect, f"value_{h.axis}")
    own = next((p for p in finding["parameters"] if p["name"] == names), None)
    return None if own is None or finding["effect"] != h.effect else own["low"] <= h.values["value"] <= own["high"]


def halves(name: str) -> tuple[list[Finding], list[Finding]]:
    """What is said of either half of a real drive as it is, strongest first.

    Parameters
    ----------
    name : str
        One of :data:`REAL`.
    """
    measured, nominal = real(name)
    middle = 0.5 * (measured.imu.t[0] + measured.imu.t[-1])
    said = []
    for early in (True, False):
        part = _part(measured, middle, early)
        report: GapReport = find_gap(part, nominal, rng=np.random.default_rng(1), hold_out=False, pictures=False)
        said.append(list(report.findings))
    return said[0], said[1]


def in_both(one: Sequence[Finding], other: Sequence[Finding]) -> tuple[int, int, int]:
    """Of the effects in either half, those in both by name, those in both by their class, and all; without what lasted for a while.

    Parameters
    ----------
    one, other : sequence of Finding
        What is said of either half.
    """
    here, there = ({(s.effect, s.sensor): _class(s) for s in said if not _begun(s)} for said in (one, other))
    alike = {k for a, b in ((here, there), (there, here)) for k in a if k in b or any(k in v for v in b.values())}
    return len(here.keys() & there.keys()), len(alike), len(here.keys() | there.keys())


def _class(finding: Finding) -> set[tuple[str, str]]:
    """Effects that explain a finding nearly as well."""
    return {(finding.effect, finding.sensor), *((m.effect, m.sensor) for m in finding.members)}


def _begun(finding: Finding) -> str:
    """When a finding began that did not last throughout."""
    return next((f" at {p.value:.0f} s" for p in finding.parameters if p.name == "start"), "")


def _part(measured: Recording, middle: float, early: bool) -> Recording:
    imu, gnss = measured.imu, measured.gnss
    assert gnss is not None
    rows = imu.t <= middle if early else imu.t > middle
    fixes = gnss.t <= middle if early else gnss.t > middle
    temperature = None if imu.temperature is None else imu.temperature[rows]
    own = replace(imu, t=imu.t[rows], gyro=imu.gyro[rows], accel=imu.accel[rows], temperature=temperature)
    stated = {k: v[fixes] for k in ("vel_ned", "pos_std_ned", "vel_std_ned") if (v := getattr(gnss, k)) is not None}
    return replace(
        measured, imu=own, gnss=replace(gnss, t=gnss.t[fixes], llh=gnss.llh[fixes], **stated), reference=None
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Draw, look, count."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.foreign.spliced", description=(__doc__ or "").split("\n")[0]
    )
    parser.add_argument("--bases", nargs="+", choices=[*REAL, *MADE], default=[*REAL, *MADE])
    parser.add_argument("--recordings", type=int, default=30)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--log", type=Path, help="keep finished recordings in this file and go on from there")
    parser.add_argument(
        "--halves", action="store_true", help="the real drives as they are: what is said of either half"
    )
    given = parser.parse_args(arguments)
    if given.halves:
        for name in (b for b in given.bases if b in REAL):
            one, other = halves(name)
            named, alike, count = in_both(one, other)
            lasted = sum(bool(_begun(s)) for s in (*one, *other))
            print(
                f"{name}: in both halves {named} of {count} by name, {alike} by class, and {lasted} that lasted for a while"
            )
            for words, said in (("first half: ", one), ("second half:", other)):
                print(f"  {words} {', '.join(f'{s.effect} {s.sensor}{_begun(s)}' for s in said)}")
        return
    jobs = [Splice(given.bases[k % len(given.bases)], given.seed + k) for k in range(given.recordings)]
    store: Lines[dict[str, Any]] | None = None
    if given.log:
        store = Lines(given.log, lambda a: {"answer": a}, lambda line: dict(line["answer"]), "spliced recordings")
    with Progress(console=Console(stderr=True)) as progress, processes(given.workers) as pool:
        task = progress.add_task("recordings", total=len(jobs))
        found = run_items(
            {job.key: job for job in jobs}, answer, pool=pool, store=store, done=lambda _: progress.advance(task)
        )
    answers: list[dict[str, Any]] = [json.loads(json.dumps(a)) for a in found.values()]
    for group in [*given.bases, ""]:
        mine = [a for a in answers if group in ("", a["base"])]
        if not mine:
            continue
        inside = [i for a in mine for i in a["inside"] if i is not None]
        for label, hits in (
            ("named first", [bool(a["right"]) and a["right"][0] for a in mine]),
            ("among the findings, classes counted", [any(a["held"]) for a in mine]),
            ("verdict is not 'unexplained'", [a["verdict"] != "unexplained" for a in mine]),
            ("95 % intervals that hold the truth", inside),
        ):
            if hits:
                low, high = interval(sum(hits), len(hits))
                print(f"{group or 'all':22s} {label:40s} {sum(hits)} of {len(hits)} ({low:.3f} to {high:.3f})")
    print(f"CPU s per recording, median {np.median([a['seconds'] for a in answers]):.1f}")


if __name__ == "__main__":
    main()
