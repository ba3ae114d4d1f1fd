"""Effects that a sensor, a clock, a receiver or a model of motion may have: one object each, and the one list of them.

An effect says in one place what it is, how it is injected, removed, recognized in the innovations, put together with a second find of
itself, and hidden in a blind trial: ``gnss.LeverArm`` is all about a wrong lever arm. The files are the families::

    stochastic.py     noise and what acts like it
    deterministic.py  functions of the true signal, of temperature, of nothing
    samples.py        what becomes of the samples on their way out
    timing.py         the clock of the IMU
    gnss.py           the fixes and the antenna
    model.py          what a model of motion leaves out
    aids.py           measurements other than the fixes
    expression.py     what has no name, as an equation (terms.py)

:data:`EFFECTS` is the one list: the emulator, the scenario, the gap workflow, the trial and the tests of completeness go through it.
"""

from collections.abc import Iterable

from insemu.effects import aids, deterministic, expression, gnss, model, passes, samples, stochastic, timing
from insemu.effects.aids import AidErrors, aid_age, aid_corrected, aid_errors
from insemu.effects.base import (
    AID_KINDS,
    ASPECTS,
    EFFECTS,
    NED,
    RPY,
    SIGNAL_UNITS,
    XYZ,
    Effect,
    EffectUse,
    Stage,
    Trait,
    effect_of,
)
from insemu.effects.chain import Chain, FixErrors
from insemu.effects.compensation import added_signal, columns_without, compensated, lever_arm_of
from insemu.effects.deterministic import REFERENCE_DEGC, lagged
from insemu.effects.gnss import LONGEST_ARM, filter_memory
from insemu.effects.hiding import DriveLot, Hidden, RestLot
from insemu.effects.motion import MOTION_HZ, Column, FixGeometry, Motion, first_axis, on_axes, steady
from insemu.effects.parameters import CELLS, CROSS, EffectParameter, Join
from insemu.effects.terms import Signals, equation

EFFECTS.update(
    {
        e.id: e
        for family in (stochastic, deterministic, samples, timing, gnss, model, aids, expression)
        for e in family.EFFECTS
    }
)


def having(*traits: Trait) -> frozenset[str]:
    """Ids of the effects with at least one of these traits."""
    return frozenset(e.id for e in EFFECTS.values() if e.traits & set(traits))


def adds(effect: str) -> bool:
    """Whether this is an effect of one sensor whose values add up; False for what is not in the catalogue."""
    return effect in EFFECTS and EFFECTS[effect].adds


def join_of(effect: str, label: str) -> Join:
    """How two finds of a number such as ``value_x`` become one; "" for what is not in the catalogue."""
    named = EFFECTS[effect].parameters if effect in EFFECTS else ()
    return next((p.join for p in named if p.name == label.partition("_")[0]), "")


def joined(known: Iterable[EffectUse], found: Iterable[EffectUse]) -> tuple[EffectUse, ...]:
    """Known effects with what was found of them on top; the rest follows.

    A recording is searched with the known effects removed, so what is found is what they lack.
    """
    out = list(known)
    for use in found:
        for k, old in enumerate(out):
            both = use.effect.merged(old, use) if (old.id, old.sensor) == (use.id, use.sensor) else None
            if both is not None:
                out[k] = both
                break
        else:
            out.append(use)
    return tuple(out)


def catalogue_columns(motion: Motion, fixes: FixGeometry) -> list[Column]:
    """Unit columns of every effect whose shape in the innovations is known."""
    return [c for e in EFFECTS.values() if e.does("columns") for c in e.columns(motion, fixes)]


__all__ = [
    "AID_KINDS",
    "ASPECTS",
    "CELLS",
    "CROSS",
    "EFFECTS",
    "LONGEST_ARM",
    "MOTION_HZ",
    "NED",
    "REFERENCE_DEGC",
    "RPY",
    "SIGNAL_UNITS",
    "XYZ",
    "AidErrors",
    "Chain",
    "Column",
    "DriveLot",
    "Effect",
    "EffectParameter",
    "EffectUse",
    "FixErrors",
    "FixGeometry",
    "Hidden",
    "Motion",
    "RestLot",
    "Signals",
    "Stage",
    "added_signal",
    "adds",
    "aid_age",
    "aid_corrected",
    "aid_errors",
    "catalogue_columns",
    "columns_without",
    "compensated",
    "effect_of",
    "equation",
    "filter_memory",
    "first_axis",
    "having",
    "join_of",
    "joined",
    "lagged",
    "lever_arm_of",
    "on_axes",
    "passes",
    "steady",
]
