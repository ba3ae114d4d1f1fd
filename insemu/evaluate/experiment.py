"""Realizations x designs: every realization is one independent work item in which all designs fly the same data.

Truth and belief never share a variable: the emulator gets ``scenario.truth``, the filters get what :func:`beliefs` resolved. Finished
items are kept under the experiment's digest, so an interrupted run goes on where it stopped, whatever the number of workers.
"""

from __future__ import annotations

import platform
import subprocess
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Executor, ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field
from functools import cached_property
from importlib import metadata
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

import insemu
from insemu import earth
from insemu.emulate import Outage, RecordedErrors, built_in, gnss_fixes, ideal_imu
from insemu.emulate.errors import add_rates
from insemu.emulate.pieces import ErrorPieces, recorded_pieces, simulated_pieces
from insemu.errors import InputError
from insemu.evaluate.errors import navigation_error
from insemu.evaluate.results import DesignInfo, Results
from insemu.filters import FilterOptions, InitialSigma, LooselyCoupledEKF
from insemu.fit import FitResult, fit
from insemu.formats import AXIS_OF_COLUMN, read_static
from insemu.noise import NoiseModel, axis_unit, load
from insemu.records import AXES, ImuRecord, Series, Trajectory
from insemu.scenario import AxisSource, RecordedSignal, Scenario, digest, resolve_path
from insemu.strapdown import NavState

Array = NDArray[np.float64]
Progress = Callable[[int, int, str], None]

#: Streams of randomness; each gets children of the scenario's seed by (stream, realization or record, axis).
_STREAMS = {"truth": 0, "gnss": 1, "initial": 2, "fits": 3}
#: Interval of the epochs at which errors are evaluated, s.
OUTPUT_INTERVAL = 1.0


def stream(seed: int, name: str, *index: int) -> np.random.Generator:
    """The generator of one stream, for example ``stream(seed, "truth", record, axis)``: the same alone or among 1000."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_STREAMS[name], *index)))


def silent(done: int, total: int, label: str) -> None:
    """Progress that says nothing."""


@dataclass(frozen=True)
class Belief:
    """A resolved belief of one design, with the fits it came from (axis to fit)."""

    models: Mapping[str, NoiseModel]
    fits: Mapping[str, FitResult] = field(default_factory=dict)


def _outages(scenario: Scenario) -> list[Outage]:
    return [Outage(o.start, o.duration) for o in scenario.gnss.outages]


def input_files(scenario: Scenario, file: str | Path | None) -> dict[str, Path]:
    """Every file that the scenario names, by the name it uses."""
    names: list[str] = []
    for recorded in (scenario.truth.recorded, scenario.fits.recorded if scenario.fits else None):
        names += list(recorded.files) if recorded else []
    for design in scenario.designs.values():
        names += [s.file for s in design.sources().values() if isinstance(s, AxisSource) and s.file]
    return {name: resolve_path(name, file) for name in dict.fromkeys(names)}


def _logs(recorded: RecordedSignal, files: Mapping[str, Path]) -> list[dict[str, Series]]:
    """The six axes of every static log, warm-up left out."""
    out = []
    for name in recorded.files:
        by_axis = {AXIS_OF_COLUMN.get(s.name, s.name): s for s in read_static(files[name])}
        missing = [axis for axis in AXES if axis not in by_axis]
        if missing:
            raise InputError(f"no column for {', '.join(missing)}", where=name)
        cut = {}
        for axis in AXES:
            s = by_axis[axis]
            start = round(recorded.skip * s.rate_hz)
            if start >= len(s):
                raise InputError(
                    f"the warm-up of {recorded.skip:g} s is longer than the record of {len(s) / s.rate_hz:g} s",
                    where=name,
                )
            cut[axis] = Series(s.values[start:], s.rate_hz, s.unit, axis)
        out.append(cut)
    return out


class Experiment:
    """A scenario made ready to run: trajectory, ideal signals, truth, and resolved beliefs.

    Parameters
    ----------
    scenario : Scenario
    file : path, optional
        Where it was read from; relative paths in it are relative to that file.

    Raises
    ------
    InputError
        Missing or unusable input, an outage beyond the end, a signal shorter than the flight.
    """

    def __init__(self, scenario: Scenario, file: str | Path | None = None) -> None:
        self.scenario = scenario
        self.file = file
        self.files = input_files(scenario, file)
        self.digest = digest(scenario, self.files)
        source = scenario.trajectory
        flight = built_in(source.builtin or "").path
        span = None if source.duration is None else (flight.start, min(flight.end, flight.start + source.duration))
        ideal = ideal_imu(flight, source.rate, mode=source.mode, span=span)
        self.reference: Trajectory = ideal.reference
        self.imu: ImuRecord = ideal.imu
        self.path_distance_m: float = ideal.path_distance_m
        length = float(self.reference.t[-1] - self.reference.t[0])
        for k, outage in enumerate(scenario.gnss.outages):  # before anything is flown, with the key that says it
            if outage.start + outage.duration > length + 1e-9:
                raise InputError(
                    f"outage {k + 1} ends at {outage.start + outage.duration:g} s, but the trajectory ends at {length:g} s",
                    where=f"{file or 'scenario'}: gnss.outages.{k}",
                )
        self._lock = Lock()
        if self.pieces.count is not None and scenario.realizations > self.pieces.count:
            raise InputError(
                f"{scenario.realizations} realizations of {length:g} s asked for, but the recorded signals hold "
                f"{self.pieces.count} non-overlapping pieces of that length",
                where=f"{file or 'scenario'}: truth.recorded",
            )

    @property
    def dt(self) -> float:
        """IMU interval, s."""
        return 1.0 / self.scenario.trajectory.rate

    @cached_property
    def pieces(self) -> ErrorPieces:
        """The source of true error signals, one piece a realization."""
        truth, n = self.scenario.truth, len(self.reference)
        if truth.recorded is not None:
            records = [
                RecordedErrors(
                    np.stack([log[axis].values for axis in AXES], axis=1),
                    log["gyro_x"].rate_hz,
                    truth.recorded.remove_mean,
                    name=name,
                )
                for name, log in zip(truth.recorded.files, _logs(truth.recorded, self.files), strict=True)
            ]
            return recorded_pieces(records, n, self.scenario.trajectory.rate)
        return simulated_pieces(
            truth.models(),
            n,
            self.scenario.trajectory.rate,
            record_s=truth.record,
            rng=lambda record, axis: stream(self.scenario.seed, "truth", record, axis),
        )

    @cached_property
    def fit_logs(self) -> dict[str, list[Series]]:
        """The signals that models are fitted to, per axis."""
        source = self.scenario.fits
        if source is None:
            return {}
        if source.recorded is not None:
            logs = _logs(source.recorded, self.files)
            return {axis: [log[axis] for log in logs] for axis in AXES}
        assert source.simulate is not None
        rate = self.scenario.trajectory.rate
        n = round(source.simulate * rate)
        out: dict[str, list[Series]] = {}
        drawn: dict[NoiseModel, Series] = {}
        for index, (axis, model) in enumerate(self.scenario.truth.models().items()):
            if model not in drawn:  # axes with one truth share one log, as one sensor type has one calibration
                values = model.at_rate(rate).simulate(n, 1.0 / rate, stream(self.scenario.seed, "fits", index))
                drawn[model] = Series(values - values.mean(), rate, axis_unit(axis), axis)
            out[axis] = [drawn[model]]
        return out

    @cached_property
    def beliefs(self) -> dict[str, Belief]:
        """What every design believes, models fitted where the scenario says so."""
        done: dict[tuple[str, int], FitResult] = {}
        out = {}
        for name, design in self.scenario.designs.items():
            models: dict[str, NoiseModel] = {}
            fits: dict[str, FitResult] = {}
            for axis, source in design.sources().items():
                if isinstance(source, NoiseModel):
                    models[axis] = source
                elif source.truth:
                    models[axis] = self.scenario.truth.models()[axis]
                elif source.file:
                    models[axis] = self._from_file(source.file, axis)
                else:
                    assert source.fit is not None
                    log = self.fit_logs[axis][0]
                    key = (source.fit, id(log))
                    if key not in done:
                        done[key] = fit(log, NoiseModel.parse(source.fit, axis_unit(axis)))
                    fits[axis] = done[key]
                    models[axis] = done[key].model
            out[name] = Belief({axis: m.at_rate(self.scenario.trajectory.rate) for axis, m in models.items()}, fits)
        return out

    def _from_file(self, name: str, axis: str) -> NoiseModel:
        models = load(self.files[name])
        if axis not in models:
            raise InputError(f"no model for {axis}, expected one of: {', '.join(models)}", where=name)
        return models[axis]

    @cached_property
    def filters(self) -> dict[str, LooselyCoupledEKF]:
        """One filter per design."""
        gnss = self.scenario.gnss
        every = max(1, round(OUTPUT_INTERVAL * self.scenario.trajectory.rate))
        options = FilterOptions(output_every=every, covariance_at=tuple(self.output_times[1:]))
        sigma = (gnss.position_sigma, gnss.velocity_sigma or (np.nan,) * 3)
        return {
            name: LooselyCoupledEKF(b.models, self.dt, lever_arm=gnss.lever_arm, gnss_sigma=sigma, options=options)
            for name, b in self.beliefs.items()
        }

    @cached_property
    def output_times(self) -> Array:
        """Epochs at which errors are evaluated."""
        every = max(1, round(OUTPUT_INTERVAL * self.scenario.trajectory.rate))
        return self.reference.t[::every]

    @cached_property
    def truth_at_outputs(self) -> Trajectory:
        """The reference at the output epochs."""
        every = max(1, round(OUTPUT_INTERVAL * self.scenario.trajectory.rate))
        r = self.reference
        return Trajectory(r.t[::every], r.llh[::every], r.vel_ned[::every], r.rpy[::every], r.name)

    def initial(self, realization: int) -> tuple[NavState, InitialSigma]:
        """The filter's start: the truth moved by a draw from the sigmas that the filter believes."""
        i = self.scenario.initial
        attitude = (i.tilt_sigma, i.tilt_sigma, i.heading_sigma)
        draw = stream(self.scenario.seed, "initial", realization).standard_normal(9)
        start = NavState.of(self.reference)
        moved = NavState(
            earth.move(start.llh, draw[:3] * np.array(i.position_sigma)),
            start.vel_ned + draw[3:6] * np.array(i.velocity_sigma),
            start.rpy + draw[6:9] * np.array(attitude),
        )
        return moved, InitialSigma(position=i.position_sigma, velocity=i.velocity_sigma, attitude=attitude)

    def realization(self, index: int) -> dict[str, Array]:
        """Fly every design through one realization.

        Returns
        -------
        dict of arrays
            ``error, sigma`` (design, time, 9); ``nees`` (design, time); ``nis`` (design,); ``epochs``, ``seconds``.
        """
        s = self.scenario
        with self._lock:  # a simulated record serves many pieces; one thread draws it
            signals = self.pieces.piece(index)
        imu = add_rates(self.imu, signals[:, :3], signals[:, 3:])
        fixes = gnss_fixes(
            self.reference,
            rate_hz=s.gnss.rate,
            pos_sigma_ned=s.gnss.position_sigma,
            vel_sigma_ned=s.gnss.velocity_sigma,
            lever_arm=s.gnss.lever_arm,
            outages=_outages(s),
            rng=stream(s.seed, "gnss", index),
        )
        start, start_sigma = self.initial(index)
        out: dict[str, list[Any]] = {"error": [], "sigma": [], "nees": [], "nis": [], "epochs": [], "seconds": []}
        for ekf in self.filters.values():
            run = ekf.run(imu, fixes, start, start_sigma)
            error = navigation_error(run.trajectory, self.truth_at_outputs)
            covariance = run.covariance[:, :9, :9]
            nees = np.zeros(len(error))
            nees[1:] = np.einsum("ti,ti->t", error[1:], np.linalg.solve(covariance, error[1:, :, None])[..., 0])
            first = error[0] / run.sigma[0, :9]
            nees[0] = first @ first
            used = run.fixes.accepted
            out["error"].append(error)
            out["sigma"].append(run.sigma[:, :9])
            out["nees"].append(nees)
            out["nis"].append(float(run.fixes.nis[used].sum() / max(1, run.fixes.dof[used].sum())))
            out["epochs"].append(run.epochs)
            out["seconds"].append(run.seconds)
        return {name: np.array(values) for name, values in out.items()}


def git_revision() -> str | None:
    """Revision of the checkout that the package runs from, or None."""
    root = Path(insemu.__file__).resolve().parents[1]
    try:
        found = subprocess.run(
            ["git", "-C", str(root), "describe", "--always", "--dirty"],
            capture_output=True,
            text=True,
            timeout=10,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return found.stdout.strip() or None if found.returncode == 0 else None


def manifest_of(experiment: Experiment) -> dict[str, Any]:
    """What a result needs to be a result: resolved scenario, digest, seed, versions, git revision."""
    packages = ("numpy", "scipy", "numba", "xarray", "pydantic")
    return {
        "scenario": experiment.scenario.model_dump(mode="json"),
        "scenario_file": str(experiment.file) if experiment.file else None,
        "digest": experiment.digest,
        "seed": experiment.scenario.seed,
        "insemu": insemu.__version__,
        "git": git_revision(),
        "python": platform.python_version(),
        "packages": {name: metadata.version(name) for name in packages},
        "ideal_imu_distance_m": experiment.path_distance_m,
        "beliefs": {
            name: {axis: m.to_list(axis_unit(axis)) for axis, m in b.models.items()}
            for name, b in experiment.beliefs.items()
        },
    }


def run_experiment(
    experiment: Experiment,
    *,
    realizations: int | None = None,
    workers: int = 1,
    executor: Executor | None = None,
    cache: Path | None = None,
    progress: Progress = silent,
) -> Results:
    """Run every realization and collect.

    Parameters
    ----------
    experiment : Experiment
    realizations : int, optional
        Number to run; default the scenario's.
    workers : int
        Threads (the compiled filter frees the GIL).
    executor : Executor, optional
        Any ``concurrent.futures`` executor instead, for example a cluster's; the experiment must be picklable there.
    cache : path, optional
        Folder in which finished realizations are kept and looked for.
    progress : callable
        Called with (done, total, label).

    Returns
    -------
    Results
    """
    started = time.perf_counter()
    total = realizations if realizations is not None else experiment.scenario.realizations
    folder = cache / experiment.digest if cache is not None else None
    items: dict[int, dict[str, Array]] = {}
    for r in range(total):
        kept = _kept(folder, r)
        if kept is not None:
            items[r] = kept
    todo = [r for r in range(total) if r not in items]
    if todo:
        progress(len(items), total, "preparing")
        _ = experiment.filters, experiment.pieces  # resolve fits once, before the threads
    progress(len(items), total, "flying")
    own = executor is None
    pool = executor if executor is not None else ThreadPoolExecutor(max_workers=max(1, workers))
    try:
        futures = {pool.submit(experiment.realization, r): r for r in todo}
        for future in as_completed(futures):
            r = futures[future]
            items[r] = future.result()
            _keep(folder, r, items[r])
            progress(len(items), total, "flying")
    finally:
        if own:
            pool.shutdown(wait=True, cancel_futures=True)
    stacked = {
        name: np.stack([items[r][name] for r in range(total)], axis=1) for name in ("error", "sigma", "nees", "nis")
    }
    designs = {
        name: DesignInfo(ekf.layout.n, tuple(ekf.layout.names), experiment.beliefs[name].models)
        for name, ekf in experiment.filters.items()
    }
    s = experiment.scenario
    timing = {
        "filter_epochs": int(sum(int(items[r]["epochs"].sum()) for r in range(total))),
        "filter_seconds": float(sum(float(items[r]["seconds"].sum()) for r in range(total))),
        "wall_seconds": time.perf_counter() - started,
    }
    return Results(
        title=s.title,
        digest=experiment.digest,
        seed=s.seed,
        t=experiment.output_times,
        designs=designs,
        outages=[(o.start, o.duration) for o in s.gnss.outages],
        truth=experiment.truth_at_outputs,
        timing=timing,
        manifest=manifest_of(experiment) | {"timing": timing},
        published=dict(s.published.planimetric_end_m) if s.published else {},
        **stacked,
    )


def _kept(folder: Path | None, realization: int) -> dict[str, Array] | None:
    if folder is None:
        return None
    path = folder / f"{realization:05d}.npz"
    try:
        with np.load(path, allow_pickle=False) as data:
            return {name: data[name] for name in data.files}
    except (OSError, ValueError, EOFError, KeyError):
        return None  # absent or half-written: flown again


def _keep(folder: Path | None, realization: int, item: Mapping[str, Array]) -> None:
    if folder is None:
        return
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{realization:05d}.npz"
    partial = path.with_suffix(".tmp")
    with partial.open("wb") as handle:
        np.savez(handle, allow_pickle=False, **item)
    partial.replace(path)  # a reader sees a whole file or none
