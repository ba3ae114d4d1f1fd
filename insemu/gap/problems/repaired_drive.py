"""A drive or flight before its search: samples repaired, what its band above the motion shows named, the nominal filter run."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace

from insemu.gap.beliefs.nominal import Nominal
from insemu.gap.data.log import Reduced, unheard
from insemu.gap.data.samples import coarse, repair, with_counts
from insemu.gap.drive.preparation import Flown, Prepared, fast_parts
from insemu.gap.policy import rules
from insemu.gap.problems.band import fast_effects, white_level, without_delay, without_its_vibration
from insemu.gap.problems.findings import AxisResult, unknown_part
from insemu.gap.verdict import Finding
from insemu.records import Recording


@dataclass(frozen=True)
class RepairedDrive:
    """A recording repaired, what its band above the motion shows, and the nominal filter on it.

    Parameters
    ----------
    whole, believed : Recording, Nominal
        As they were given.
    recording, nominal : Recording, Nominal
        Repaired: gaps bridged, clipped stretches filled in, output counts believed, a low-pass's delay taken off.
    noticed : tuple of Finding
        What the samples showed by themselves and was not known.
    parts : mapping of axis to Reduced
        The band above the motion.
    clipped : set of str
        Axes at their full scale.
    fast : list of (axis, AxisResult)
    levels : mapping of axis to float
        White noise that was named there.
    late : mapping of sensor to delay taken off, s
    prepared : Prepared
    """

    whole: Recording
    believed: Nominal
    recording: Recording
    nominal: Nominal
    noticed: tuple[Finding, ...]
    parts: dict[str, Reduced]
    clipped: set[str]
    fast: list[tuple[str, AxisResult]]
    levels: dict[str, float]
    late: dict[str, float]
    prepared: Prepared

    @classmethod
    def of(
        cls,
        recording: Recording,
        believed: Nominal,
        without: Collection[str],
        flown: Flown | None,
        say: Callable[[str], None],
    ) -> RepairedDrive:
        """Mend a recording and look at its band above the motion.

        Parameters
        ----------
        recording, believed, without, flown, say
            As :func:`insemu.gap.find_gap` says: ``measured``, ``nominal``, ``without``, ``flown``, ``progress``.
        """
        whole, repaired = recording, repair(recording.imu, tuple(without), believed.filled)
        # what is known of the samples is repaired, but is no finding
        noticed = tuple(s for s in (unknown_part(s, believed.effects) for s in repaired.findings) if s is not None)
        nominal = replace(believed, beliefs=with_counts(believed.beliefs, repaired.findings, recording.imu.dt))
        recording = replace(recording, imu=repaired.imu)
        flown = None if repaired.findings else flown
        parts = flown.fast if flown else fast_parts(replace(recording, imu=repaired.heard), nominal)
        clipped = {f"{s.sensor}_{a}" for s in repaired.findings if s.effect == "saturation" for a in s.axes}
        # rounded that coarsely, the error follows the motion and is no noise that a spectrum could tell anything from
        rounded = coarse(believed.beliefs, repaired.findings, recording.imu.dt)
        parts = {name: unheard(data) if name in rounded else data for name, data in parts.items()}
        fast = fast_effects(parts, nominal, rules().fast_nats, without, say, clipped=clipped)
        fast, parts = without_its_vibration(fast, parts)
        levels = {name: level for name, r in fast if (level := white_level(r)) is not None}
        ready = flown.prepared if flown and not levels else None
        prepared, recording, late = without_delay(recording, nominal, parts, levels, dict(fast), repaired, ready)
        return cls(whole, believed, recording, nominal, noticed, parts, clipped, fast, levels, late, prepared)
