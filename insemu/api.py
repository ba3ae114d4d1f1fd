"""The functions at the top: ``import insemu as ins``, then ``ins.fit("log.npz", "WN() + GM()")``.

Each takes a file, or what a file holds, and answers with results that print in ten lines, show themselves in a notebook and have
``to_dataframe()`` and ``plot()``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from insemu.errors import InputError
from insemu.records import Recording, Series
from insemu.shown import ByAxis

if TYPE_CHECKING:
    from insemu.evaluate import Results
    from insemu.fit import FitResult
    from insemu.gap import GapReport
    from insemu.noise import NoiseModel, Process
    from insemu.scenario import Scenario
    from insemu.solve import Solution

#: A file, a signal, several, or a recording.
Signal = str | Path | Series | Sequence[Series] | Recording


def read(file: str | Path) -> list[Series] | Recording:
    """Read a file of any known kind, see :func:`insemu.formats.read`.

    Returns
    -------
    list of Series, or Recording
        The columns of a static log, or IMU and fixes.
    """
    from insemu import formats

    return formats.read(file)


def signals(data: Signal) -> list[Series]:
    """The signals of a file, of a recording at rest, or those given.

    Raises
    ------
    InputError
        Nothing of that kind.
    """
    if isinstance(data, str | Path):
        from insemu.logs import open_log

        return open_log(data).series(gaps=True)
    if isinstance(data, Series):
        return [data]
    if isinstance(data, Recording):
        from insemu.formats import Log

        return Log.of_imu(data.imu, data.source).series(gaps=True)
    out = list(data)
    if not out or not all(isinstance(s, Series) for s in out):
        raise InputError(f"found {type(data).__name__}, expected a file, a Series, several, or a Recording")
    return out


def fit(data: Signal, model: NoiseModel | Process | str, method: str = "gmwm", **options: Any) -> FitResult | ByAxis:
    """Fit a noise model to one signal or to every axis of a log.

    Parameters
    ----------
    data : path, Series, sequence of Series or Recording
    model : NoiseModel, Process or str
        Such as ``"2*GM() + WN()"``; parameters that have a value are held.
    method : str
        See :func:`insemu.fit.fit`.
    **options
        See :func:`insemu.fit.fit`.

    Returns
    -------
    FitResult, or a mapping of axis to FitResult
        One signal gives one result.

    Examples
    --------
    >>> import insemu as ins
    >>> x = ins.WN(N="0.34 deg/sqrt(h)").simulate(1024, 0.01, np.random.default_rng(1))
    >>> result = ins.fit(ins.Series(x, 100.0, "rad/s", "gyro_x"), ins.WN())
    >>> print(result.bears)
    True
    """
    from insemu.fit import fit as one

    given: Any = data
    if not isinstance(data, str | Path | Series | Recording) and not _are_series(data):
        return one(given, model, method, **options)  # type: ignore[arg-type]  # an array or a curve
    if isinstance(data, Series):
        return one(data, model, method, **options)  # type: ignore[arg-type]
    return ByAxis({s.name: one(s, model, method, **options) for s in signals(data)})  # type: ignore[arg-type]


def _are_series(data: object) -> bool:
    return isinstance(data, list | tuple) and bool(data) and all(isinstance(s, Series) for s in data)


def select(data: Signal, general: NoiseModel | str = "4*GM() + WN() + RW() + QN()", **options: Any) -> ByAxis:
    """Choose a noise model for every axis among all nested in a general one.

    Parameters
    ----------
    data : path, Series, sequence of Series or Recording
    general : NoiseModel or str
    **options
        See :func:`insemu.fit.select_axes`.

    Returns
    -------
    mapping of axis to Ranking
    """
    from insemu.fit import select_axes
    from insemu.noise import NoiseModel

    whole = NoiseModel.parse(general) if isinstance(general, str) else general
    return ByAxis(select_axes(signals(data), whole, **options))


def characterise(data: Signal, **options: Any) -> ByAxis:
    """What the noise of every axis is made of.

    Parameters
    ----------
    data : path, Series, sequence of Series or Recording
    **options
        See :func:`insemu.variance.characterise`; of a file :func:`insemu.logs.characterise_log`.

    Returns
    -------
    mapping of axis to AxisReport
    """
    if isinstance(data, str | Path):
        from insemu.logs import characterise_log, open_log

        return ByAxis({axis.name: axis for axis in characterise_log(open_log(data), **options)})
    from insemu.variance import characterise as one

    return ByAxis({s.name: one(s.values, s.rate_hz, name=s.name, unit=s.unit, **options) for s in signals(data)})


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
    from insemu.evaluate import Experiment, run_experiment

    file = str(scenario) if isinstance(scenario, str | Path) else None
    return run_experiment(Experiment(load(scenario, realizations=realizations, seed=seed), file), workers=workers)


def emulate(
    scenario: str | Path | Mapping[str, Any] | Scenario,
    realization: int = 0,
    *,
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


def find_gap(measured: str | Path | Recording, nominal: str | Path, *, seed: int = 1, **options: Any) -> GapReport:
    """Where a recording and a model disagree, and what is missing from the model.

    Parameters
    ----------
    measured : path or Recording
    nominal : path
        A scenario, a belief file or a noise-model file.
    seed : int
        Of the simulated nominal data.
    **options
        See :func:`insemu.gap.find_gap`.
    """
    from insemu import gap

    believed = gap.load_nominal(nominal)
    data = gap.load_measured(measured) if isinstance(measured, str | Path) else measured
    if "recording" not in believed.raw:
        data = gap.from_its_start(data)
    return gap.find_gap(data, believed, rng=np.random.default_rng(seed), **options)


def solve(
    recording: str | Path | Recording,
    *,
    gnss: str | Path | None = None,
    column_map: str = "",
    designs: Sequence[str] = (),
    sensor: str = "",
    model: str = "",
    lever_arm: Sequence[float] | None = None,
    workers: int = 1,
) -> Solution:
    """The way, calibration and metres without GNSS of a real recording, without a scenario.

    Parameters
    ----------
    recording : path or Recording
        The file with the IMU where there are several.
    gnss : path, optional
        File with the fixes, where they are apart.
    column_map : str
        Columns and settings of the file, as of ``insemu open --map``.
    designs : sequence of str
        Designs of ``insemu designs`` that are tried beside the generic ones.
    sensor, model : str
        A sensor card, and a file of models, that are tried too.
    lever_arm : (3,) sequence of float, optional
        IMU to antenna in the axes of the recording, m; estimated where it is not given.
    workers : int
        Threads.

    Raises
    ------
    InputError
        Data that contradict physics, no fixes, or no way to start.
    """
    from insemu import formats, intake
    from insemu.solve import candidates
    from insemu.solve import solve as one

    beliefs = candidates(designs, sensor, model, lever_arm_known=lever_arm is not None)
    if isinstance(recording, Recording):
        if gnss is not None or column_map:
            raise InputError("gnss and column_map belong to a file, found a Recording")
        data, card = recording, intake.examine(recording)
    else:
        found = formats.open_files(recording, gnss=gnss, maps=(column_map, "", ""))
        card = intake.examine(found)
        data = found.recording()
    card.check()
    return one(data, card, beliefs, lever_arm=(0.0, 0.0, 0.0) if lever_arm is None else lever_arm, workers=workers)


def plot(result: Any, axes: Any = None, *, view: int | str = 0) -> Any:
    """Draw the chart that a page shows of a result, see :func:`insemu.report.plot`.

    Parameters
    ----------
    result : FitResult, Ranking, AxisReport, Results, GapReport, Solution, or a mapping of axis to them
    axes : matplotlib Axes, optional
        None makes a figure with every view of the chart.
    view : int or str
        Which view is drawn on given axes, by number or name.
    """
    from insemu.report import plot as draw

    return draw(result, axes, view=view)
