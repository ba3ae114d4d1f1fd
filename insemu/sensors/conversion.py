"""From printed figures to noise models: which process each figure becomes, and what is assumed."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from insemu.errors import InputError
from insemu.noise import BI, GM, RC, RW, WN, NoiseModel, Process, axis_unit
from insemu.records import AXES
from insemu.sensors.cards import Card, card
from insemu.sensors.figures import SENSORS, Figure
from insemu.units import datasheet
from insemu.whole import put

#: Printed typical figures, and printed limits (or a multiple of the typical ones).
CASES = ("typical", "worst")

#: Lowest point of the Allan deviation of flicker over its coefficient B, sqrt(2 ln 2 / pi) (IEEE Std 952-1997, C.1.3).
FLICKER_FLOOR = math.sqrt(2.0 * math.log(2.0) / math.pi)
#: Highest point of the Allan deviation of a Gauss-Markov process over its sigma, at 1.89 correlation times (IEEE Std 952-1997, C.1.5).
GAUSS_MARKOV_PEAK = 0.618


@dataclass(frozen=True)
class Assumptions:
    """What a datasheet does not print.

    Parameters
    ----------
    worst_factor : float
        The worst case of a figure without a printed limit, as a multiple of the typical one. 2 is a convention, not a measurement: units of
        a type differ by tens of percent, and mounting, temperature and age add to that.
    tau_from, tau_to : float
        Band of averaging times in s over which a filter's Gauss-Markov processes stand for flicker: from the interval between GNSS fixes to
        long outages.
    """

    worst_factor: float = 2.0
    tau_from: float = 1.0
    tau_to: float = 1000.0


@dataclass(frozen=True)
class AxisModel:
    """The model of an axis, with a line for every process that says where it comes from."""

    model: NoiseModel
    said: tuple[str, ...]


def models(name: str, case: str = "typical", assumptions: Assumptions | None = None) -> dict[str, NoiseModel]:
    """Noise models of a sensor, for a truth and for a belief.

    Parameters
    ----------
    name : str
        A sensor that comes with insemu, or the file of a card or of a text with figures.
    case : {"typical", "worst"}
        Printed typical figures, or printed limits (else the typical ones times ``assumptions.worst_factor``).
    assumptions : Assumptions, optional

    Returns
    -------
    dict
        Axis (``gyro_x`` ... ``accel_z``) to model.

    Raises
    ------
    InputError
        No such sensor, an unknown case, or figures without white noise.
    """
    return {axis: found.model for axis, found in axis_models(card(name), case, assumptions).items()}


def axis_models(sensor: Card, case: str = "typical", assumptions: Assumptions | None = None) -> dict[str, AxisModel]:
    """The models of a card's axes with what was made of each figure.

    Parameters
    ----------
    sensor : Card
    case : {"typical", "worst"}
    assumptions : Assumptions, optional

    Returns
    -------
    dict
        Axis to :class:`AxisModel`, axes without a figure left out.

    Raises
    ------
    InputError
        An unknown case, or figures without white noise.
    """
    if case not in CASES:
        raise InputError(f"unknown case '{case}' (expected one of: {', '.join(CASES)})")
    assumed = assumptions or Assumptions()
    return {axis: _axis_model(sensor, axis, case, assumed) for axis in AXES if sensor.of_axis(axis)}


def _axis_model(sensor: Card, axis: str, case: str, assumed: Assumptions) -> AxisModel:
    figures, unit = sensor.of_axis(axis), axis_unit(axis)
    said: list[str] = []

    def value(kind: str) -> float:
        figure = figures[kind]
        if case == "typical":
            return figure.value
        if figure.worst is not None:
            return figure.worst
        said.append(
            f"worst case of the {kind.replace('_', ' ')}: assumed {assumed.worst_factor:g} times the typical figure"
        )
        return figure.value * assumed.worst_factor

    white = "random_walk" if "random_walk" in figures else "noise_density"
    if white not in figures:
        kind = SENSORS[axis.split("_")[0]]
        wanted = "ARW or a noise density" if axis.startswith("gyro") else "VRW or a noise density"
        raise InputError(f"{sensor.name}: no white noise is known of the {kind}; give their {wanted}")
    processes: list[Process] = [WN(value(white))]
    said.append(_white(figures, white, unit))
    for kind in ("bias_coefficient", "bias_sigma", "bias_stability"):
        if kind in figures:
            process, text = _bias(figures, kind, value(kind), assumed)
            processes.append(process)
            said.append(text)
            break
    else:
        said.append(
            "no in-run bias stability is printed: the model has none (assumed; a filter would trust it too far)"
        )
    if "rate_random_walk" in figures:
        processes.append(RW(value("rate_random_walk")))
        said.append(f"RW: K is the printed random walk of the bias, {figures['rate_random_walk'].text}")
    if "turn_on_bias" in figures:
        processes.append(RC(value("turn_on_bias")))
        said.append(f"RC: turn-on bias {figures['turn_on_bias'].text} (1 sigma), constant from start to end")
    else:
        said.append(
            "no turn-on bias or zero offset is among these figures: the model starts without one (assumed calibrated at rest before the start)"
        )
    return AxisModel(NoiseModel(tuple(processes)), tuple(said))


def _white(figures: Mapping[str, Figure], kind: str, unit: str) -> str:
    """What the white noise was taken from."""
    if kind == "noise_density":
        return (
            f"WN: N is the printed noise density {figures[kind].text} (assumed two-sided; where it is the rms in a bandwidth, one-sided, N is "
            "0.707 of it)"
        )
    text = f"WN: N is the printed random walk {figures[kind].text}"
    if "noise_density" in figures:
        density, shown = datasheet(figures["noise_density"].value, f"{unit}/sqrt(Hz)")
        text += (
            f"; the noise density {figures['noise_density'].text} = {density:.3g} {shown} is printed, too, and not used"
        )
    return text


def _bias(figures: Mapping[str, Figure], kind: str, value: float, assumed: Assumptions) -> tuple[Process, str]:
    """The process of the in-run bias."""
    time, text = figures.get("correlation_time"), figures[kind].text
    if kind == "bias_sigma":
        if time is None:
            raise InputError("an in-run bias sigma needs its correlation time (Tc)")
        return GM(value, 1.0 / time.value), f"GM: sigma {text} and correlation time {time.text} as printed"
    if time is not None:
        lowest = value if kind == "bias_stability" else value * FLICKER_FLOOR
        return GM(lowest / GAUSS_MARKOV_PEAK, 1.0 / time.value), (
            f"GM: assumed that the bias stability {text} is the top of the Allan deviation of a Gauss-Markov process, 0.618 sigma, with the "
            f"printed correlation time {time.text}"
        )
    band = f"a filter carries Gauss-Markov processes for averaging times of {assumed.tau_from:g} to {assumed.tau_to:g} s (assumed)"
    coefficient = value if kind == "bias_coefficient" else value / FLICKER_FLOOR
    how = (
        "is B itself"
        if kind == "bias_coefficient"
        else "is the lowest point of the Allan deviation, 0.664 B (assumed flicker)"
    )
    return BI(coefficient, assumed.tau_from, assumed.tau_to), f"BI: {text} {how}; {band}"


def spelled(model: NoiseModel, unit: str) -> str:
    """A model's text in the units of datasheets, which :meth:`insemu.noise.NoiseModel.parse` reads back to four digits.

    >>> spelled(NoiseModel((WN(9.89e-5),)), "rad/s")
    'WN(N=0.34 deg/sqrt(h))'
    """

    def told(process: Process) -> str:
        parts = []
        for meta in process.PARAMETERS:
            value = getattr(process, meta.name)
            if meta.optional and value == getattr(type(process), meta.name):
                continue
            if meta.name == "beta":
                parts.append(f"Tc={1.0 / value:.4g} s")
            else:
                shown, in_unit = datasheet(value, meta.unit_for(unit))
                parts.append(f"{meta.name}={shown:.4g} {in_unit}".strip())
        return f"{process.symbol}({', '.join(parts)})"

    return " + ".join(told(process) for process in model)


def save(
    sensor: Card, path: str | Path, case: str = "typical", assumptions: Assumptions | None = None
) -> dict[str, AxisModel]:
    """Write a card's models as YAML that :func:`insemu.noise.load` and a scenario read, and return them.

    Parameters
    ----------
    sensor : Card
    path : path
        File to write.
    case : {"typical", "worst"}
    assumptions : Assumptions, optional

    Raises
    ------
    InputError
        As :func:`models`; nothing is written.
    """
    found = axis_models(sensor, case, assumptions)
    document: dict[str, Any] = {
        "insemu_noise_models": 1,
        "sensor": sensor.name,
        "case": case,
        "sources": {label: dict(source) for label, source in sensor.sources.items()},
        "axes": {
            axis: {"unit": axis_unit(axis), "model": one.model.to_list(axis_unit(axis)), "from": list(one.said)}
            for axis, one in found.items()
        },
    }
    put(path, yaml.safe_dump(document, sort_keys=False, allow_unicode=True, width=140))
    return found
