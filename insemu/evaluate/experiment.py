"""A scenario made ready: its world, its beliefs, and one realization in which all designs fly the same data.

Truth and belief never share a variable: the emulator gets ``scenario.truth``, the filters get what :func:`beliefs` resolved.
"""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from insemu import rotation
from insemu.denoise import delayed_approximation, denoise
from insemu.effects import compensated, lever_arm_of
from insemu.emulate import TrueStates
from insemu.errors import InputError, found_at
from insemu.evaluate.consistency import unaided_sigma
from insemu.evaluate.dataset import of_designs
from insemu.evaluate.emulated import EmulatedWorld
from insemu.evaluate.held import HELD, key_of
from insemu.evaluate.recorded import RecordedWorld
from insemu.evaluate.scores import run_scores, sensor_scores
from insemu.evaluate.stretched import Stretch, StretchedWorld, emulated_world
from insemu.evaluate.world import Estimate, implausible, nearest_rows, static_logs, stream
from insemu.filters import (
    FilterOptions,
    FilterParts,
    FilterResult,
    FixTable,
    InitialSigma,
    LooselyCoupledEKF,
    NavigationFilter,
    Standstill,
    check_result,
    rests,
    smooth,
    user_filter_code,
)
from insemu.fit import FitResult, fit, fit_together
from insemu.noise import ARMA, CommonDraws, NoiseModel, NotStationary, axis_unit, load
from insemu.records import AXES, AidRecord, GnssRecord, ImuRecord, RawRecord, Recording, Series, Trajectory
from insemu.scenario import AxisSource, Scenario, code_version, digest
from insemu.strapdown import NavState, trajectory_of

if TYPE_CHECKING:
    import xarray as xr


Array = NDArray[np.float64]

#: What really happens, emulated or recorded.
World = EmulatedWorld | RecordedWorld


@dataclass(frozen=True)
class Belief:
    """A resolved belief of one design, with the fits it came from (axis to fit)."""

    models: Mapping[str, NoiseModel]
    fits: Mapping[str, FitResult] = field(default_factory=dict)


@dataclass(frozen=True)
class _Realized:
    """One realization of the world."""

    recording: Recording
    true: TrueStates | None
    start: NavState
    start_sigma: InitialSigma
    raw: RawRecord | None


@dataclass(frozen=True)
class _Prepared:
    """What one design is fed of a realization, and what it is judged with: the IMU as known, the rows of the output, the true states."""

    ekf: NavigationFilter
    imu: ImuRecord
    gnss: Any  # fixes, or the raw observations
    aids: Sequence[AidRecord]
    known: ImuRecord
    rows: NDArray[np.intp]
    unaided: Array
    true: TrueStates | None


class Experiment:
    """A scenario made ready to run: its world, and the beliefs that fly through it.

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
        if not scenario.designs:
            raise InputError("the key 'designs' is missing: there is nothing to fly", where=str(file or "scenario"))
        self.world: World = (
            RecordedWorld(scenario, file) if scenario.recording is not None else emulated_world(scenario, file)
        )
        code = [file for d in scenario.designs.values() if d.filter for file in user_filter_code(d.filter).items()]
        self.digest = digest(scenario, {**self.world.files, **dict(code)})
        self._held: dict[str, tuple[bytes, tuple[NavigationFilter, Array]]] = {}
        _ = self.world.outage_windows  # what is wrong with them is said before anything is flown
        if isinstance(self.world, RecordedWorld):
            _ = self.world.alignment
        for name, design in scenario.designs.items():
            if not any(isinstance(source, AxisSource) and source.fit for source in design.sources().values()):
                self.filter(name, self._belief(name, {}))  # nor is a belief that no filter can carry

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"code": code_version(), "_held": {}}

    def __setstate__(self, state: dict[str, Any]) -> None:
        if state.pop("code") != code_version():
            raise InputError(
                "a worker has other source files of insemu than the process that asks it", where=platform.node()
            )
        self.__dict__.update(state)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What looks odd in the world's data, and what is implausible in the scenario."""
        return (*self.world.warnings, *implausible(self.scenario, str(self.file or "scenario")))

    @property
    def rate_hz(self) -> float:
        """IMU rate."""
        return self.world.rate_hz

    @property
    def samples(self) -> float:
        """IMU samples of a realization."""
        return float(np.ptp(self.world.truth_at_outputs.t)) * self.rate_hz

    @property
    def realizations(self) -> int:
        """How many there are: the scenario's number, of a recording one, because it happened once."""
        return 1 if self.scenario.recording is not None else self.scenario.realizations

    @cached_property
    def fit_logs(self) -> dict[str, list[Series]]:
        """The signals that models are fitted to, per axis."""
        source = self.scenario.fits
        if source is None:
            return {}
        if source.recorded is not None:
            logs = static_logs(source.recorded, self.world.files)
            return {axis: [log[axis] for log in logs] for axis in AXES}
        assert source.simulate is not None
        rate = self.rate_hz
        n = round(source.simulate * rate)
        out: dict[str, list[Series]] = {}
        drawn: dict[NoiseModel, Series] = {}
        models = {axis: model.at_rate(rate) for axis, model in self._true_models().items()}
        common = CommonDraws(models)
        for index, (axis, model) in enumerate(models.items()):
            alone = not any(p.shared for p in model)
            if (
                model not in drawn or not alone
            ):  # axes with one truth share one log, as one sensor type has one calibration

                def each(place: int, part: Array, axis: str = axis) -> None:
                    common.share(axis, part[None], place)

                values = model.simulate(n, 1.0 / rate, stream(self.scenario.seed, "fits", index), each=each)
                drawn[model] = Series(values - values.mean(), rate, axis_unit(axis), axis)
            out[axis] = [drawn[model]]
        return out

    @cached_property
    def beliefs(self) -> dict[str, Belief]:
        """What every design believes, models fitted where the scenario says so; the same for all scenarios that differ in nothing it depends on."""
        told = self.scenario.model_dump(mode="json", include={"designs", "truth", "fits", "seed"})
        key = key_of([told, self.rate_hz], [file for _, file in sorted(self.world.files.items())])
        held = HELD.get(("beliefs", key), self._resolved)
        return {name: held[name] for name in self.scenario.designs}  # in the order of this scenario

    def _resolved(self) -> dict[str, Belief]:
        done: dict[tuple[str, int], FitResult] = {}  # a log is fitted once per structure and method
        found = {name: self._belief(name, done) for name in self.scenario.designs}
        self.__dict__.pop("fit_logs", None)  # hours of samples that nobody asks for again
        return found

    def _fitted_together(self, name: str, done: dict[tuple[str, int], FitResult]) -> None:
        """Fit the axes of a design whose models share processes, all at once."""
        sources = self.scenario.designs[name].sources()
        asked = {
            axis: source
            for axis, source in sources.items()
            if isinstance(source, AxisSource) and source.fit is not None and any(p.shared for p in source.fit)
        }
        if not asked:
            return
        where = f"{self.file or 'scenario'}: designs.{name}"
        if any(source.method != "gmwm" or source.options for source in asked.values()):
            raise InputError("models with shared processes are fitted by gmwm without options", where=where)
        logs = [replace(self.fit_logs[axis][0], name=axis) for axis in asked]
        with found_at(where):
            found = fit_together(logs, {axis: source.fit for axis, source in asked.items() if source.fit is not None})
        done.update({_fit_key(source, self.fit_logs[axis][0]): found[axis] for axis, source in asked.items()})

    def _belief(self, name: str, done: dict[tuple[str, int], FitResult]) -> Belief:
        design = self.scenario.designs[name]
        models: dict[str, NoiseModel] = {}
        fits: dict[str, FitResult] = {}
        for axis, source in design.sources().items():
            if isinstance(source, NoiseModel):
                models[axis] = source
            elif source.truth:
                models[axis] = self._true_models()[axis]
            elif source.file:
                models[axis] = self._from_file(source.file, axis)
            elif source.model is not None:
                models[axis] = source.model
            else:
                assert source.fit is not None
                log = self.fit_logs[axis][0]
                key = _fit_key(source, log)
                if key not in done and any(p.shared for p in source.fit):
                    self._fitted_together(name, done)
                if key not in done:
                    done[key] = self._fitted(name, log, source)
                fits[axis] = done[key]
                models[axis] = done[key].model
            if isinstance(source, AxisSource) and source.plus is not None:
                models[axis] = models[axis] + source.plus
            if isinstance(source, AxisSource) and source.stabilise:
                radius = {} if source.stabilise is True else {"radius": float(source.stabilise)}
                models[axis] = NoiseModel(
                    tuple(p.stabilised(**radius) if isinstance(p, ARMA) else p for p in models[axis])
                )
            tuning = design.options.tuning
            factor = tuning.gyro if axis.startswith("gyro") else tuning.accel
            if factor != 1.0:
                models[axis] = models[axis].scaled(factor)
        return Belief({axis: m.at_rate(self.rate_hz) for axis, m in models.items()}, fits)

    def _true_models(self) -> dict[str, NoiseModel]:
        return self.scenario.truth.models() if self.scenario.truth is not None else {}

    def _fitted(self, design: str, log: Series, source: AxisSource) -> FitResult:
        assert source.fit is not None
        try:
            return fit(log, source.fit, source.method, **dict[str, Any](source.options))  # type: ignore[arg-type]
        except TypeError as error:
            if "unexpected keyword argument" not in str(error):
                raise
            raise InputError(
                f"{str(error).split('() ')[-1]}; it is no option of the method '{source.method}'",
                where=f"{self.file or 'scenario'}: designs.{design}",
            ) from None

    def _from_file(self, name: str, axis: str) -> NoiseModel:
        models = load(self.world.files[name])
        if axis not in models:
            raise InputError(f"no model for {axis}, expected one of: {', '.join(models)}", where=name)
        return models[axis]

    def filter(
        self,
        design: str,
        belief: Belief | None = None,
        *,
        output_every: int = 1,
        covariance_at: Array | None = None,
        standstill: Standstill | None = None,
    ) -> LooselyCoupledEKF | NavigationFilter:
        """The filter of one design: insemu's own, or the one that an installed package offers under the name that the design gives.

        Parameters
        ----------
        design : str
        belief : Belief, optional
            What it believes; what the scenario gives the design unless given.
        output_every : int
            A row of the result every so many epochs of the covariance.
        covariance_at : (k,) array, optional
            Times at which the whole covariance is kept, s.
        standstill : Standstill, optional
            Updates at rest; those of the world unless given.
        """
        belief, standstill = belief or self.beliefs[design], standstill or self.world.standstill
        gnss, chosen = self.scenario.gnss, self.scenario.designs[design]
        options = chosen.options
        sigma = np.array(gnss.position_sigma) * options.tuning.position
        velocity = np.array(gnss.velocity_sigma or (np.nan,) * 3) * options.tuning.velocity
        parts = FilterParts(
            belief=belief.models,
            dt=1.0 / self.rate_hz,
            lever_arm=lever_arm_of(options.compensate, gnss.lever_arm),
            gravity=self.world.gravity,
            gnss_sigma=(sigma, velocity),
            options=FilterOptions(
                covariance_every=options.covariance_every,
                output_every=output_every * options.covariance_every,
                gate=options.gate,
                gate_timeout=options.gate_timeout,
                covariance_at=() if covariance_at is None else tuple(covariance_at),
                extras=options.states,
                standstill=standstill,
                store="fixes" if self.scenario.smoother else "none",
            ),
        )
        try:
            parts = self.altered(design, parts)
            return parts.made(chosen.filter, chosen.settings)
        except InputError as error:
            hint = ""
            if isinstance(error, NotStationary):
                hint = "; to take it write {model: [...], stabilise: true}, or the largest modulus of a pole instead of true"
            raise InputError(f"{error}{hint}", where=f"{self.file or 'scenario'}: designs.{design}") from None

    def ekf(self, design: str) -> LooselyCoupledEKF:
        """The extended Kalman filter of a design.

        Raises
        ------
        InputError
            The design names another filter.
        """
        made = self.filter(design)
        if not isinstance(made, LooselyCoupledEKF) or not made.first_order:
            name = self.scenario.designs[design].filter
            what = "tightly coupled" if name is None else f"the filter '{name}'"
            raise InputError(
                f"the design '{design}' is {what}, expected the loosely coupled extended Kalman filter",
                where=str(self.file or "scenario"),
            )
        return made

    def altered(self, design: str, parts: FilterParts) -> FilterParts:
        """What a filter is made of, as it is used; for experiments that change it (:mod:`insemu.evaluate.regression`)."""
        return parts

    def realization(self, index: int) -> xr.Dataset:
        """Fly every design through one realization; see :meth:`side_by_side`."""
        (out,) = self.side_by_side([index])
        return out

    def side_by_side(self, indices: Sequence[int]) -> list[xr.Dataset]:
        """Fly every design through some realizations, side by side where it can.

        Whichever fly together, the numbers are the same; the variables are those of :data:`insemu.evaluate.dataset.VARIABLES`.
        """
        if isinstance(self.world, StretchedWorld):
            return [of_designs(self._stretched(self.world, index), self.world.output_times) for index in indices]
        realized = []
        for index in indices:
            recording, true = self.world.realized(index)
            raw = self.world.raw(index) if isinstance(self.world, EmulatedWorld) else None
            realized.append(_Realized(recording, true, *self.world.start(index, recording.imu), raw))
        flown = {name: self._flown(name, realized) for name in self.beliefs}
        return [
            of_designs({name: found[k] for name, found in flown.items()}, self.world.output_times)
            for k in range(len(realized))
        ]

    def _flown(self, name: str, realized: Sequence[_Realized]) -> list[dict[str, Any]]:
        """One design through some realizations."""
        prepared = [self._prepared(name, one) for one in realized]
        runs: dict[int, FilterResult | InputError] = {}
        # rests are another list of updates in every realization
        together = self.scenario.designs[name].options.zero_updates is None
        for k, (p, one) in enumerate(zip(prepared, realized, strict=True)):
            if k in runs:
                continue
            own = p.ekf
            # a filter that is derived from insemu's own may run in another way
            if together and isinstance(own, LooselyCoupledEKF) and type(own).run is LooselyCoupledEKF.run:
                same = [j for j in range(k, len(prepared)) if self._alike(own, prepared[j].ekf)]
                flown = own.run_many(
                    [prepared[j].imu for j in same],
                    [prepared[j].gnss for j in same],
                    [realized[j].start for j in same],
                    one.start_sigma,
                    aids=[prepared[j].aids for j in same],
                )
                runs |= dict(zip(same, flown, strict=True))
            else:
                aids = {"aids": p.aids} if p.aids else {}  # a user's filter need not know of them
                runs[k] = p.ekf.run(p.imu, p.gnss, one.start, one.start_sigma, **aids)
        out = []
        for k, (one, p) in enumerate(zip(realized, prepared, strict=True)):
            if isinstance(run := runs[k], InputError):
                raise run
            out.append(self._judged(name, one, p, run))
        return out

    @staticmethod
    def _alike(one: LooselyCoupledEKF, other: NavigationFilter) -> bool:
        """Whether two filters of a design are the same; threads may have made one each."""
        return other is one or (isinstance(other, LooselyCoupledEKF) and other.options == one.options)

    def _prepared(self, name: str, one: _Realized) -> _Prepared:
        """What a design's filter is fed of a realization."""
        known = self.compensated(name, one.recording, one.start, one.start_sigma)
        assert known.gnss is not None
        every = max(d.options.covariance_every for d in self.scenario.designs.values())
        rows = nearest_rows(known.imu.t, self.world.output_times, every)
        ekf, unaided = self._ready(name, known.imu.t[rows], rows, self._rests(name, known))
        imu = self._prefiltered(name, self.world.imu_for(known.imu, ekf))
        # the true states are those of the data as they came: they say nothing of what is left after a compensation
        true = one.true if known is one.recording else None
        gnss = self._received(name, ekf, one, known.gnss)
        return _Prepared(ekf, imu, gnss, known.aids, known.imu, rows, unaided, true)

    def _received(self, name: str, ekf: NavigationFilter, one: _Realized, fixes: GnssRecord) -> GnssRecord | RawRecord:
        """What a design takes of the receiver, as it believes it: fixes, or with states of the clock raw observations."""
        options = self.scenario.designs[name].options
        if one.raw is None or options.states.clock is None:
            return self.believed(name, fixes)
        if not isinstance(ekf, LooselyCoupledEKF):
            raise InputError("this filter takes no raw observations, expected one of insemu's", where=f"designs.{name}")
        std = one.raw.range_std * options.tuning.position, one.raw.rate_std * options.tuning.velocity
        return replace(one.raw, range_std=std[0], rate_std=std[1])

    def _judged(self, name: str, one: _Realized, p: _Prepared, run: FilterResult) -> dict[str, Any]:
        """What is kept of one design in one realization."""
        times = p.known.t[p.rows]
        if (users := self.scenario.designs[name].filter) is not None:
            check_result(users, run, times, smoother=self.scenario.smoother)
        found = asdict(self.world.score(Estimate.of_filter(run, times), times))
        if self.scenario.smoother:
            smoothed = self.world.score(Estimate.of_smoother(smooth(run), times), times)
            found |= {f"smoothed_{key}": value for key, value in asdict(smoothed).items()}
        # and nothing of the output epochs where the covariance was not propagated at the very samples
        true = p.true
        if true is not None and not np.allclose(times, self.world.output_times, rtol=0, atol=0.5 / self.rate_hz):
            true = None
        found |= sensor_scores(p.ekf, run, p.known, p.rows, self._whole(found["error"]), true, p.unaided)
        return found | run_scores(run.layout, run.fixes) | {"epochs": run.epochs}

    def _stretched(self, world: StretchedWorld, index: int) -> dict[str, dict[str, Any]]:
        """Every design through one realization of a flight in stretches; the filter's states and covariance are handed from one to the next."""
        fixes = world.fixes(stream(self.scenario.seed, "gnss", index))
        start, sigma = world.moved_start(stream(self.scenario.seed, "initial", index))
        begun: dict[str, _Begun] = dict.fromkeys(self.beliefs, (start, sigma, None))
        unaided = {name: unaided_sigma(self.ekf(name).augmentation, world.output_rows) for name in self.beliefs}
        told: dict[str, list[dict[str, Any]]] = {name: [] for name in self.beliefs}
        runs: dict[str, list[FilterResult]] = {name: [] for name in self.beliefs}
        for part in world.stretches(index):
            for name in self.beliefs:
                found, run = self._onward(
                    name, part, self.believed(name, fixes), begun[name], unaided[name][part.outputs]
                )
                end = run.nav[-1].copy()  # of a view the rows of the whole stretch would stay
                state = NavState(end[:3], end[3:6], rotation.rpy_from_quaternion(end[6:10]))
                begun[name] = state, run.final_covariance, run.imu_states[-1].copy()
                told[name].append(found)
                # what is counted at the end needs no more than the fixes
                runs[name].append(replace(run, nav=end[None], sigma=end[None], imu_states=end[None], covariance=end))
        out = {}
        for name, parts in told.items():
            axis = {"block_nees": 1}
            arrays = {key: np.concatenate([p[key] for p in parts], axis=axis.get(key, 0)) for key in parts[0]}
            last = runs[name][-1]
            table = FixTable.joined([run.fixes for run in runs[name]])
            out[name] = arrays | run_scores(last.layout, table) | {"epochs": sum(r.epochs for r in runs[name])}
        return out

    def _onward(
        self, name: str, part: Stretch, fixes: GnssRecord, begun: _Begun, unaided: Array
    ) -> tuple[dict[str, Any], FilterResult]:
        """One design through one stretch, from where the one before ended."""
        start, sigma, states = begun
        times = part.imu.t[part.rows]
        common, every = int(np.gcd.reduce(part.rows)), self.scenario.designs[name].options.covariance_every
        step = common // every if common and common % every == 0 else 1
        made = self.filter(name, output_every=step, covariance_at=times)
        assert isinstance(made, LooselyCoupledEKF)
        if made.augmentation.laws:
            raise InputError("a level that follows a covariate needs the flight as a whole", where=f"designs.{name}")
        run = made.run(part.imu, fixes, start, sigma, initial_states=states)
        found = asdict(self.world.score(Estimate.of_filter(run, times), times))
        found |= sensor_scores(made, run, part.imu, part.rows, self._whole(found["error"]), part.true, unaided)
        return found, run

    def _ready(
        self, design: str, times: Array, rows: NDArray[np.intp], standstill: Standstill | None
    ) -> tuple[NavigationFilter, Array]:
        """The filter of a design with covariances at these times, and what its states would be known to without fixes: kept for the next realization.

        Its rows are the fewest in steps of one length that hold those rows: of twenty minutes at 100 Hz they would take 50 MB.
        """
        asked = times.tobytes() + rows.tobytes()
        if standstill is None and (held := self._held.get(design)) is not None and held[0] == asked:
            return held[1]
        common, every = int(np.gcd.reduce(rows)), self.scenario.designs[design].options.covariance_every
        step = common // every if common and common % every == 0 else 1
        ekf = self.filter(design, output_every=step, covariance_at=times, standstill=standstill)
        ready: tuple[NavigationFilter, Array]
        ready = ekf, unaided_sigma(ekf.augmentation, rows) if isinstance(ekf, LooselyCoupledEKF) else np.empty(0)
        if standstill is None:
            self._held[design] = asked, ready
        return ready

    def _rests(self, design: str, data: Recording) -> Standstill | None:
        """Zero-velocity and zero-rate updates of one design, where it has any and the data show a rest outside the outages."""
        asked = self.scenario.designs[design].options.zero_updates
        if asked is None:
            return None
        return asked.at(
            (a, b)
            for a, b in rests(data.imu, data.gnss)
            if not any(start < b and a < start + duration for start, duration in self.world.outage_windows)
        )

    def _whole(self, error: Array) -> Array:
        """Errors that belong to the filter's covariance: those against fixes hold the fixes' own and do not."""
        return np.full_like(error, np.nan) if self.world.compared < 9 else error

    def compensated(self, design: str, recording: Recording, start: NavState, sigma: InitialSigma) -> Recording:
        """The data less the effects that a design knows of.

        Parameters
        ----------
        design : str
        recording : Recording
            Of this experiment's world.
        start, sigma : NavState, InitialSigma
            Where the design's filter starts, for effects that are taken off along the motion.
        """
        known = self.scenario.designs[design].options.compensate
        if any(use.effect.does("restored") for use in known):
            recording = self.world.restored(recording)
            known = tuple(use for use in known if not use.effect.does("restored"))

        def estimate(rest: Recording) -> Trajectory:
            flown = self.filter(design).run(rest.imu, rest.gnss, start, sigma)
            return trajectory_of(flown.t, flown.nav, "estimate")

        arm = lever_arm_of(known, self.scenario.gnss.lever_arm)
        return compensated(recording, known, trajectory=estimate, lever_arm=arm) if known else recording

    def _prefiltered(self, design: str, imu: ImuRecord) -> ImuRecord:
        """What a design's filter is fed: the record, de-noised where the design says so."""
        prefilter = self.scenario.designs[design].options.prefilter
        if prefilter is None:
            return imu

        def clean_of(column: NDArray[np.float64], levels: int) -> NDArray[np.float64]:
            if not levels:
                return column
            if prefilter.delay is not None:
                return delayed_approximation(
                    column, levels, round(prefilter.delay * self.rate_hz), wavelet=prefilter.wavelet
                )
            return denoise(column, levels, wavelet=prefilter.wavelet, rule=prefilter.rule, mode=prefilter.mode)

        clean = [clean_of(*item) for item in zip([*imu.gyro.T, *imu.accel.T], prefilter.per_axis(), strict=True)]
        return replace(imu, gyro=np.stack(clean[:3], axis=1), accel=np.stack(clean[3:], axis=1))

    def believed(self, design: str, fixes: GnssRecord) -> GnssRecord:
        """The fixes with the standard deviations that a design believes."""
        tuning = self.scenario.designs[design].options.tuning
        out = fixes
        if tuning.position != 1.0 and fixes.pos_std_ned is not None:
            out = replace(out, pos_std_ned=fixes.pos_std_ned * tuning.position)
        if tuning.velocity != 1.0 and fixes.vel_std_ned is not None:
            out = replace(out, vel_std_ned=fixes.vel_std_ned * tuning.velocity)
        return out


#: Where a filter begins: navigation state, what is believed of it, estimates of the other states.
_Begun = tuple[NavState, InitialSigma | Array, Array | None]


def _fit_key(source: AxisSource, log: Series) -> tuple[str, int]:
    """What tells one fit from another: structure, method, options and the log."""
    return source.model_dump_json(include={"fit", "method", "options"}), id(log)
