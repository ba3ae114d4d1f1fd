"""What every effect does to a small record, to fixes and to what a filter sees of it, as it is."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest

from insemu import rotation
from insemu.denoise import outstanding
from insemu.effects import AID_KINDS, EFFECTS, AidErrors, EffectUse, Signals, aid_age, aid_corrected
from insemu.effects.base import Effect
from insemu.effects.chain import FixErrors
from insemu.effects.hiding import DriveLot, RestLot
from insemu.effects.motion import FixGeometry, Motion, _quiet, steady
from insemu.emulate import TemperatureProfile, corrupt
from insemu.errors import InputError
from insemu.records import AidRecord, GnssRecord, ImuRecord, Trajectory
from tests.pins import differences, kept, plain

N, DT = 900, 0.02
#: A record rarely begins at zero, s.
START = 4.25
RNG = np.random.default_rng


@cache
def reference() -> Trajectory:
    """Eighteen seconds of a vehicle that stands, then turns and rolls."""
    t = DT * np.arange(N)
    moving = np.clip((t - 4.0) / 4.0, 0.0, 1.0)
    rpy = np.column_stack([0.2 * np.sin(0.9 * t), 0.1 * np.cos(1.3 * t), 0.5 + 0.4 * t]) * moving[:, None]
    vel = moving[:, None] * np.column_stack([9.0 * np.cos(0.4 * t), 9.0 * np.sin(0.4 * t), 0.3 * np.sin(t)])
    place = np.cumsum(vel, axis=0) * DT / [6.37e6, 4.4e6, -1.0] + [0.81, 0.12, 400.0]
    return Trajectory(START + t, place, vel, rpy)


@cache
def imu(kind: Any = "mean") -> ImuRecord:
    t = DT * np.arange(N)
    moving = np.clip((t - 4.0) / 4.0, 0.0, 1.0)
    w = 0.5 * np.column_stack([np.sin(0.9 * t), np.cos(1.3 * t + 1), np.sin(0.4 * t) * np.cos(2.1 * t)])
    f = np.column_stack([4 * np.sin(0.7 * t), 3 * np.cos(0.5 * t), 5 * np.sin(1.1 * t)])
    down = np.array([0.0, 0.0, -9.8])
    per = DT if kind == "increment" else 1.0
    warm = 20.0 + 8.0 * t / t[-1]
    return ImuRecord(START + t, per * w * moving[:, None], per * (f * moving[:, None] + down), kind, warm)


@cache
def motion() -> Motion:
    r = reference()
    q = rotation.quaternion_from_dcm(rotation.dcm_from_rpy(r.rpy))
    return Motion.of(imu("increment"), np.hstack([r.llh, r.vel_ned, q]), np.arange(0, N, 50))


def _signals() -> Signals:
    rows = np.arange(0, N, 7)
    return Signals(imu().t[rows], rate=imu().gyro[rows], force=imu().accel[rows], temperature=imu().temperature[rows])


@cache
def geometry() -> FixGeometry:
    return FixGeometry.of(motion(), START + np.arange(0.5, 17.0, 0.75), [0.5, -0.3, -1.2], (0.05, -0.02, 0.1))


@cache
def fixes() -> GnssRecord:
    t, k = START + np.arange(0.0, 17.0, 0.5), 25 * np.arange(34)
    r = reference()
    return GnssRecord(t, r.llh[k], r.vel_ned[k], np.full((34, 3), 0.5), np.full((34, 3), 0.05))


#: Of the effect that is one.
EQUATIONS = {"gyro": "x = rate_y * speed", "accel": "y = force_x ** 2", "gnss": "east = speed"}


def _use(effect: Effect, sensor: str, times: float = 1.0) -> EffectUse:
    """At the datasheet's scale, another number on every axis; what has a default keeps it."""
    values = {}
    for p in effect.parameters:
        if p.default is not None:
            continue
        each = np.array([1.0, -0.4, 0.7, 0.2, -1.1, 0.9, 0.3, -0.6, 0.5])[: p.size]
        values[p.name] = tuple(
            float(v) for v in times * effect.scale(p.name, sensor) * (abs(each) if p.positive else each)
        )
    return EffectUse(effect.id, sensor, values, EQUATIONS[sensor] if "equation" in effect.traits else "")


def _drive_lot(sensor: str) -> DriveLot:
    return DriveLot(
        sensor,
        1,
        -1.0,
        2.0,
        ("north", "down"),
        4,
        5,
        3e-3,
        DT,
        300.0,
        np.array([0.5, 0.6, 0.9]),
        RNG(11),
        lambda: (2.0, 3.0, 20.0),
    )


def _or_refused(call: Callable[[], Any]) -> Any:
    try:
        return plain(call())
    except (InputError, NotImplementedError) as error:
        return f"{type(error).__name__}: {error}"


def _fixes(use: EffectUse) -> Any:
    t, vel = fixes().t, fixes().vel_ned
    errors = FixErrors(
        t, np.array([0.5, 0.6, 0.9]), np.array([0.05, 0.06, 0.09]), RNG(3), RNG(4), lambda: Signals(t, vel)
    )
    use.effect.inject_fixes(errors, use, RNG(5))
    return [
        errors.position(), errors.velocity(), errors.stated(), errors.stated_velocity(), errors.arm, errors.latency,
        errors.velocity_lag, errors.velocity_window, errors.velocity_tau,
        *([errors.position_tau, errors.arm_at(errors.t)] if errors.position_tau.any() or errors.arm_steps else ()),
    ]  # fmt: skip


def _record(kind: str) -> AidRecord:
    t = START + np.arange(0.0, 17.0, 0.5)
    rows = 3 if kind == "odometer" else 1
    values = np.column_stack([9.0 * np.sin(0.3 * (k + 1) * t) + 2.0 * k for k in range(rows)])
    return AidRecord(kind, t, values, np.full((t.size, rows), 0.1))


def _aid(use: EffectUse) -> Any:
    record = _record(use.sensor)
    errors = AidErrors.of(record.t, record.values)
    if use.effect.does("inject_aid"):
        use.effect.inject_aid(errors, use, RNG(7))
    slope = np.gradient(record.values, record.t, axis=0)
    return [
        errors, aid_age(use.sensor, [use]), aid_corrected(record, [use], START),
        use.effect.aid_columns(record.values, slope) if use.effect.does("aid_columns") else None,
        use.effect.settled_with(record.values),
    ]  # fmt: skip


def _imu(use: EffectUse, kind: str) -> Any:
    out = corrupt(
        imu(kind),
        None,
        RNG(1),
        effects=[use],
        reference=reference(),
        temperature=TemperatureProfile((START, START + 18.0), (20.0, 28.0)),
    )
    assert out.imu is not None
    return [out.imu.t, out.imu.gyro, out.imu.accel, out.kept]


def _effect(effect: Effect, sensor: str) -> dict[str, Any]:
    """Everything that an effect does by itself."""
    use = _use(effect, sensor)
    signal, warm = np.hstack([imu().gyro, imu().accel]), imu().temperature
    calls: dict[str, Callable[[], Any]] = {
        "said": lambda: [use.to_mapping(), effect.compensable, effect.needs_trajectory, effect.adds],
        "merged": lambda: [
            m and m.to_mapping() for m in (effect.merged(use, _use(effect, sensor, 2.0)), effect.merged(use, use))
        ],
    }
    if sensor == "gnss":
        calls["fixes"] = lambda: _fixes(use)
    elif sensor in AID_KINDS:
        calls["aid"] = lambda: _aid(use)
    else:
        calls |= {kind: lambda kind=kind: _imu(use, kind) for kind in ("mean", "increment")}
    own: dict[str, Callable[[], Any]] = {
        "added": lambda: effect.added(use, imu().t, warm),
        "matrix": lambda: effect.matrix(use),
        "bent": lambda: effect.bent(use, signal, warm, imu().t),
        "turn": lambda: effect.turn(use),
        "true_time": lambda: effect.true_time(use, imu().t),
        "omitted": lambda: effect.omitted(use, reference(), np.arange(0, N, 7), _signals()),
        "corrected_fixes": lambda: effect.corrected_fixes(use, fixes()),
        "true_sigma": lambda: [effect.true_sigma(use, what, np.full((2, 3), 0.5)) for what in ("position", "velocity")],
        "arm": lambda: effect.arm(use),
        "columns": lambda: effect.columns(motion(), geometry()),
        "subsets": lambda: effect.subsets(effect.columns(motion(), geometry())),
        "hidden": lambda: effect.hidden(_drive_lot(sensor)),
        "hidden_at_rest": lambda: [
            effect.hidden_at_rest(RestLot.drawn(60_000, DT, 2e-3, place, RNG(place + 5)), strength)
            for place, strength in ((0, 1.0), (2, 3.0))
        ],
    }
    calls |= {
        name: call for name, call in own.items() if effect.does(name) or (name == "subsets" and effect.does("columns"))
    }
    if "equation" in effect.traits:  # a column for every term, which tests/test_expression.py looks at
        calls = {name: call for name, call in calls.items() if name not in ("columns", "subsets")}
    return {name: _or_refused(call) for name, call in calls.items()}


CASES: dict[str, Callable[[], Any]] = {
    **{
        f"{effect.id} of {sensor}": lambda effect=effect, sensor=sensor: _effect(effect, sensor)
        for effect in EFFECTS.values()
        for sensor in effect.sensors
    },
    "motion": lambda: [motion(), motion().warmth, motion().acceleration, geometry(), geometry().change_per_second],
    "lots": lambda: [
        (lot.sample, lot.slow, lot.span, lot) for lot in (RestLot.drawn(n, DT, 1e-3, 1, RNG(n)) for n in (1000, 90_000))
    ],
}
KEPT = kept("effects")


@pytest.mark.parametrize("name", CASES)
def test_an_effect_is_as_it_was(name: str) -> None:
    assert not differences(plain(CASES[name]()), KEPT.get(name))


def test_a_search_tries_each_column_alone_and_all_together() -> None:
    effect = EFFECTS["scale_factor"]
    columns = effect.columns(motion(), geometry())[:3]
    assert [rows for _, _, rows in effect.subsets(columns)] == [[0], [1], [2], [0, 1, 2]]
    assert effect.subsets(columns[:2]) == [(("x",), "", [0]), (("y",), "", [1]), (("x", "y"), "all", [0, 1])]
    assert effect.subsets(columns[:1]) == [(("x",), "", [0])]


def test_motion_is_taken_from_octaves_of_a_sixteenth_of_the_record_and_of_forty_seconds() -> None:
    x = np.cumsum(RNG(2).standard_normal((1024, 3)), axis=0)
    for rows, dt, levels in (
        (1024, 0.01, 6),
        (1023, 0.01, 5),
        (1024, 2.5, 4),
        (1024, 2.6, 3),
        (40, 0.01, 1),
        (20, 0.01, 1),
    ):
        np.testing.assert_array_equal(_quiet(x[:rows], dt), steady(outstanding(x[:rows], levels), dt))


def test_motion_is_slower_than_eight_hertz_and_not_late() -> None:
    t = np.arange(6000) * 0.01
    at = slice(500, -500)

    def kept(hertz: float) -> float:
        wave = np.sin(2.0 * np.pi * hertz * t)[:, None]
        return float(np.sum(steady(wave, 0.01)[at] * wave[at]) / np.sum(wave[at] ** 2))

    assert [kept(f) for f in (0.5, 4.0)] == pytest.approx([1.0, 1.0], abs=0.01)
    assert kept(8.0) < 0.1 and abs(kept(12.0)) < 1e-3
    # nothing is faster where samples are that far apart
    x = np.cumsum(RNG(3).standard_normal((64, 3)), axis=0)
    np.testing.assert_array_equal(steady(x, 0.1), x)
    np.testing.assert_allclose(steady(np.vstack([np.zeros((1, 3)), np.ones((63, 3))]), 0.01), 1.0, atol=1e-9)


def test_a_low_pass_ends_below_half_of_the_rate() -> None:
    half = 0.5 / imu().dt
    for cutoff in (half, 1.1 * half):
        with pytest.raises(InputError, match="is not below half of the rate, 25 Hz"):
            _imu(EffectUse("decimation_filter", "gyro", {"cutoff": (cutoff,), "order": (2.0,)}), "mean")
    _imu(EffectUse("decimation_filter", "gyro", {"cutoff": (0.99 * half,), "order": (2.0,)}), "mean")
