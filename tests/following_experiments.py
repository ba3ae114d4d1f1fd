"""Experiments behind the claims about noise that follows a covariate.

``python -m tests.following_experiments NAME [--logs N]`` prints a table; the tests assert on the same functions. Seeds are fixed.
"""

from __future__ import annotations

import time
from collections import defaultdict

import numpy as np
import typer

from insemu.effects import EffectUse
from insemu.emulate import TemperatureProfile, corrupt
from insemu.fit import fit_following
from insemu.noise import WN, Follows, NoiseModel
from insemu.records import ImuRecord, Series, Trajectory

app = typer.Typer(add_completion=False, no_args_is_help=True)

#: An hour at 10 Hz while the sensor warms by 30 K and cools again.
RATE, N = 10.0, 36_000
TEMPERATURE = 25.0 + 15.0 * np.sin(2.0 * np.pi * np.arange(N) / N)
#: Models by name: one level follows, two follow, a walk follows.
TRUTH = {
    "white noise follows": "WN(N=1e-3, follows=temperature, slope={b}, at=25) + GM(sigma=5e-4, beta=0.05)",
    "both follow": "WN(N=1e-3, follows=temperature, slope={b}, at=25) + GM(sigma=1e-3, beta=0.2, follows=temperature, slope={b}, at=25)",
    "random walk follows": "WN(N=1e-3) + RW(K=1e-3, follows=temperature, slope={b}, at=25)",
}
#: The same where correlation times follow.
TIMES = {
    "GM's time follows": "WN(N=1e-4) + GM(sigma=1e-3, beta=0.2, follows=temperature, slope={b}, at=25, what=time)",
    "AR1's time follows": "AR1(phi=0.9, sigma2=1e-6, rate_hz=10, follows=temperature, slope={b}, at=25, what=time)",
    "AR(2)'s times follow": "AR(ar=[1.5, -0.7], sigma2=1e-6, rate_hz=10, follows=temperature, slope={b}, at=25, what=time)",
}
#: Slope of the logarithm of the level or time, 1/K: a factor of 2.5 over the range.
SLOPE = 0.03


def structure_of(model: NoiseModel) -> str:
    """The model without its values."""
    return " + ".join(
        f"{p.symbol}({', '.join(([str(p.order)] if p.symbol == 'AR' else []) + _law_of(p.follows))})" for p in model
    )


def _law_of(law: Follows | None) -> list[str]:
    return [] if law is None else ["follows=temperature", "at=25", f"what={law.what}"]


def coverage(text: str, slope: float, logs: int, seed: int = 1801) -> tuple[dict[str, float], float]:
    """How often intervals hold the truth, by parameter, and how often the test of fit rejects at 5 %."""
    truth = NoiseModel.parse(text.format(b=slope))
    asked = NoiseModel.parse(structure_of(truth))
    inside: dict[str, list[bool]] = defaultdict(list)
    rejected = []
    for rng in np.random.default_rng(seed).spawn(logs):
        x = truth.simulate(N, 1.0 / RATE, rng, {"temperature": TEMPERATURE})
        found = fit_following(Series(x, RATE, "rad/s", "gyro_x"), {"temperature": TEMPERATURE}, asked)
        true = {(p.symbol, i): {**p.parameters, "slope": slope} for i, p in truth.indexed()}
        for e in found.result.parameters:
            inside[e.label].append(e.low <= true[e.process, e.index][e.name] <= e.high)
        test = found.result.test
        rejected.append(test is not None and test.p_value < 0.05)
    return {k: float(np.mean(v)) for k, v in inside.items()}, float(np.mean(rejected))


@app.command("coverage")
def print_coverage(logs: int = 200, only: str = "") -> None:
    """Coverage of 95 % intervals; at slope 0 that of the slope is how often "does not follow" is accepted at 5 %."""
    for name, text in (TRUTH | TIMES).items():
        if only not in name:
            continue
        for slope in (SLOPE, 0.0):
            began = time.process_time()
            inside, rejected = coverage(text, slope, logs)
            shares = ", ".join(f"{k} {100 * v:.1f} %" for k, v in inside.items())
            each = (time.process_time() - began) / logs
            print(
                f"{name}, b = {slope:g} 1/K: {shares}; test of fit rejects {100 * rejected:.1f} %; {each:.2f} CPU s each"
            )


def moving(n: int, rate: float, speed: np.ndarray) -> tuple[ImuRecord, Trajectory]:
    """An IMU without a signal, and a reference of this speed."""
    t = np.arange(n) / rate
    zeros = np.zeros((n, 3))
    velocity = np.column_stack([speed, zeros[:, :2]])
    return ImuRecord(t, zeros, zeros, "mean"), Trajectory(t, np.tile([0.8, 0.1, 0.0], (n, 1)), velocity, zeros)


#: What the emulator does to an IMU, the structure that is fitted, and the covariate.
EFFECTS = {
    "motion_noise": ({"N": 2e-3}, "WN() + WN(follows=speed, law=power, at=10)"),
    "temperature_noise": ({"N": 1e-4, "T0": 25.0}, "WN() + WN(follows=temperature, law=power, above=25, at=45)"),
}


def recovered(effect: str, logs: int, seed: int = 1803) -> dict[str, float]:
    """How often intervals hold what an effect of the emulator adds: density 2e-3 at 10 m/s or 45 degC, in proportion (power 1)."""
    n, rate = 12_000, 20.0
    t = np.arange(n) / rate
    speed = 12.0 + 10.0 * np.sin(2.0 * np.pi * t / 400.0)
    imu, reference = moving(n, rate, speed)
    profile = TemperatureProfile((0.0, 300.0, 600.0), (20.0, 65.0, 20.0))
    values, text = EFFECTS[effect]
    uses = [EffectUse.from_mapping({"effect": effect, "sensor": "gyro", **values})]
    covariates = {"speed": speed, "temperature": profile.at(t)}
    inside: dict[str, list[bool]] = defaultdict(list)
    for rng in np.random.default_rng(seed).spawn(-(-logs // 3)):
        got = corrupt(imu, {"gyro": WN(5e-4)}, rng, effects=uses, reference=reference, temperature=profile)
        for axis in range(3):
            signal = Series(got.imu.gyro[:, axis], rate, "rad/s", "gyro_x")
            found = fit_following(signal, covariates, NoiseModel.parse(text), segments=20).result
            for label, true in (("WN1.N", 5e-4), ("WN2.N", 2e-3), ("WN2.slope", 1.0)):
                inside[label].append(found[label].low <= true <= found[label].high)
    return {k: float(np.mean(v)) for k, v in inside.items()}


@app.command("effects")
def print_effects(logs: int = 200) -> None:
    """Effects of the emulator recovered by the fit."""
    for effect, (_, text) in EFFECTS.items():
        shares = ", ".join(f"{k} {100 * v:.1f} %" for k, v in recovered(effect, logs).items())
        print(f"{effect}, fitted as {text}: intervals hold {shares}")


if __name__ == "__main__":
    app()
