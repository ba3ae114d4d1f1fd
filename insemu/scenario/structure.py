"""Which states a design's filter will carry, told from its structure before anything is fitted."""

from __future__ import annotations

from dataclasses import replace

from insemu.augment import augment
from insemu.filters import FAMILIES
from insemu.noise import AR1, ARMA, NoiseModel, Process
from insemu.scenario.design import Design
from insemu.scenario.schema import Scenario


def _any_values(process: Process) -> Process:
    """The process with values that stand for any: states do not depend on them."""
    if isinstance(process, AR1 | ARMA):
        process = replace(process, rate_hz=None)
    names = [p.name for p in process.parameters_meta()]
    return process.with_parameters({name: 0.5 / len(names) for name in names})


def structures(design: Design, scenario: Scenario | None = None) -> dict[str, NoiseModel | None]:
    """The model of every axis that the design has a belief of, parameters known or not; None where a file or a truth that is not given says."""
    truth = scenario.truth.models() if scenario is not None and scenario.truth is not None else {}
    out: dict[str, NoiseModel | None] = {}
    for axis, source in design.sources().items():
        if isinstance(source, NoiseModel):
            out[axis] = source
            continue
        given = (source.fit, source.model, truth.get(axis) if source.truth else None)
        found = next((model for model in given if model is not None), None)
        out[axis] = found if found is None or source.plus is None else found + source.plus
    return out


def state_names(design: Design, scenario: Scenario | None = None) -> tuple[str, ...] | None:
    """Names of the filter's states, in order; None where they are not known without files or for a user's filter.

    Parameters
    ----------
    design : Design
    scenario : Scenario, optional
        Whose truth a design may ask for.

    Raises
    ------
    InputError
        A process that no filter can carry.
    """
    models = structures(design, scenario)
    if (design.filter is not None and design.filter not in FAMILIES) or any(model is None for model in models.values()):
        return None
    shapes = {axis: NoiseModel(tuple(map(_any_values, model))) for axis, model in models.items() if model is not None}
    return augment(shapes, 0.01, design.options.states).layout.names
