"""What a model of motion may leave out: Earth rate, gravity, transport rate."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from insemu import earth, rotation
from insemu.effects.base import IMU, Effect, EffectUse, Stage
from insemu.effects.chain import Chain
from insemu.effects.hiding import DriveLot, Hidden
from insemu.effects.motion import Column, FixGeometry, Motion, on_axes
from insemu.effects.parameters import EffectParameter
from insemu.effects.terms import Signals
from insemu.records import Trajectory

Array = NDArray[np.float64]
_P = EffectParameter


class _Model(Effect):
    """A model that is left out."""

    family = "model"
    sensors = IMU
    axes = ()
    traits = frozenset({"once"})
    stage = Stage.MODEL


def _attitude(trajectory: Trajectory, rows: NDArray[np.int64]) -> Array:
    return np.asarray(rotation.dcm_from_rpy(trajectory.rpy)[rows])


class EarthRate(_Model):
    """The gyroscopes do not show the Earth's rotation."""

    id, name, formula = "earth_rate", "Earth rate omitted", "w misses fraction x C_bn w_ie"
    parameters = (_P("fraction", "", 1, (1.0,), 1.0, "1: all of it", join="sum"),)
    excitation, in_filter = "minutes", "mechanization"

    def inject(self, chain: Chain, use: EffectUse, rng: np.random.Generator) -> None:
        """Note the share."""
        chain.need_reference(use)
        chain.earth_share += use.scalar("fraction")

    def omitted(
        self, use: EffectUse, trajectory: Trajectory, rows: NDArray[np.int64], signals: Signals
    ) -> tuple[Array | None, Array | None]:
        """The Earth rate in body axes."""
        w_n = use.scalar("fraction") * earth.earth_rate(trajectory.llh[rows, 0])
        return np.einsum("nji,nj->ni", _attitude(trajectory, rows), w_n), None

    def columns(self, motion: Motion, fixes: FixGeometry) -> list[Column]:
        """Less of it along the attitude."""
        w_b = -np.einsum("nji,nj->ni", motion.C, earth.earth_rate(motion.llh[:, 0]))
        return [Column.of(self, "imu", "fraction", (), on_axes(w_b))]

    def hidden(self, lot: DriveLot) -> Hidden:
        """All of it."""
        return Hidden((), {"fraction": 1.0})


class GravityModel(_Model):
    """Gravity differs from the model."""

    id, name, formula = "gravity", "gravity model", "f contains -C_bn (0, 0, offset) more"
    parameters = (_P("offset", "m/s^2", 1, (1e-3,), None, "true minus modelled gravity", join="sum"),)
    excitation, in_filter = "fixes", "mechanization"
    size = "offset"

    def inject(self, chain: Chain, use: EffectUse, rng: np.random.Generator) -> None:
        """Note the offset."""
        chain.need_reference(use)
        chain.gravity_offset += use.scalar("offset")

    def omitted(
        self, use: EffectUse, trajectory: Trajectory, rows: NDArray[np.int64], signals: Signals
    ) -> tuple[Array | None, Array | None]:
        """The offset in body axes."""
        return None, np.asarray(use.scalar("offset") * _attitude(trajectory, rows)[:, 2, :])

    def columns(self, motion: Motion, fixes: FixGeometry) -> list[Column]:
        """-C_bn (0, 0, 1)."""
        return [Column.of(self, "imu", "offset", (), on_axes(-motion.C[:, 2, :], 3))]

    def hidden(self, lot: DriveLot) -> Hidden:
        """A constant."""
        return Hidden((), {"offset": lot.size(self, "offset")})


class TransportRate(_Model):
    """The rotation of the local frame over the round Earth is left out."""

    id, name, formula = "transport_rate", "transport rate omitted", "w misses fraction x C_bn w_en"
    parameters = (_P("fraction", "", 1, (1.0,), 1.0, "1: all of it", join="sum"),)
    excitation, in_filter = "long or fast travel", "mechanization"
    absent = {"trial": "at the speeds of the trial's vehicles ten minutes do not show it"}

    def inject(self, chain: Chain, use: EffectUse, rng: np.random.Generator) -> None:
        """Note the share."""
        chain.need_reference(use)
        chain.transport_share += use.scalar("fraction")

    def omitted(
        self, use: EffectUse, trajectory: Trajectory, rows: NDArray[np.int64], signals: Signals
    ) -> tuple[Array | None, Array | None]:
        """The transport rate in body axes."""
        w_n = use.scalar("fraction") * earth.transport_rate(trajectory.llh[rows], trajectory.vel_ned[rows])
        return np.einsum("nji,nj->ni", _attitude(trajectory, rows), w_n), None

    def columns(self, motion: Motion, fixes: FixGeometry) -> list[Column]:
        """Less of it along the attitude."""
        w_b = -np.einsum("nji,nj->ni", motion.C, earth.transport_rate(motion.llh, motion.vel))
        return [Column.of(self, "imu", "fraction", (), on_axes(w_b))]


EFFECTS: tuple[Effect, ...] = (EarthRate(), GravityModel(), TransportRate())
