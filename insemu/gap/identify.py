"""The one door: a nominal model and what was measured, whichever kind it is."""

from __future__ import annotations

from collections.abc import Callable, Collection

import numpy as np

from insemu.gap.nominal import Nominal
from insemu.gap.sources import StaticLog
from insemu.gap.static_log import THRESHOLD, find_static_gap
from insemu.gap.verdict import GapReport
from insemu.records import Recording


def find_gap(
    measured: StaticLog | Recording,
    nominal: Nominal,
    *,
    rng: np.random.Generator,
    threshold: float = THRESHOLD,
    without: Collection[str] = (),
    hold_out: bool = True,
    progress: Callable[[str], None] | None = None,
) -> GapReport:
    """Find, name and add what the nominal model lacks.

    Parameters
    ----------
    measured : StaticLog or Recording
        A log at rest, or a drive or flight with fixes.
    nominal : Nominal
        What is believed.
    rng : Generator
        For simulated nominal data.
    threshold : float
        Nats that an effect must be worth.
    without : collection of str
        Effects taken out of the catalogue.
    hold_out : bool
        Whether to score on data that was not used for naming.
    progress : callable, optional
        Told what is being done.

    Raises
    ------
    InputError
        Data or beliefs that cannot be used.
    """
    if isinstance(measured, StaticLog):
        return find_static_gap(
            measured.axes,
            nominal.beliefs,
            rng=rng,
            temperature=measured.temperature,
            missing=measured.missing,
            threshold=threshold,
            without=without,
            hold_out=hold_out,
            source=measured.source,
            progress=progress,
        )
    from insemu.gap.dynamic import find_dynamic_gap

    return find_dynamic_gap(
        measured, nominal, rng=rng, threshold=threshold, without=without, hold_out=hold_out, progress=progress
    )
