"""Errors without a name: the grammar of equations, how they are injected and taken off, and their columns."""

from __future__ import annotations

import numpy as np
import pytest

from insemu import earth, rotation
from insemu.effects import EffectUse, FixGeometry, Motion, Signals, compensated, joined
from insemu.effects.expression import Expression, dictionary
from insemu.effects.terms import equation
from insemu.emulate import built_in, corrupt, gnss_fixes, ideal_imu
from insemu.errors import InputError
from insemu.records import Recording
from insemu.units import parse


@pytest.mark.parametrize(
    ("text", "sensor", "unit"),
    [
        ("east = speed", "gnss", "s"),
        ("north = cos(heading)", "gnss", "m"),
        ("x = force_x * rate_y ** 2", "accel", "s^2/rad^2"),
        ("z = temperature - 25", "accel", "m/s^2/K"),
        ("y = sqrt(abs(force_x)) * after(120)", "gyro", "rad/sqrt(m)"),
    ],
)
def test_the_unit_of_a_coefficient_is_that_of_the_error_over_the_term(text, sensor, unit):
    assert equation(text, sensor).unit == unit
    assert parse(f"2 {unit}", unit) == 2.0


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("east = __import__('os').system('true')", "not of the grammar"),
        ("east = speed.real", "not of the grammar"),
        ("east = [speed for speed in (1, 2)]", "not of the grammar"),
        ("east = speed if speed else 1", "not of the grammar"),
        ("up = speed", "left side one of north, east, down"),
        ("east = spead", "did you mean 'speed'"),
        ("east = speed + heading", "sum of two different quantities"),
        ("east = sin(speed)", "what is no angle"),
        ("east = speed ** 9", "the power 9"),
        ("east = lag(speed, 3)", "no 'lag' in an error of fixes"),
        ("east = " + "-" * 150 + "speed", ""),
        ("east = " + "speed * " * 60 + "1", "at most 200 characters"),
        ("east", "expected an equation"),
    ],
)
def test_what_is_no_equation_is_refused_and_never_run(text, said):
    if not said:
        assert equation(text, "gnss").unit == "s"
        return
    with pytest.raises(InputError, match=said):
        EffectUse.from_mapping({"effect": "expression", "sensor": "gnss", "equation": text, "value": 1.0})


def test_only_an_expression_has_an_equation_and_it_needs_one():
    with pytest.raises(InputError, match="expected it of 'expression' and 'expression_step'"):
        EffectUse.from_mapping({"effect": "lever_arm", "value": 1.0, "equation": "east = speed"})
    with pytest.raises(InputError, match="needs the key 'equation'"):
        EffectUse.from_mapping({"effect": "expression", "sensor": "gnss", "value": 1.0})


def test_a_term_is_what_its_signals_say():
    t = np.arange(0.0, 4.0)
    s = Signals(
        t,
        velocity=np.column_stack([3.0 * t, 4.0 * t, 0.0 * t]),
        temperature=20.0 + t,
        force=np.tile([-2.0, 0.0, 9.0], (4, 1)),
    )
    for text, value in {
        "x = speed": 5.0 * t,
        "x = velocity_east / 2 - 1": 2.0 * t - 1.0,
        "x = (temperature - 20) ** 2": t**2,
        "x = -abs(force_x) * sign(force_z)": np.full(4, -2.0),
        "x = after(1) + between(0, 2)": [0.0, 1.0, 2.0, 1.0],
        "x = above(speed, 7)": [0.0, 0.0, 1.0, 1.0],
    }.items():
        np.testing.assert_allclose(equation(text, "accel").of(s), value, atol=1e-12)
    with pytest.raises(InputError, match="no finite value at 0 s"):
        equation("x = 1 / speed", "accel").of(s)
    with pytest.raises(InputError, match="'rate_x' of an equation is not known"):
        equation("x = rate_x", "accel").of(s)


def test_what_was_found_later_adds_to_the_same_equation_alone():
    def use(text: str, value: float) -> EffectUse:
        return EffectUse.from_mapping({"effect": "expression", "sensor": "gnss", "equation": text, "value": value})

    both = joined([use("east=speed", 1.0)], [use("east = speed", 0.5), use("north = speed", 2.0)])
    assert [(u.equation, u.scalar("value")) for u in both] == [("east = speed", 1.5), ("north = speed", 2.0)]
    assert EffectUse.from_mapping(both[0].to_mapping()) == both[0]


def test_positions_are_off_by_it_and_put_right():
    made = ideal_imu(built_in("lemniscate"), 100.0, span=(0.0, 60.0))
    use = EffectUse.from_mapping(
        {"effect": "expression", "sensor": "gnss", "equation": "east = speed", "value": "-56 ms"}
    )
    plain, off = (gnss_fixes(made.reference, 4.0, rng=np.random.default_rng(2), effects=u) for u in ((), (use,)))
    moved = earth.position_difference(off.llh, plain.llh)
    k = np.searchsorted(made.reference.t, plain.t - 1e-9)
    np.testing.assert_allclose(
        moved[:, 1], -0.056 * np.linalg.norm(made.reference.vel_ned[k], axis=1), rtol=1e-4, atol=1e-6
    )
    np.testing.assert_allclose(moved[:, [0, 2]], 0.0, atol=1e-6)
    back = compensated(Recording(made.imu, off), [use], trajectory=made.reference).gnss
    np.testing.assert_allclose(earth.position_difference(back.llh, plain.llh), 0.0, atol=1e-3)


def test_a_product_of_motion_and_force_is_taken_off_a_sensor():
    made = ideal_imu(built_in("lemniscate"), 100.0, span=(0.0, 60.0))
    text = {"effect": "expression", "sensor": "accel", "equation": "y = speed * rate_z * after(20)", "value": 0.01}
    use = EffectUse.from_mapping(text)
    off = corrupt(made.imu, None, np.random.default_rng(1), effects=[use], reference=made.reference).imu
    moved = np.abs(off.accel - made.imu.accel)
    assert moved[off.t <= 20.0].max() < 1e-12 < moved[off.t > 20.0, 1].max()
    back = compensated(Recording(off), [use], trajectory=made.reference).imu
    assert np.abs(back.accel - made.imu.accel).max() < 1e-9 * moved.max()


def test_every_term_of_the_dictionary_has_a_column_of_its_value():
    """A column is the term along the motion, in the unit of its equation."""
    made = ideal_imu(built_in("lemniscate"), 100.0, span=(0.0, 60.0))
    r, rows = made.reference, np.arange(0, 6000, 100)
    q = rotation.quaternion_from_dcm(rotation.dcm_from_rpy(r.rpy))
    motion = Motion.of(made.imu, np.hstack([r.llh, r.vel_ned, q]), rows)
    fixes = FixGeometry.of(motion, np.arange(1.0, 59.0), np.zeros(3))
    columns = Expression().columns(motion, fixes)
    assert len(columns) == 3 * sum(len(dictionary(s)) for s in Expression.sensors)
    (one,) = (c for c in columns if c.axes == ("east = speed",))
    np.testing.assert_allclose(one.fixes[:, 1], np.linalg.norm(fixes.velocity, axis=1))
    assert np.count_nonzero(one.fixes.any(axis=0)) == 1 and one.unit == "s"
    (two,) = (c for c in columns if c.axes == ("y = rate_x * force_z",) and c.sensor == "accel")
    ((axis, u),) = two.inputs
    assert axis == 4
    np.testing.assert_allclose(u, motion.rate[:, 0] * motion.force[:, 2])
    assert Expression().odds(two) < Expression().odds(one) == 1.0
