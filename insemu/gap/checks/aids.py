"""Whether an aid is what its name says, and how it stands against a model."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import scipy  # whose parts are imported when they are used

from insemu.errors import InputError
from insemu.filters import AIDS
from insemu.gap.drive.aid_residuals import Measured
from insemu.gap.evidence.aid_model import AidModel
from insemu.gap.verdict import Where

#: What a slope of what an aid says against what it should say stands for, by kind; a slope of 1 is right.
SLOPES: Mapping[str, Mapping[float, str]] = {
    "odometer": {
        3.6: "is it in km/h?",
        1.944: "is it in knots?",
        2.237: "is it in miles per hour?",
        3.281: "is it in feet per second?",
        -1.0: "is its sign reversed?",
    },
    "barometer": {3.281: "is it in feet?", -1.0: "is it depth, not height?"},
}
#: Distance of a slope from 1 beyond which an aid is something else: any scale factor is less; relative distance from a unit's that is its.
NO_SCALE, ITS_UNIT = 0.5, 0.1
#: What an aid must vary by for a slope to say something: in its unit, and over its own standard deviation.
LEAST_VARIED, LEAST_SEEN = {"odometer": 1.0, "barometer": 5.0}, 3.0


def check_unit(measured: Measured, source: str) -> None:
    """Raise ``InputError`` where an aid is another quantity, of another sign or in another unit than its name says."""
    aid = measured.aid
    kind = aid.kind
    if kind == "heading":
        if np.median(np.abs(aid.values)) > 2.0 * math.pi:
            raise InputError(
                f"aid_heading has a median magnitude of {np.median(np.abs(aid.values)):.3g}, expected radians: are these degrees?",
                where=source,
            )
        return
    if not measured.used[0]:
        return
    # the first row tells the unit: of a wheel the others are often held at zero
    true, given = measured.values[:, 0], aid.values[:, 0]
    about = 0.0 if kind == "odometer" else 1.0
    x, y = true - about * np.median(true), given - about * np.median(given)
    varied = float(np.sqrt(np.mean(x**2)))
    if varied < max(LEAST_VARIED[kind], LEAST_SEEN * float(np.median(aid.std[:, 0]))):
        return
    slope = float(x @ y) / float(x @ x)
    if abs(slope - 1.0) <= NO_SCALE:
        return
    name, unit = next(iter(AIDS[kind].rows.items()))
    near = [said for factor, said in SLOPES[kind].items() if abs(slope / factor - 1.0) < ITS_UNIT]
    hint = near[0] if near else "is it another quantity, or stamped by another clock?"
    raise InputError(
        f"aid_{kind} ({name}) is {slope:.3g} times what IMU and fixes say, expected {unit}: {hint}", where=source
    )


def stands(model: AidModel) -> list[Where]:
    """How an aid stands against a model: level and independence of what is left of each row."""
    d, out = model.data, []
    for row, z in zip(d.rows, model.whitened().T, strict=True):
        n = z.size
        # of what shakes an aid it may show nothing: less than expected says nothing
        p = float(scipy.stats.chi2.sf(float(z @ z), n))
        lags = np.arange(1, min(10, n // 4) + 1)
        rho = np.array([float(np.mean(z[k:] * z[:-k])) for k in lags]) / float(np.mean(z * z))
        white = float(scipy.stats.chi2.sf(np.sum(rho**2 * (n - lags)), lags.size))
        for name, one in (("level against the fixes", p), ("independence", white)):
            out.append(Where(name, d.kind, row, d.block_s, min(1.0, 2.0 * len(d.rows) * one)))
    return out
