"""Every effect through everything that the program does with effects: a hole is a failing test, an absence needs a reason on the effect."""

from __future__ import annotations

import functools
import inspect
import re
from pathlib import Path

import numpy as np
import pytest

from insemu import effects, gap
from insemu.effects import AID_KINDS, ASPECTS, EFFECTS, DriveLot, Effect, EffectUse, RestLot, aid_age, aid_corrected
from insemu.emulate import built_in, corrupt, gnss_fixes, ideal_imu
from insemu.filters import AIDS, AidUse, TrueMotion
from insemu.gap.candidates.axis import CANDIDATES
from insemu.records import AidRecord, Recording
from insemu.rotation import dcm_from_rpy


def lot(effect: Effect, seed: int = 1) -> DriveLot:
    sensor = next((s for s in effect.sensors if s in ("gyro", "accel")), effect.sensors[0])
    rng = np.random.default_rng(seed)
    return DriveLot(
        sensor, 1, -1.0, 2.0, ("north", "east"), 3, 5, 1e-3, 0.02, 600.0, np.array([0.1, 0.1, 0.2]), rng, lambda: (1.0, 2.0, 3.0)
    )  # fmt: skip


@functools.cache
def named_by_gap() -> frozenset[str]:
    """Ids that the sources of the gap room's candidates name."""
    folder = Path(inspect.getfile(gap)).parent
    text = "".join(
        p.read_text(encoding="utf-8")
        for part in ("candidates", "evidence", "data", "drive")
        for p in (folder / part).glob("*.py")
    )
    return frozenset(e for e in EFFECTS if re.search(rf'"{e}"', text))


def present(effect: Effect, aspect: str) -> bool:
    match aspect:
        case "emulate":
            return any(effect.does(how) for how in ("inject", "inject_fixes", "inject_aid", "age"))
        case "compensate":
            return effect.compensable
        case "signature":
            return effect.does("columns") or effect.does("aid_columns")
        case "candidate":
            # a column is a candidate of every drive, a slow process of every axis
            own = present(effect, "signature") or "process" in effect.traits or effect.id in CANDIDATES
            # noise of an aid is asked for by the name of the aid (insemu/gap/problems/aids.py)
            own = own or effect.family == "aids"
            return own or effect.id in named_by_gap()
        case "refine":
            # noise joins the model of its axis; everything else becomes an entry of the refined model's effects (tests/test_gap_refined.py)
            return present(effect, "candidate")
        case _:
            return effect.does("hidden") or effect.does("hidden_at_rest")


@pytest.mark.parametrize("name", EFFECTS)
def test_the_matrix_has_no_hole(name: str) -> None:
    effect = EFFECTS[name]
    assert set(effect.absent) <= set(ASPECTS)
    for aspect in ASPECTS:
        reason = effect.absent.get(aspect, "")
        if present(effect, aspect):
            assert not reason, f"{aspect}: present and said to be absent"
        else:
            assert len(reason) > 15, f"{aspect}: absent without a reason on the effect"


@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_says_what_it_is(name: str) -> None:
    effect = EFFECTS[name]
    assert effect.id == name
    assert effect.stage is not None
    assert effect.__doc__
    for p in effect.parameters:
        assert len(p.labels(effect.axes)) == (p.size if effect.axes or p.size > 3 else 1)
    if effect.size:
        effect.parameter(effect.size)


@functools.cache
def ideal():
    made = ideal_imu(built_in("lemniscate"), 100.0, span=(0.0, 60.0))
    return made.imu, made.reference


def typical(effect: Effect, sensor: str) -> EffectUse:
    values = {p.name: (effect.scale(p.name, sensor),) * (p.size if p.size == 6 else 1) for p in effect.parameters}
    if effect.id == "saturation":
        values["limit"] = (0.3 if sensor == "gyro" else 5.0,)
    if effect.id == "gnss_multipath_step":
        values["start"], values["duration"] = (10.0,), (20.0,)
    if effect.id in ("lever_arm_step", "expression_step"):
        values["start"] = (10.0,)
    if effect.id == "gnss_quality":
        values["good"] = (5.0,)
    if effect.id == "dropped_samples":
        values["probability"] = (0.01,)
    equation = {"gyro": "x = rate_y * speed", "accel": "y = force_x ** 2", "gnss": "east = speed"}
    return EffectUse(effect.id, sensor, values, equation[sensor] if "equation" in effect.traits else "")


@pytest.mark.parametrize("name", EFFECTS)
def test_injecting_it_changes_the_data(name: str) -> None:
    imu, reference = ideal()
    for sensor in EFFECTS[name].sensors:
        use = typical(EFFECTS[name], sensor)
        rng = np.random.default_rng(1)
        if sensor == "gnss":
            plain, made = (gnss_fixes(reference, 4.0, rng=np.random.default_rng(2), effects=u) for u in ((), (use,)))
            same = [np.array_equal(getattr(plain, k), getattr(made, k)) for k in ("t", "llh", "vel_ned", "pos_std_ned")]
        elif sensor in AID_KINDS:
            plain, made = (recorded(sensor, *u) for u in ((), (use,)))
            same = [np.array_equal(plain.values, made.values)]
        else:
            made = corrupt(imu, None, rng, effects=[use], reference=reference, temperature=20.0 + 0.2 * imu.t).imu
            same = [np.array_equal(getattr(imu, k), getattr(made, k)) for k in ("t", "gyro", "accel")]
        assert not all(same)


@functools.cache
def moved() -> TrueMotion:
    reference = ideal()[1]
    t = reference.t
    rate = np.gradient(np.unwrap(reference.rpy, axis=0), t, axis=0)
    return TrueMotion(reference.llh, reference.vel_ned, dcm_from_rpy(reference.rpy), rate)


def recorded(kind: str, *uses: EffectUse) -> AidRecord:
    """What an aid records of the flight, sample by sample of the IMU, with noise of its own that no effect changes."""
    t, motion = ideal()[1].t, moved()
    rows = t - aid_age(kind, uses)
    late = np.clip(np.searchsorted(t, rows - 1e-9), 0, t.size - 1)
    seen = TrueMotion(motion.llh[late], motion.velocity[late], motion.C[late], motion.rate[late])
    made = AidUse(AIDS[kind], 100.0, (1e-9,) * len(AIDS[kind].rows))
    return made.record(t, seen, np.random.default_rng(4), uses)


SHAPES = [e for e in EFFECTS if EFFECTS[e].does("aid_columns")]


@pytest.mark.parametrize("name", SHAPES)
def test_an_aid_is_put_right(name: str) -> None:
    for sensor in EFFECTS[name].sensors:
        use = typical(EFFECTS[name], sensor)
        plain, made = recorded(sensor), recorded(sensor, use)
        back = aid_corrected(made, [use], 0.0)
        if name == "aid_lag":
            np.testing.assert_allclose(back.t, made.t - 0.1, atol=1e-12)
            np.testing.assert_allclose(back.values[20:], plain.values[10:-10], atol=1e-6)
        else:
            np.testing.assert_allclose(back.values, plain.values, atol=1e-6)


@pytest.mark.parametrize("name", SHAPES)
def test_an_aid_is_off_by_the_columns_of_its_effect(name: str) -> None:
    effect = EFFECTS[name]
    for sensor in effect.sensors:
        true = recorded(sensor).values
        turns = np.unwrap(true, axis=0) if sensor == "heading" else true
        slope = np.gradient(turns, 0.01, axis=0)
        for label, column in effect.aid_columns(true, slope).items():
            size = 0.01 * effect.scale(label, sensor) if name != "aid_lag" else 0.01
            given = {label: (size,)} | {k: (v,) for k, v in effect.settled_with(true).items()}
            off = recorded(sensor, EffectUse(name, sensor, given)).values - true
            if sensor == "heading":
                off = np.angle(np.exp(1j * off))
            inside = slice(3, -3)
            most = np.abs(size * column).max()
            np.testing.assert_allclose(off[inside], size * column[inside], atol=0.02 * most + 1e-7)


def test_taking_off_lost_samples_fills_them_in() -> None:
    imu, _ = ideal()
    use = typical(EFFECTS["dropped_samples"], "imu")
    made = corrupt(imu, None, np.random.default_rng(1), effects=[use]).imu
    back = effects.compensated(Recording(made), [use]).imu
    assert len(made) < len(imu) - 20
    # where nothing follows nothing is missed
    there = imu.rows(imu.t <= made.t[-1] + 1e-9)
    np.testing.assert_allclose(back.t, there.t, atol=1e-9)
    for key in ("gyro", "accel"):
        assert np.abs(getattr(back, key) - getattr(there, key)).max() < 1e-3 * np.abs(getattr(there, key)).max()


UNDONE = [
    e
    for e in EFFECTS
    if EFFECTS[e].compensable and EFFECTS[e].family not in ("gnss", "aids") and e != "dropped_samples"
]


@pytest.mark.parametrize("name", UNDONE)
@pytest.mark.parametrize("kind", ["increment", "mean"])
def test_taking_it_off_undoes_injecting_it(name: str, kind: str) -> None:
    imu, reference = ideal()
    if kind == "mean":
        imu = type(imu)(imu.t, imu.gyro / imu.dt, imu.accel / imu.dt, "mean")
    for sensor in EFFECTS[name].sensors:
        use = typical(EFFECTS[name], sensor)
        rng = np.random.default_rng(1)
        made = corrupt(imu, None, rng, effects=[use], reference=reference, temperature=20.0 + 0.2 * imu.t).imu
        back = effects.compensated(Recording(made), [use], trajectory=reference).imu
        for key in ("t", "gyro", "accel"):
            moved, left = (getattr(x, key) - getattr(imu, key) for x in (made, back))
            assert np.abs(left).max() <= 1e-6 * max(np.abs(moved).max(), 1e-6)


@pytest.mark.parametrize("name", [e for e in EFFECTS if EFFECTS[e].does("hidden")])
def test_a_trial_can_hide_it_in_a_drive(name: str) -> None:
    effect = EFFECTS[name]
    first, again = (effect.hidden(lot(effect)) for _ in range(2))
    assert first == again
    use = EffectUse(name, lot(effect).sensor, first.values)
    assert set(first.axes) <= set(effect.axes or ("",)) or not first.axes
    assert any(v != p.nothing for p in effect.parameters for v in use[p.name])
    if effect.size:
        assert any(use[effect.size])


@pytest.mark.parametrize("name", [e for e in EFFECTS if EFFECTS[e].does("hidden_at_rest")])
def test_a_trial_can_hide_it_at_rest_at_every_strength(name: str) -> None:
    effect = EFFECTS[name]
    log = RestLot.drawn(72_000, 0.05, 1e-3, 2, np.random.default_rng(3))
    sensor = "imu" if effect.sensors == ("imu",) else "gyro"
    weak, strong = (
        EffectUse.from_mapping({"effect": name, "sensor": sensor, **effect.hidden_at_rest(log, s)}) for s in (0.5, 2.0)
    )
    assert weak != strong


def test_two_finds_add_up() -> None:
    def use(**mapping: object) -> EffectUse:
        return EffectUse.from_mapping(mapping)

    (both,) = effects.joined(
        [use(effect="saturation", sensor="gyro", limit=4.0)], [use(effect="saturation", sensor="gyro", limit=[1, 9, 9])]
    )
    assert both["limit"] == (1.0, 4.0, 4.0)  # the tighter clip is what comes out
    (both,) = effects.joined(
        [use(effect="gnss_velocity_noise", sigma=3.0)], [use(effect="gnss_velocity_noise", sigma=4.0, factor=2.0)]
    )
    assert both["sigma"] == (5.0, 5.0, 5.0)
    assert both["factor"] == (2.0, 2.0, 2.0)
    known = use(effect="outliers", sensor="gyro", probability=0.1, sigma=1.0)
    assert effects.joined([known], [known]) == (known, known)
    for effect in EFFECTS.values():
        joins = {p.join for p in effect.parameters}
        assert effect.does("merged") or joins == {""} or "" not in joins or joins == {"", "sum"}, effect.id
