"""The carrying of static models to drives, measured.

``python -m tests.transfer_experiments factors [N]``: 95 % intervals of factors that are known, on N emulated drives.
``python -m tests.transfer_experiments causes [N [SEED]]``: the main reason where one effect was hidden in an emulated drive.
``python -m tests.transfer_experiments together [N]``: noise and constants of the IMU tuned together, on N drives.
``python -m tests.transfer_experiments real``: the static model of each real drive's longest rest, judged in outages of the drive; of the first also
behind what the gap workflow finds there.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.trial.drives import stage
from benchmarks.trial.run import Job, moving_recording
from insemu.augment import Extras
from insemu.errors import InputError
from insemu.filters import rests
from insemu.fit import fit
from insemu.formats import read_recording
from insemu.gap import Nominal, find_gap, from_its_start, load_nominal, refined_nominal
from insemu.noise import WN, NoiseModel
from insemu.records import AXES, Recording, Series
from insemu.scenario import Gnss
from insemu.transfer import CONSTANTS, Judged, estimated, fitted, judge, levels_of, transfer
from tests.real_gaps import cases
from tests.shared_data import shared
from tests.test_transfer import ACROSS, SCALE, drive_of

#: Factors by which the noise of an emulated drive exceeds what is believed.
FACTORS = (1.0, 2.0, 7.0)
#: Effects that make an IMU look noisy, hidden at so many nats.
CAUSES = ("imu_gnss_time_offset", "scale_factor", "misalignment", "lever_arm", "g_sensitivity", "white_noise")
STRENGTH = 3000.0
SCENARIOS = Path(__file__).resolve().parents[1] / "scenarios"


def emulated(seed: int) -> tuple[Recording, Nominal, dict[str, float]]:
    """A drive, a belief whose white noise is too small by a known factor, and the true factors of its levels.

    What is stated of the fixes is off by the same on all axes, for a level has one factor.
    """
    rng = np.random.default_rng([seed, 9])
    s = stage(seed, 15.0, 50.0)
    position, velocity = (
        sigma * (stated[0] / sigma[0]) for sigma, stated in zip((s.sigma, s.sigma_v), s.stated, strict=True)
    )
    gnss = s.nominal.gnss.model_copy(update={"position_sigma": tuple(position), "velocity_sigma": tuple(velocity)})
    s = replace(s, stated=(position, velocity), nominal=replace(s.nominal, gnss=gnss))
    by = {sensor: float(rng.choice(FACTORS)) for sensor in ("gyro", "accel")}
    beliefs = {
        a: NoiseModel(tuple(p.scaled(1.0 / by[a.partition("_")[0]]) if isinstance(p, WN) else p for p in m))
        for a, m in s.truth.items()
    }
    true = {f"{sensor} white": factor for sensor, factor in by.items()}
    true["fixes position"], true["fixes velocity"] = (
        float(sigma[0] / stated[0]) for sigma, stated in zip((s.sigma, s.sigma_v), s.stated, strict=True)
    )
    return s.record(), replace(s.nominal, beliefs=beliefs), true


def factors(count: int) -> None:
    """Print how often intervals hold the factor."""
    inside: dict[str, list[bool]] = {}
    for seed in range(count):
        recording, nominal, true = emulated(seed)
        levels = levels_of(recording, nominal)
        span = (float(levels.gnss.t[0]), float(levels.gnss.t[-1]) + 1.0)
        found, interval = fitted(levels, [span])
        for f in found.factors:
            if f.name in true:
                inside.setdefault(f.name, []).append(f.low <= true[f.name] <= f.high)
        said = ", ".join(
            f"{f.name} {f.value:.2f} [{f.low:.2f}, {f.high:.2f}] ({true[f.name]:.2f})"
            for f in found.factors
            if f.name in true
        )
        print(f"{seed}: every {interval:g} s; {said}", flush=True)
    for name, held in inside.items():
        print(f"{name}: {sum(held)} of {len(held)} intervals hold the factor")
    every = [h for held in inside.values() for h in held]
    print(f"together: {sum(every)} of {len(every)} ({np.mean(every):.1%})")


def causes(count: int, first: int) -> None:
    """Print how often the effect that was hidden is the main reason, from seed ``first`` on."""
    right = asked = 0
    for seed in range(first, first + count):
        effect = CAUSES[seed % len(CAUSES)]
        made = moving_recording(Job("dynamic", (effect,), STRENGTH, 500 + seed, minutes=10.0))
        found = transfer(made.recording, made.stage.nominal, rng=np.random.default_rng(seed))
        said = []
        for name in found.rest:
            parts = sorted(((s.shares[name], s.finding) for s in found.reasons), key=lambda x: -x[0])
            if not parts:
                said.append((name, "nothing", 1.0, False))
                continue
            share, first = parts[0]
            named = effect == first.effect or effect in [m.effect for m in first.members]
            said.append((name, first.effect, share, named))
        if said:
            asked += 1
            right += all(named for *_, named in said)
        print(f"{seed} {effect}: " + ("; ".join(f"{n} {e} {x:.2g}" for n, e, x, _ in said) or "no factor"), flush=True)
    print(f"main reason named: {right} of {asked} drives with a factor beyond 1.5")


def at_rest(recording: Recording) -> dict[str, NoiseModel]:
    """White noise of the longest rest."""
    assert recording.gnss is not None
    imu = recording.imu
    start, end = max(rests(imu, recording.gnss), key=lambda span: span[1] - span[0])
    rows = (imu.t >= start) & (imu.t <= end)
    values = imu.rates()[rows]
    return {
        a: fit(Series(values[:, k], 1.0 / imu.dt, "rad/s" if k < 3 else "m/s^2", a), WN()).model
        for k, a in enumerate(AXES)
    }


def real() -> None:
    """Print the judge's table of the three real drives, and of the first with its velocities, as they are and behind what the gap workflow finds."""
    for name, scenario in (
        ("rtkexp_drive", "real_drive_rtk"),
        ("ublox_mixed_nominal", "real_drive_ublox"),
        ("thor75_uav_flight", ""),
    ):
        recording = read_recording(shared(f"real/{name}.npz"))
        static = at_rest(recording)
        if scenario:
            nominal = replace(load_nominal(SCENARIOS / f"{scenario}.yaml"), beliefs=static)
        else:
            nominal = Nominal(static, Gnss(position_sigma=(2.0,) * 3, velocity_sigma=(0.2,) * 3))
        try:
            tell(name, judge(levels_of(recording, nominal)))
        except InputError as error:
            print(f"{name}: {error}")
    measured = from_its_start(read_recording(shared("real/rtkexp_drive.npz")))
    assert isinstance(measured, Recording)
    with tempfile.TemporaryDirectory() as folder:
        believed = load_nominal(cases(Path(folder))["rtkexp_drive"])
    static = at_rest(measured)
    tell("rtkexp_drive, velocities as they are", judge(levels_of(measured, replace(believed, beliefs=static))))
    report = find_gap(measured, believed, rng=np.random.default_rng(1), hold_out=False, pictures=False)
    known = refined_nominal(believed, report, measured.imu.dt)
    tell("rtkexp_drive, what gap finds taken off", judge(levels_of(measured, known, static)))


def tell(name: str, rows: Sequence[Judged]) -> None:
    """Print the judge's rows of one drive."""
    for j in rows:
        print(
            f"{name} {j.name}: {j.outages} outages, log density {j.score:.2f}, against static {j.gain[0]:+.2f} (sd {j.gain[1]:.2f}), "
            f"{j.metres:.1f} m rms, {j.inside:.0%} inside 95 %",
            flush=True,
        )


def together(count: int) -> None:
    """Print what tuning constants of the IMU with the noise gains, and the constants and the slow noise of the gyroscopes (truly 1) it finds."""
    held = 0
    for seed in range(count):
        skewed = replace(drive_of(10.0, SCALE, ACROSS, seed), extras=CONSTANTS)
        found = estimated(skewed)
        alone = estimated(replace(skewed, extras=Extras()), at=found.log)
        slow, slow_alone = (next(f for f in e.factors if f.name == "gyro slow") for e in (found, alone))
        scale = next(c for c in skewed.constants(np.exp(found.log).tolist()) if c.name == "gyro_z.scale")
        held += abs(scale.value - SCALE) < 1.96 * scale.sigma
        levels = [f"{f.value:.2f} ({f.low:.2f} to {f.high:.2f})" for f in (slow, slow_alone)]
        gained = f"{found.value - alone.value:+.1f} nats with the constants"
        constant = f"scale of gyro z {100 * scale.value:.2f} +- {100 * scale.sigma:.2f} %"
        print(f"drive {seed}: {gained}; {constant}; slow noise {levels[0]}, without {levels[1]}", flush=True)
    print(f"95 % intervals that hold the scale: {held} of {count}")


if __name__ == "__main__":
    what, number = sys.argv[1] if len(sys.argv) > 1 else "factors", int(sys.argv[2]) if len(sys.argv) > 2 else 24
    begin = int(sys.argv[3]) if len(sys.argv) > 3 else 0
    {
        "factors": lambda: factors(number),
        "causes": lambda: causes(number, begin),
        "real": real,
        "together": lambda: together(number),
    }[what]()
