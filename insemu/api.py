"""The functions at the top: ``import insemu as ins``, then ``ins.fit("log.npz", "WN() + GM()")``.

Each takes a file, or what a file holds, and answers with results that print in ten lines, show themselves in a notebook and have
``to_dataframe()`` and ``plot()``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Never, overload

import numpy as np
from numpy.typing import NDArray

from insemu.errors import InputError
from insemu.given import PandasTable, PolarsTable, Quantity, Signal, Table, file_of, si, signals
from insemu.records import Recording, Series
from insemu.shown import ByAxis

if TYPE_CHECKING:
    from matplotlib.axes import Axes as Drawing
    from matplotlib.figure import Figure

    from insemu.evaluate import Results
    from insemu.fit import FitResult, Method, Ranking
    from insemu.fit.gmwm import Weighting
    from insemu.gap import GapReport, Nominal, StaticLog
    from insemu.intake import Card
    from insemu.noise import NoiseModel, Process
    from insemu.referee import Judgement
    from insemu.require import Answer
    from insemu.scenario import Scenario
    from insemu.solve import Solution
    from insemu.variance import AxisReport

Pattern = Literal["uniform", "log"]


def read(
    file: str | Path | Table, *, gnss: str | Path | None = None, truth: str | Path | None = None, map: str = ""
) -> list[Series] | Recording:
    """Read a file of any known kind through the same intake as the commands.

    Parameters
    ----------
    file : path or table
        What has the IMU where there are several.
    gnss, truth : path, optional
        The fixes and the reference, where they are apart.
    map : str
        Columns and settings, as of ``insemu open --map``; ``contradictions=accepted`` takes a recording that contradicts physics.

    Returns
    -------
    list of Series, or Recording
        The columns of a static log, in which samples may be missing; or IMU and fixes (what a map describes in any case), whose remarks say
        what was assumed and what is worth a look.

    Raises
    ------
    InputError
        As :func:`insemu.formats.read`; data that contradict physics, in the words of ``insemu open``.
    """
    from insemu import formats, intake

    with file_of(file) as path:
        found, card = intake.take(path, gnss=gnss, truth=truth, maps=(map, "", ""))
        card.check()
        if gnss is None and truth is None and not map and not formats.holds_recording(path):
            return formats.read_log(path).series(gaps=True)
        return intake.found_in(intake.recording_of(found), card)


def examine(
    data: str | Path | Table | Recording,
    *,
    gnss: str | Path | None = None,
    truth: str | Path | None = None,
    map: str = "",
) -> Card:
    """The intake card, as ``insemu open`` prints it: what data were taken for and whether physics agrees.

    Parameters
    ----------
    data : path, table or Recording
    gnss, truth, map
        Of a file, see :func:`read`.
    """
    from insemu import intake

    if isinstance(data, Recording):
        return intake.examine(data)
    with file_of(data) as path:
        return intake.take(path, gnss=gnss, truth=truth, maps=(map, "", ""))[1]


@overload
def fit(  # type: ignore[overload-overlap]
    data: Series | NDArray[np.float64],
    model: NoiseModel | Process | str,
    method: Method = "gmwm",
    *,
    columns: Sequence[str] | None = None,
    rate: Quantity | None = None,
    skip: Quantity = 0.0,
    robust: bool = False,
    wavelet: str = "haar",
    weighting: Weighting = "auto",
    start: NoiseModel | str | None = None,
    tau_from: Quantity = 0.0,
    tau_to: Quantity = math.inf,
    pattern: Pattern = "uniform",
    bootstrap: int = 0,
    seed: int = 0,
    unit: str = "",
    name: str = "signal",
) -> FitResult: ...
@overload  # a keyword that no overload has is named by this one
def fit(
    data: Signal,
    model: NoiseModel | Process | str,
    method: Method = "gmwm",
    *,
    columns: Sequence[str] | None = None,
    rate: Quantity | None = None,
    skip: Quantity = 0.0,
    robust: bool = False,
    wavelet: str = "haar",
    weighting: Weighting = "auto",
    start: NoiseModel | str | None = None,
    tau_from: Quantity = 0.0,
    tau_to: Quantity = math.inf,
    pattern: Pattern = "uniform",
    bootstrap: int = 0,
    seed: int = 0,
    unit: str = "",
    name: str = "signal",
    **no_such_keyword: Never,
) -> ByAxis[FitResult]: ...
def fit(  # type: ignore[misc]
    data: Signal,
    model: NoiseModel | Process | str,
    method: Method = "gmwm",
    *,
    columns: Sequence[str] | None = None,
    rate: Quantity | None = None,
    skip: Quantity = 0.0,
    robust: bool = False,
    wavelet: str = "haar",
    weighting: Weighting = "auto",
    start: NoiseModel | str | None = None,
    tau_from: Quantity = 0.0,
    tau_to: Quantity = math.inf,
    pattern: Pattern = "uniform",
    bootstrap: int = 0,
    seed: int = 0,
    unit: str = "",
    name: str = "signal",
) -> FitResult | ByAxis[FitResult]:
    """Fit a noise model to one signal or to every axis of a log, as ``insemu fit`` does.

    Parameters
    ----------
    data : path, table, Series, sequence of Series, Recording or array
        See :func:`signals`.
    model : NoiseModel, Process or str
        Such as ``"2*GM() + WN()"``; parameters that have a value are held.
    method : str
        See :func:`insemu.fit.fit`.
    columns, rate, skip, unit, name
        See :func:`signals`.
    robust : bool
        Use the wavelet variance that outliers cannot move (gmwm, indirect).
    wavelet : str
        Filter of the wavelet variance (gmwm).
    weighting : str
        Of gmwm, see :func:`insemu.fit.gmwm.fit_curve`.
    start : NoiseModel or str, optional
        Values to start from (gmwm, em, mli).
    tau_from, tau_to : str or float
        Scales to use (gmwm), s.
    pattern : str
        Of mli.
    bootstrap : int
        Intervals and criterion from so many simulated signals; 0: closed form.
    seed : int
        Of bootstrap and draws.

    Returns
    -------
    FitResult, or a mapping of axis to FitResult
        A Series or an array gives one result.

    Examples
    --------
    >>> import insemu as ins
    >>> x = ins.WN(N="0.34 deg/sqrt(h)").simulate(1024, 0.01, np.random.default_rng(1))
    >>> print(ins.fit(x, ins.WN(), rate="100 Hz").bears)
    True
    """
    from insemu.fit import Estimator, bootstrapped, check_bootstrap

    if bootstrap:
        check_bootstrap(method, bootstrap)
    series = signals(data, columns=columns, rate=rate, skip=skip, unit=unit, name=name)
    tau = {"tau_from": si(tau_from, "s"), "tau_to": si(tau_to, "s")}
    estimator = Estimator(
        method=method, robust=robust, wavelet=wavelet, weighting=weighting, pattern=pattern, start=start, seed=seed, **tau
    )  # fmt: skip
    out = estimator.fit(series, model)
    if bootstrap:
        children = estimator.generators(len(out))
        out = {axis: bootstrapped((r, bootstrap, c)) for (axis, r), c in zip(out.items(), children, strict=True)}
    return next(iter(out.values())) if isinstance(data, Series | np.ndarray) else ByAxis(out)


def select(
    data: Signal,
    general: NoiseModel | str = "4*GM() + WN() + RW() + QN()",
    *,
    candidates: Sequence[NoiseModel | str] | None = None,
    columns: Sequence[str] | None = None,
    rate: Quantity | None = None,
    skip: Quantity = 0.0,
    robust: bool = False,
    workers: int = 1,
    unit: str = "",
    name: str = "signal",
) -> ByAxis[Ranking]:
    """Choose a noise model for every axis among all nested in a general one, as ``insemu select`` does.

    Parameters
    ----------
    data : path, table, Series, sequence of Series, Recording or array
        See :func:`signals`.
    general : NoiseModel or str
    candidates : sequence of NoiseModel or str, optional
        Rank these instead.
    columns, rate, skip, unit, name
        See :func:`signals`.
    robust : bool
        Use the wavelet variance that outliers cannot move.
    workers : int
        Work items at a time.
    """
    from insemu.fit import select_axes
    from insemu.noise import NoiseModel

    def parsed(model: NoiseModel | str) -> NoiseModel:
        return NoiseModel.parse(model) if isinstance(model, str) else model

    series = signals(data, columns=columns, rate=rate, skip=skip, unit=unit, name=name)
    asked = None if candidates is None else [parsed(c) for c in candidates]
    return ByAxis(select_axes(series, parsed(general), candidates=asked, robust=robust, workers=workers))


def characterise(
    data: Signal,
    *,
    columns: Sequence[str] | None = None,
    rate: Quantity | None = None,
    robust: bool = False,
    wavelet: str = "haar",
    unit: str = "",
    name: str = "signal",
) -> ByAxis[AxisReport]:
    """What the noise of every axis is made of, as ``insemu characterise`` says it.

    Parameters
    ----------
    data : path, table, Series, sequence of Series, Recording or array
        See :func:`signals`.
    columns, rate, unit, name
        See :func:`signals`.
    robust : bool
        Read the coefficients off the robust curve.
    wavelet : str
        Filter of the wavelet variance.
    """
    if isinstance(data, str | Path):
        from insemu.logs import characterise_log, open_log

        log = open_log(data, None if rate is None else si(rate, "Hz"))
        return ByAxis({a.name: a for a in characterise_log(log, columns, from_robust=robust, wavelet=wavelet)})
    from insemu.variance import characterise as one

    series = signals(data, columns=columns, rate=rate, unit=unit, name=name, refuse=False)
    return ByAxis(
        {s.name: one(s.values, s.rate_hz, name=s.name, unit=s.unit, from_robust=robust, filter=wavelet) for s in series}
    )


def load(scenario: str | Path | Mapping[str, Any] | Scenario, **overrides: Any) -> Scenario:
    """A scenario from a file, from plain data, or as it is.

    Parameters
    ----------
    scenario : path, mapping or Scenario
    **overrides
        Such as ``realizations=4`` or ``seed=1``.

    Raises
    ------
    InputError
        Something in it is wrong, with the key.
    """
    import yaml

    from insemu import scenario as room
    from insemu import yamlfile

    given = {key: value for key, value in overrides.items() if value is not None}
    if isinstance(scenario, room.Scenario):
        return scenario.model_copy(update=given)
    if isinstance(scenario, Mapping):
        text = yaml.safe_dump(dict(scenario) | given, sort_keys=False)
        return room.validated(room.Scenario, yamlfile.parse(text, "scenario"))
    return room.load(scenario, overrides=given)


def run(
    scenario: str | Path | Mapping[str, Any] | Scenario,
    *,
    realizations: int | None = None,
    seed: int | None = None,
    workers: int = 1,
) -> Results:
    """Fly a scenario with all its designs.

    Parameters
    ----------
    scenario : path, mapping or Scenario
    realizations, seed : int, optional
        Default the scenario's.
    workers : int
        Realizations at a time.
    """
    from insemu.evaluate import Experiment, Resources, run_experiment

    file = str(scenario) if isinstance(scenario, str | Path) else None
    return run_experiment(
        Experiment(load(scenario, realizations=realizations, seed=seed), file), resources=Resources(workers=workers)
    )


def emulate(
    scenario: str | Path | Mapping[str, Any] | Scenario,
    *,
    realization: int = 0,
    seed: int | None = None,
    ideal: bool = False,
) -> Recording:
    """The recording that a scenario's sensors would make.

    Parameters
    ----------
    scenario : path, mapping or Scenario
    realization : int
    seed : int, optional
        Default the scenario's.
    ideal : bool
        Perfect sensors.
    """
    from insemu.evaluate import EmulatedWorld

    file = str(scenario) if isinstance(scenario, str | Path) else None
    return EmulatedWorld(load(scenario, seed=seed), file).recording(realization, ideal=ideal)


def find_gap(
    model: str | Path | Nominal | Mapping[str, NoiseModel | FitResult],
    recording: str | Path | Table | Recording | Series | Sequence[Series],
    *,
    rate: Quantity | None = None,
    without: Sequence[str] = (),
    seed: int = 1,
    hold_out: bool = True,
) -> GapReport:
    """Where a recording and a model disagree, and what is missing from the model, as ``insemu gap`` says it.

    Parameters
    ----------
    model : path, mapping of axis to NoiseModel or FitResult, or Nominal
        What is believed: a scenario, a belief file or a noise-model file, or the models themselves.
    recording : path, table, Recording, Series or sequence of Series
        What was measured: a drive or flight, or a log at rest.
    rate : str or float, optional
        Sampling rate of a log that does not say it (``"100 Hz"``, or Hz).
    without : sequence of str
        Effects that are taken out of the catalogue.
    seed : int
        Of the simulated nominal data.
    hold_out : bool
        Score on data that was not used for naming (twice the work).

    Raises
    ------
    InputError
        A recording where the model is expected; see :func:`insemu.gap.find_gap`.
    """
    from insemu import gap, intake
    from insemu.noise import NoiseModel

    if isinstance(model, Recording | Series | PandasTable | PolarsTable):
        raise InputError(f"found {type(model).__name__} first, expected the model first and then the recording")
    if isinstance(model, str | Path):
        believed = gap.load_nominal(model)
    elif isinstance(model, Mapping):
        beliefs: dict[str, Any] = {axis: getattr(m, "model", m) for axis, m in model.items()}
        believed = gap.Nominal(beliefs, kind="noise", source="model")
    else:
        believed = model
    if not isinstance(believed, gap.Nominal):
        raise InputError(f"the model is a {type(believed).__name__}, expected a path, a mapping of axes or a Nominal")
    for axis, m in believed.beliefs.items():
        if not isinstance(m, NoiseModel):
            raise InputError(f"the model of {axis} is a {type(m).__name__}, expected a NoiseModel or a FitResult")
    data: StaticLog | Recording
    if isinstance(recording, Recording):
        data = intake.found_in(recording, intake.examine(recording).check())
    elif isinstance(recording, str | Path | PandasTable | PolarsTable):
        with file_of(recording) as path:
            hertz = None if rate is None else si(rate, "Hz")
            card = intake.card_of(path, rate_hz=hertz).check()
            data = intake.found_in(gap.load_measured(path, rate_hz=hertz), card)
    else:
        series = tuple(signals(recording))
        data = gap.StaticLog(series, None, "signals")
    if "recording" not in believed.raw:
        data = gap.from_its_start(data)
    return gap.find_gap(data, believed, rng=np.random.default_rng(seed), without=tuple(without), hold_out=hold_out)


def solve(
    recording: str | Path | Table | Recording,
    *,
    gnss: str | Path | Table | None = None,
    map: str = "",
    sensor: str = "",
    models: str = "",
    designs: Sequence[str] = (),
    lever_arm: Sequence[float] | None = None,
    trajectory_rate: float | None = None,
    workers: int = 1,
) -> Solution:
    """The way, calibration and metres without GNSS of a real recording, without a scenario.

    Parameters
    ----------
    recording : path, table or Recording
        What has the IMU where there are several.
    gnss : path or table, optional
        The fixes, where they are apart.
    map : str
        Columns and settings of the file, as of ``insemu open --map``.
    sensor, models : str
        A sensor card, and a file of models, that are tried too.
    designs : sequence of str
        Designs of ``insemu designs`` that are tried beside the generic ones.
    lever_arm : (3,) sequence of float, optional
        IMU to antenna in the axes of the recording, m; estimated where it is not given.
    trajectory_rate : float, optional
        Of the trajectory, Hz; one epoch a second where it is not given.
    workers : int
        Threads.

    Raises
    ------
    InputError
        Data that contradict physics, no fixes, or no way to start.
    """
    from insemu import intake
    from insemu.solve import candidates
    from insemu.solve import solve as one

    beliefs = candidates(designs, sensor, models, lever_arm_known=lever_arm is not None)
    if isinstance(recording, Recording):
        if gnss is not None or map:
            raise InputError("gnss and map belong to a file, found a Recording")
        data, card = recording, intake.examine(recording)
    else:
        with file_of(recording) as file, nullcontext() if gnss is None else file_of(gnss) as fixes:
            found, card = intake.take(file, gnss=fixes, maps=(map, "", ""))
            data = intake.recording_of(found)
    card.check()
    return one(data, card, beliefs, lever_arm=lever_arm, rate=trajectory_rate, workers=workers)


def require(
    requirements: str | Sequence[str],
    *,
    track: str | Path = "",
    vehicle: str = "car",
    fixes: str = "",
    aids: str = "",
    have: str = "",
    transfer: str | Path = "",
) -> Answer:
    """Which IMU keeps a required error at the end of an outage, as ``insemu require`` says it; nothing is written.

    Parameters
    ----------
    requirements : str or sequence of str
        Such as ``"planimetric < 1 m at 95 % after 30 s"``.
    track : path
        A track, waypoints, or the name of a built-in trajectory; empty: a drive in town.
    vehicle : str
        For a track or waypoints.
    fixes : str
        Standard deviations such as ``"2 cm, 3 cm/s"``.
    aids, have : str
        See :func:`insemu.require.require`.
    transfer : path
        What ``insemu transfer --json`` printed.

    Raises
    ------
    InputError
        What cannot be read, what contradicts itself, and what no sensor can keep.
    """
    from insemu.require import require as one
    from insemu.require import wish_of

    asked = [requirements] if isinstance(requirements, str) else list(requirements)
    wish = wish_of(str(track), vehicle, fixes)
    return one(asked, wish, Path("scenario.yaml").absolute(), aids=aids, have=have, road=transfer)


def referee(
    filters: str | Sequence[str] = (),
    *,
    worlds: Sequence[str] = (),
    realizations: int | None = None,
    seed: int | None = None,
    false_alarm: float | None = None,
    workers: int = 1,
) -> list[Judgement]:
    """Whether filters state their own errors, as ``insemu referee`` says it; nothing is written.

    Parameters
    ----------
    filters : str or sequence of str
        Names of families or adapters, ``FILE.py:CLASS``, ``MODULE:CLASS``, or folders of estimates; all families unless given.
    worlds : sequence of str
        Only these; all unless given.
    realizations, seed, false_alarm
        See :func:`insemu.referee.referee`.
    workers : int
        Threads.

    Raises
    ------
    InputError
        No such filter or world.
    """
    from insemu.evaluate import Resources
    from insemu.referee import referee as judge

    given = {"realizations": realizations, "seed": seed, "false_alarm": false_alarm}
    asked = [filters] if isinstance(filters, str) else list(filters)
    return judge(asked, names=worlds, resources=Resources(workers), **given)  # type: ignore[arg-type]


def plot(result: Any, axes: Drawing | None = None, *, view: int | str = 0) -> Drawing | Figure:
    """Draw the chart that a page shows of a result, see :func:`insemu.report.plotting.plot`.

    Parameters
    ----------
    result : FitResult, Ranking, AxisReport, Results, GapReport, Solution, or a mapping of axis to them
    axes : matplotlib Axes, optional
        None makes a figure with every view of the chart.
    view : int or str
        Which view is drawn on given axes, by number or name.
    """
    from insemu.report.plotting import plot as draw

    return draw(result, axes, view=view)
