"""One drive as ordinary loggers write it: what every command answers, held against the answers to the drive written plainly.

python -m benchmarks.loggers [rest] [NAME ...]      logs at rest, and variants of the drive; all of them without a name

The variants are those of `cases/logger/variants.py` of the shared folder. It writes another rate by interpolation between two samples, which is a
low-pass filter (at 104 Hz it leaves 67 % of the variance of white noise) that `gap` names. `white104` is the same drive at that rate with the band
kept, and above it the white noise that the slower record lacks, so that nothing but the stamps differs.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

import numpy as np
import scipy
import yaml
from numpy.typing import NDArray

from insemu.emulate import dead_reckon
from insemu.evaluate import Experiment, run_experiment
from insemu.formats import write
from insemu.gap import Nominal, check, find_gap, from_its_start, load_nominal
from insemu.intake import recording_of, take
from insemu.logs import characterise_log, open_log
from insemu.noise import RC, WN
from insemu.prepared import prepared
from insemu.records import AXES, Recording
from insemu.scenario import load
from insemu.solve import Solution, candidates, solve
from insemu.solve import write as write_solution
from insemu.solve.solution import scored
from insemu.transfer import transfer
from tests.shared_data import shared

Array = NDArray[np.float64]

#: What is true of the drive: white noise in rad/s/sqrt(Hz) and m/s^2/sqrt(Hz), and biases that no model states better.
BELIEVED = Nominal(
    {
        a: WN(N=np.deg2rad(0.007)) + RC(sigma=np.deg2rad(0.05))
        if a.startswith("gyro")
        else WN(N=9.8e-4) + RC(sigma=0.05)
        for a in AXES
    }
)
#: Rates of logs at rest, Hz, stamped in ms; their noise, rad/s/sqrt(Hz) and m/s^2/sqrt(Hz).
RATES, AT_REST = (64.0, 95.0, 104.0, 119.0), (1e-4, 1e-3)
HORIZONS = (10.0, 30.0)


def logger() -> ModuleType:
    """The shared script that writes the variants."""
    spec = spec_from_file_location("variants", shared("cases/logger/variants.py"))
    assert spec is not None and spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def faster(x: Array, rate: float, white: float, rng: np.random.Generator) -> Array:
    """Samples at 100 Hz (n, 3) at a faster rate, Hz: their band as it is, above it white noise of a standard deviation per sample at 100 Hz."""
    n = round(len(x) * rate / 100.0)
    out = scipy.signal.resample(np.vstack([x, x[::-1]]), 2 * n, axis=0)[:n]
    above = np.fft.rfft(white * np.sqrt(rate / 100.0) * rng.standard_normal((n, 3)), axis=0)
    above[np.fft.rfftfreq(n, 1.0 / rate) <= 50.0] = 0.0
    return np.asarray(out + np.fft.irfft(above, n, axis=0))


def written(folder: Path) -> list[str]:
    """Write all variants; their names."""
    script = logger()
    script.main(folder)
    rng, rate = np.random.default_rng(104), 104.0
    accel, gyro = (faster(x, rate, w, rng) for x, w in ((script.ACCEL, 9.8e-3), (script.GYRO, np.deg2rad(0.07))))
    script.write_imu(folder / "white104_imu.csv", script.T[0] + np.arange(len(gyro)) / rate, accel, gyro, 3)
    script.write_gnss(folder / "white104_gnss.csv", script.FIX_T, script.LLH, script.VEL)
    names = sorted(p.name.removesuffix("_imu.csv") for p in folder.glob("*_imu.csv"))
    return ["clean", *(n for n in names if n != "clean")]


def assumed(recording: Recording, folder: Path) -> dict[str, tuple[str, ...]]:
    """What commands assume of the standard deviations of the fixes; all of them ran to their end."""
    path, scenario = write(folder / "drive.npz", recording), folder / "drive.yaml"
    noise = {sensor: str(BELIEVED.beliefs[f"{sensor}_x"]) for sensor in ("gyro", "accel")}
    body = {"title": "drive", "seed": 1, "realizations": 1, "recording": {"file": path.name}, "designs": {"own": noise}}
    scenario.write_text(yaml.safe_dump(body), encoding="utf-8")
    experiment = Experiment(load(scenario), scenario)
    run_experiment(experiment)
    alone, start, said = prepared(recording).started().alone()
    dead_reckon(alone, start=start)
    found = {
        "run": tuple(experiment.warnings),
        "dead-reckon": said,
        "gap-check": tuple(check(recording, BELIEVED, recordings=20).assumed),
        "transfer": tuple(transfer(recording, BELIEVED, rng=np.random.default_rng(1), why=False).assumed),
    }
    return {k: stated_nowhere(v) for k, v in found.items()}


def stated_nowhere(said: Sequence[str]) -> tuple[str, ...]:
    """Of remarks those about standard deviations that a file does not state, without the file's name before them."""
    return tuple(s[s.index("the ") :] for s in said if "state no standard deviations" in s)


@dataclass(frozen=True)
class Answers:
    """What all commands answer to one variant: solution, rows that are lost, metres, names of `gap` with two models, assumptions, CPU seconds."""

    solution: Solution

    lost: int
    metres: list[float]
    names: list[list[str]]
    assumed: dict[str, tuple[str, ...]]
    cpu: float


def answers(folder: Path, name: str) -> Answers:
    """Ask all commands about one variant."""
    imu, began = folder / f"{name}_imu.csv", time.process_time()
    found, card = take(imu, gnss=str(folder / f"{name}_gnss.csv"), maps=("", "", ""))
    recording = recording_of(found)
    with imu.open(encoding="utf-8") as lines:
        rows = sum(1 for _ in lines) - 1
    solution = solve(recording, card, candidates(), workers=1)
    o = solution.taken.outages
    write_solution(solution, folder / name)
    moved, models = from_its_start(recording), (BELIEVED, load_nominal(folder / name / "models.yaml"))
    gaps = [find_gap(moved, m, rng=np.random.default_rng(1), hold_out=False) for m in models]
    said = {"solve": stated_nowhere(solution.drive.said), "gap": stated_nowhere(gaps[0].assumed)}
    metres = [o.rms(int(np.flatnonzero(o.horizons == h)[0])) for h in HORIZONS]
    names = [sorted({f.effect for f in g.findings}) for g in gaps]
    return Answers(
        solution, rows - len(recording.imu), metres, names, said | assumed(moved, folder), time.process_time() - began
    )


def without_velocities(clean: Solution) -> list[float]:
    """Metres of the design of the plain drive from its own start, with its fixes less their velocities: what positions can tell."""
    drive, taken = clean.drive, clean.taken
    o = scored(taken.candidate, replace(drive, gnss=drive.gnss.without_velocity()), 1.0, 1).outages
    return [o.rms(int(np.flatnonzero(o.horizons == h)[0])) for h in HORIZONS]


def at_rest(folder: Path) -> Iterator[tuple[str, str, float, float]]:
    """File, axis, relative error of N and the same over half of its 95 % interval, of hours at rest; RATES are stamped in ms."""
    script, rng = logger(), np.random.default_rng(70)
    for rate in RATES:
        n = round(3600.0 * rate)
        gyro, accel = (s * np.sqrt(rate) * rng.standard_normal((n, 3)) for s in AT_REST)
        script.write_imu(folder / f"rest{rate:.0f}.csv", np.arange(n) / rate, accel - [0.0, 0.0, 9.81], gyro, 3)
    for path in sorted(folder.glob("rest*.csv")):
        for report in characterise_log(open_log(path)):
            found, true = report.readings["N"], AT_REST[report.name.startswith("a")]
            off = found.si_value / true - 1.0
            yield path.stem, report.name, off, off / (0.5 * (found.high - found.low) / found.value)


def main(arguments: list[str]) -> None:
    """Print a line for each file and the sums."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        names = written(folder)
        if "rest" in arguments or not arguments:
            rows = list(at_rest(folder))
            for file in sorted({r[0] for r in rows}):
                each = (f"{axis} {100 * off:+.2f} % ({of:+.2f})" for f, axis, off, of in rows if f == file)
                print(f"{file:14s} N (over half its interval) " + ", ".join(each), flush=True)
            near, inside = sum(abs(r[2]) <= 0.003 for r in rows), sum(abs(r[3]) <= 1.0 for r in rows)
            print(f"-- at rest: {near} of {len(rows)} within 0.3 %, {inside} inside the interval", flush=True)
        clean: Answers | None = None
        for variant in [
            n for n in names if not arguments or n in arguments or (n == "clean" and arguments != ["rest"])
        ]:
            try:
                a = answers(folder, variant)
            except Exception as error:
                print(f"{variant:24s} FAILS: {type(error).__name__}: {error}", flush=True)
                continue
            clean = clean or a
            times = np.divide(a.metres, clean.metres)
            same = "the same" if len(set(a.assumed.values())) == 1 else str(a.assumed)
            gap = " | own models: ".join(" + ".join(n) or "nothing" for n in a.names)
            print(
                f"{variant:24s} rows lost {a.lost}, metres {a.metres[0]:.2f} {a.metres[1]:.2f} (x {times[0]:.2f} {times[1]:.2f}), "
                f"{len(a.assumed)} commands assume {same}, gap: {gap}, {a.cpu:.0f} CPU s",
                flush=True,
            )
            if a.solution.drive.gnss.vel_ned is None:
                least = without_velocities(clean.solution)
                print(
                    f"{'':24s} the plain drive, from its start, with positions alone: {least[0]:.2f} {least[1]:.2f} m",
                    flush=True,
                )


if __name__ == "__main__":
    main(sys.argv[1:])
