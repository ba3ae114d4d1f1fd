"""Speed of the emulator on one core: mechanization, ideal IMU, every sensor error at once, GNSS.

Run ``python benchmarks/emulate.py``. Seconds are CPU time of this process, its threads together, warm (compiled, and the
filter of flicker noise known for this length), the best of several runs. Peers, in the same run: for the mechanization
the same step interpreted by Python; for the sensor errors the drawing of six white noises by numpy.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from textwrap import fill

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from insemu import strapdown
from insemu.effects import EFFECTS, EffectUse
from insemu.emulate import TemperatureProfile, built_in, corrupt, gnss_fixes, ideal_imu
from insemu.noise import GM, WN
from insemu.records import AXES

MINIMUM = {"mechanization": 3e6, "every sensor error": 1e6, "the whole catalogue at once": 1e6}

#: What a data sheet lists beside the noise model per axis.
SENSOR_ERRORS = (
    "turn_on_bias", "scale_factor", "scale_asymmetry", "scale_nonlinearity", "misalignment", "mounting", "g_sensitivity",
    "temperature", "quantization", "saturation", "decimation_filter", "vibration_line", "vibration_band",
    "imu_gnss_time_offset", "clock_drift", "time_jitter", "dropped_samples",
)  # fmt: skip


def cpu(work: Callable[[], object], repeats: int) -> float:
    """Least CPU seconds of several calls."""
    best = np.inf
    for _ in range(repeats):
        started = time.process_time()
        work()
        best = min(best, time.process_time() - started)
    return best


def every_effect(ids: Iterable[str] = tuple(EFFECTS)) -> list[EffectUse]:
    """Effects of gyro, accelerometer and IMU at their datasheet scale, on both sensors where both can have them."""
    uses = []
    for effect in (EFFECTS[i] for i in ids):
        for sensor in effect.sensors:
            if sensor == "gnss":
                continue
            values = {
                p.name: (effect.scale(p.name, sensor),) * (p.size if p.size == 6 else 1) for p in effect.parameters
            }
            if effect.id == "vibration_line":
                values["rest_factor"] = (0.3,)
            if effect.id == "saturation":
                values["limit"] = tuple(10 * x for x in values["limit"])
            uses.append(EffectUse(effect.id, sensor, values))
    return uses


def main() -> int:
    flight = built_in("helicopter_mapping")
    ideal = ideal_imu(flight)
    n = len(ideal.imu)
    start = strapdown.NavState.of(ideal.reference)
    nodes = flight.path.sample(ideal.imu.t)
    truth = {axis: 2 * GM(1e-4, 0.01) + WN(1e-4) for axis in AXES}
    temperature = TemperatureProfile((0.0, 1200.0), (20.0, 45.0))
    uses, catalogue = every_effect(SENSOR_ERRORS), every_effect()
    rng = np.random.default_rng(1)

    def interpreted() -> None:
        nav = start.to_array()
        step = strapdown.step.py_func
        gyro, accel = ideal.imu.gyro, ideal.imu.accel
        for k in range(1, 501):
            step(nav, gyro[k], accel[k], gyro[max(k - 1, 1)], accel[max(k - 1, 1)], 0.01, 0.01, 0)

    def all_errors(effects: list[EffectUse]) -> None:
        corrupt(ideal.imu, truth, rng, effects=effects, reference=ideal.reference, temperature=temperature)

    work: list[tuple[str, Callable[[], object], float, int]] = [
        ("mechanization", lambda: strapdown.mechanize_array(ideal.imu, start), n, 20),
        ("the same step in Python", interpreted, 500, 3),
        ("ideal IMU, exact, from nodes", lambda: ideal_imu(nodes), n, 7),
        ("ideal IMU, exact, from the path", lambda: ideal_imu(flight), n, 7),
        ("ideal IMU, continuous", lambda: ideal_imu(flight, mode="continuous"), n, 3),
        ("noise model (2 GM + WN per axis)", lambda: corrupt(ideal.imu, truth, rng), n, 7),
        ("every sensor error", lambda: all_errors(uses), n, 7),
        ("the whole catalogue at once", lambda: all_errors(catalogue), n, 5),
        ("six white noises", lambda: rng.standard_normal((n, 6)), n, 7),
        ("GNSS fixes, 10 Hz", lambda: gnss_fixes(ideal.reference, 10.0, rng=rng), n / 10, 7),
    ]
    rates = {}
    print(f"{'':<36}{'million/s':>12}{'ns each':>10}")
    for name, run, count, repeats in work:
        run()
        seconds = cpu(run, repeats)
        rates[name] = count / seconds
        print(f"{name:<36}{rates[name] / 1e6:>12.3f}{1e9 * seconds / count:>10.0f}")
    print(f"\nmechanization / the same step in Python: {rates['mechanization'] / rates['the same step in Python']:.0f}")
    noise = "a noise model of two Gauss-Markov processes and white noise on each of six axes"
    for name, chosen in (("every sensor error", uses), ("the whole catalogue at once", catalogue)):
        by_id: dict[str, list[str]] = {}
        for use in chosen:
            by_id.setdefault(use.id, []).append(use.sensor)
        cost = rates["six white noises"] / rates[name]
        print(f"\n{name}: {cost:.1f} times the cost of six white noises; {noise} and {len(chosen)} effects:")
        print(fill(", ".join(f"{i} ({' and '.join(on)})" for i, on in by_id.items()), 120))
    print()
    missed = [name for name, least in MINIMUM.items() if rates[name] < least]
    for name, least in MINIMUM.items():
        print(f"{name}: at least {least / 1e6:g} million/s asked for, {'reached' if name not in missed else 'MISSED'}")
    return 1 if missed else 0


if __name__ == "__main__":
    raise SystemExit(main())
