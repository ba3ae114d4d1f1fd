"""A static model and a drive: factors on the levels, outages as the judge, and the reasons that the gap workflow names."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from insemu.augment import Extras
from insemu.blas import on_one_thread
from insemu.gap import Finding, Nominal, find_gap, refined_nominal, with_only
from insemu.gap.beliefs import filter_noise
from insemu.gap.drive import for_filter, starting_state, with_sigma
from insemu.gap.problems import drive_without
from insemu.noise import NoiseModel
from insemu.records import Recording
from insemu.solve import CALIBRATION
from insemu.transfer.judged import Judged, fitted, judge
from insemu.transfer.levels import Constant, Estimate, Factor, Levels, estimated

#: Reasons at the most: each costs a fit of the factors.
MOST_REASONS = 6
#: Constants of the IMU that may be tuned with the noise. Misalignments of the accelerometers against the gyroscopes: a rotation of all axes alike is
#: an attitude error, and with the gyroscopes' own misalignments as well a filter takes what it cannot see for known (mean squared error over its
#: variance 4 to 6 in 30 emulated drives of 6 min, 0.5 without).
CONSTANTS = Extras(**{name: CALIBRATION[name] for name in ("gyro_scale", "accel_scale", "accel_misalignment")})


@dataclass(frozen=True)
class Share:
    """By what factor each level falls once a finding is taken off the drive, after those before it."""

    finding: Finding
    shares: dict[str, float]


@dataclass(frozen=True)
class Transfer:
    """What :func:`transfer` found.

    Parameters
    ----------
    factors : tuple of Factor
    interval : float
        Between the fixes that they were fitted on, s; 0: all fixes.
    judged : tuple of Judged
        Static belief, hand factor, transferred belief.
    reasons : tuple of Share
        In the order in which they were taken off.
    rest : dict
        Factors that no reason explains.
    beliefs : mapping of axis to NoiseModel
        The static models with the factors on them, as a filter carries them.
    constants : tuple of Constant
        Of the IMU, estimated with the factors; none where they were not asked for.
    assumed : tuple of str
        What nobody states of the fixes, in words.
    """

    factors: tuple[Factor, ...]
    interval: float
    judged: tuple[Judged, ...]
    reasons: tuple[Share, ...]
    rest: dict[str, float]
    beliefs: dict[str, NoiseModel]
    constants: tuple[Constant, ...] = ()
    assumed: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """As plain data."""
        return {
            "factors": [{**asdict(f), "told": f.decisive} for f in self.factors],
            "interval_s": self.interval,
            "judged": [asdict(j) for j in self.judged],
            "reasons": [{**s.finding.to_json(), "shares": s.shares} for s in self.reasons],
            "rest": self.rest,
            "constants": [asdict(c) for c in self.constants],
            "assumed": list(self.assumed),
        }


def levels_of(
    measured: Recording,
    nominal: Nominal,
    beliefs: dict[str, NoiseModel] | None = None,
    extras: Extras = Extras(),  # noqa: B008 - frozen
) -> Levels:
    """A drive less what is known of it, where its filter starts, and the noise that is believed.

    Parameters
    ----------
    measured : Recording
    nominal : Nominal
    beliefs : mapping of axis to NoiseModel, optional
        What the filter carries instead of the nominal models.
    extras : Extras
        Constants of the IMU that it estimates beside.

    Raises
    ------
    InputError
        No fixes, no standard deviations for them, or no way to start.
    """
    nominal, drive = nominal.parted().on(measured)
    measured = drive.measured
    recording, moved = drive_without(measured, nominal, filled=True)
    imu, gnss, state, sigma = starting_state(recording, moved)
    gnss = with_sigma(gnss, moved)
    gnss = gnss.rows((gnss.t > imu.t[0]) & (gnss.t <= imu.t[-1]))
    span = float(imu.t[-1] - imu.t[0])
    carried = {a: for_filter(m, imu.dt, span) for a, m in (beliefs or moved.beliefs).items()}
    return Levels(imu, gnss, (state, sigma), carried, np.array(moved.gnss.lever_arm), extras)


@on_one_thread
def transfer(
    measured: Recording,
    nominal: Nominal,
    *,
    rng: np.random.Generator,
    known: Nominal | None = None,
    why: bool = True,
    calibrate: bool = False,
    say: Callable[[str], None] = lambda _: None,
) -> Transfer:
    """By what factors the noise of a drive exceeds the static models, whether that helps in outages, and why.

    Parameters
    ----------
    measured : Recording
        A drive or flight with fixes.
    nominal : Nominal
        Static models of the six axes; what it knows besides is taken off.
    rng : Generator
        For the simulations of the gap workflow.
    known : Nominal, optional
        What is known of the drive where ``nominal`` has the static models alone: effects to take off, fixes, start, vehicle. Its noise decides
        which fixes are outliers and what the reasons are held against; no filter carries it.
    why : bool
        Whether to look for reasons.
    calibrate : bool
        Whether :data:`CONSTANTS` of the IMU are tuned together with the noise: the filter carries them as states, and the likelihood
        of the factors is that with the constants integrated out.
    say : callable, optional
        Told what is being done.

    Raises
    ------
    InputError
        A recording or models that cannot be used.
    """
    extras, static = CONSTANTS if calibrate else Extras(), None
    if known is not None:
        nominal, static = known, nominal.beliefs
    levels = levels_of(measured, nominal, static, extras)
    found, interval = fitted(levels, [(float(levels.gnss.t[0]), float(levels.gnss.t[-1]) + 1.0)], say)
    judged = judge(levels, say)
    drive = _Drive(measured, nominal, static, extras)
    reasons, rest = _reasons(drive, found, interval, rng, say) if why else ((), {})
    factors = np.exp(found.log).tolist()
    constants = levels.constants(factors)
    assumed = nominal.parted().on(measured)[1].said
    return Transfer(found.factors, interval, judged, reasons, rest, levels.scaled(factors), constants, assumed)


class _Drive(NamedTuple):
    """What is transferred to what: a drive, what is known of it, the static models where they are others, states that are estimated along."""

    measured: Recording
    nominal: Nominal
    static: dict[str, NoiseModel] | None
    extras: Extras


def _reasons(
    drive: _Drive, found: Estimate, interval: float, rng: np.random.Generator, say: Callable[[str], None]
) -> tuple[tuple[Share, ...], dict[str, float]]:
    """Findings of the gap workflow, taken off one after the other, and by what factor each level falls at each."""
    measured, nominal, static, extras = drive
    factors = {f.name: f.value for f in found.factors if f.asks}
    if not factors:
        return (), {}
    say("looking for reasons")
    # aids say nothing of the levels of IMU and fixes
    report = find_gap(replace(measured, aids=()), nominal, rng=rng, hold_out=False, pictures=False, progress=say)
    shares, before = [], found
    for number, finding in enumerate(report.findings[:MOST_REASONS], 1):
        say(f"factors without {finding.effect}")
        part = with_only(report, report.findings[:number])
        known = refined_nominal(nominal, part, measured.imu.dt)
        noise = static or filter_noise(nominal, part, measured.imu.dt)
        levels = levels_of(measured, known, noise, extras).thinned(interval)
        old = {f.name: f.value for f in before.factors}
        now = estimated(levels, at=np.log([old.get(name, 1.0) for name in levels.names]))
        shares.append(Share(finding, {f.name: old[f.name] / f.value for f in now.factors if f.name in factors}))
        before = now
    return tuple(shares), {f.name: f.value for f in before.factors if f.name in factors}
