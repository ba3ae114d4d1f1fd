"""What becomes of the samples of a sensor on their way out: clipped at its full scale, lost."""

from __future__ import annotations

from typing import Any

import numpy as np

from insemu.effects.base import BOTH, DEG, IMU, IN_SAMPLES, Effect, EffectUse, G, Stage
from insemu.effects.chain import Chain
from insemu.effects.hiding import DriveLot, Hidden, RestLot
from insemu.effects.parameters import EffectParameter
from insemu.lost import restored
from insemu.records import ImuRecord

_P = EffectParameter


class Saturation(Effect):
    """The output is clipped."""

    id, name, family, sensors = "saturation", "saturation", "deterministic", BOTH
    formula = "y = clip(s, -limit, limit)"
    parameters = (_P("limit", "{s}", 3, (250.0 * DEG, 4.0 * G), None, "full scale", True, join="smaller", nothing=1e6),)
    excitation, in_filter = "motion beyond the full scale", "epochs flagged"
    traits = frozenset({"samples", "filled", "evident"})
    stage = Stage.CLIP
    absent = {"compensate": "what was clipped is lost", "signature": IN_SAMPLES}

    def inject(self, chain: Chain, use: EffectUse, rng: np.random.Generator) -> None:
        """Clip the rows."""
        for row, limit in zip(chain.rows(use.sensor), use["limit"], strict=True):
            np.clip(row, -limit, limit, out=row)

    def hidden(self, lot: DriveLot) -> Hidden:
        """A few samples in a thousand lie beyond the full scale of one axis."""
        return Hidden(lot.axis, {"limit": lot.limits()}, lot.loud)

    def hidden_at_rest(self, lot: RestLot, strength: float) -> dict[str, Any]:
        """A few standard deviations; the other axes have room."""
        limit = 3.0 * lot.sample / np.sqrt(strength)
        return {"limit": [float(limit) if k == lot.place else 1.0 for k in range(3)]}


class DroppedSamples(Effect):
    """Samples that never came."""

    id, name, family, sensors = "dropped_samples", "dropped samples", "deterministic", IMU
    formula = "samples vanish in bursts of `burst` with probability p each"
    parameters = (
        _P("probability", "", 1, (0.001,), None, "share of samples that start a burst", True, join="larger", most=1.0),
        _P("burst", "", 1, (1.0,), 1.0, "samples per burst", True, join="larger"),
    )
    excitation, in_filter = "motion", "filled in by the samples around them, or bridged by the time stamps"
    traits = frozenset({"samples", "drawn", "filled", "evident"})
    stage = Stage.LOSS
    absent = {"signature": IN_SAMPLES}

    def restored(self, use: EffectUse, imu: ImuRecord) -> ImuRecord:
        """Those that there are, whatever their share."""
        return restored(imu)[0]

    def inject(self, chain: Chain, use: EffectUse, rng: np.random.Generator) -> None:
        """Mark bursts as lost."""
        n = chain.keep.size
        length = min(max(1, round(use.scalar("burst"))), n)
        start = np.nonzero(rng.random(n) < use.scalar("probability"))[0]
        edges = (
            np.bincount(start, minlength=n + length) - np.bincount(start + length, minlength=n + length)[: n + length]
        )
        chain.keep &= np.cumsum(edges[:n]) == 0

    def hidden(self, lot: DriveLot) -> Hidden:
        """One sample in a thousand begins a burst of one to three."""
        return Hidden((), {"probability": 1e-3 * lot.loud, "burst": float(lot.rng.integers(1, 4))}, lot.loud)

    def hidden_at_rest(self, lot: RestLot, strength: float) -> dict[str, Any]:
        """Single samples."""
        return {"probability": 2e-3 * strength}


EFFECTS: tuple[Effect, ...] = (Saturation(), DroppedSamples())
