"""Errors without a name in a drive: named with their equation, throughout or from a time on; what is said of a recording first."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.trial.drives import stage
from insemu.effects import EffectUse
from insemu.errors import InputError
from insemu.gap import Nominal, find_gap
from insemu.gap.beliefs.refined import refined_nominal
from insemu.gap.candidates.jumps import changed_term
from insemu.gap.candidates.unexplained import Unexplained
from insemu.gap.drive.changes import scanned
from insemu.gap.drive.preparation import Flown
from insemu.gap.drive.scene import TERMS, Scene
from insemu.gap.verdict import HALF_SAMPLE, Finding, Value, with_half_sample
from insemu.records import ImuRecord, Recording
from insemu.report.gap import finding_action


def use(**mapping: object) -> EffectUse:
    return EffectUse.from_mapping({"effect": "expression", **mapping})


def recorded(*effects: EffectUse) -> tuple[Recording, Nominal]:
    drawn = stage(64, 4.0, 50.0, track="uav")
    return drawn.record(effects), drawn.nominal


def test_every_start_in_one_pass_is_the_response_from_that_start_on() -> None:
    """Squares and products of the pass backwards against responses that are worked out start by start."""
    scene = Scene.of(Flown.of(*recorded()).prepared)
    use_, t = scene.loop.use, scene.motion.t[scene.loop.result.nodes.epoch]
    v = np.where(use_[:, :, None], np.random.default_rng(1).standard_normal((*use_.shape, 2)), 0.0)
    count = len(use_) - 30
    squares, products = scanned(scene.loop, scene.changing.built, v, count)
    rows = np.flatnonzero(use_)
    rows = rows[rows < 6 * count]
    for node in (2, t.size // 2, t.size - 60):
        for j in (0, 5, 20):
            G = scene.whitened(scene.window_answers([(TERMS + j, t[node - 1], np.inf)]))[: rows.size, 0]
            assert squares[node, j] == pytest.approx(float(G @ G), rel=1e-9)
            np.testing.assert_allclose(
                products[node, j], G @ v.reshape(-1, 2)[rows], rtol=1e-6, atol=1e-9 * np.abs(products).max()
            )


def test_a_scale_factor_that_changes_is_named_with_its_start() -> None:
    made = use(effect="expression_step", sensor="gyro", equation="z = rate_z", value=0.02, start=100.0)
    scene = Scene.of(Flown.of(*recorded(made)).prepared)
    hypotheses = changed_term(Unexplained(scene, scene.data, slice(None), ()))
    best = max(hypotheses, key=lambda h: h.nats)
    assert (best.sensor, best.axes) == ("gyro", ("z = rate_z",)) and best.nats > 20.0
    value, start = best.values
    assert value.low < 0.02 < value.high
    assert start.low <= 100.0 <= start.high and start.high - start.low < 30.0
    silent = Scene.of(Flown.of(*recorded()).prepared)
    assert max(h.nats for h in changed_term(Unexplained(silent, silent.data, slice(None), ()))) < 3.0


@pytest.mark.slow(reason="two whole searches of a drive, whose parts have quick tests")
def test_an_error_of_the_positions_is_named_with_its_equation_and_is_gone_afterwards() -> None:
    measured, nominal = recorded(use(sensor="gnss", equation="east = speed", value=-0.2))
    report = find_gap(measured, nominal, rng=np.random.default_rng(1), pictures=False)
    assert report.verdict == "named" and not report.remainder
    (found,) = report.findings
    assert (found.effect, found.sensor, found.axes) == ("expression", "gnss", ("east = speed",))
    (value,) = found.parameters
    assert value.low < -0.2 < value.high and value.unit == "s" and found.metres > 0.0
    assert "east = -0." in finding_action(found) and "s * (speed)" in finding_action(found)
    assert report.gap_after.low < 1.0 < report.gap_after.high and report.held_out.value > 0.0
    refined = refined_nominal(nominal, report, measured.imu.dt)
    again = find_gap(measured, refined, rng=np.random.default_rng(1), hold_out=False, pictures=False)
    assert again.verdict == "nothing missing"


def test_a_wrong_sign_of_an_axis_is_said_first() -> None:
    measured, nominal = recorded()
    gyro = measured.imu.gyro * [-1.0, 1.0, 1.0]
    mirrored = replace(measured, imu=replace(measured.imu, gyro=gyro))
    with pytest.raises(InputError, match="gyro_x has the wrong sign"):
        find_gap(mirrored, nominal, rng=np.random.default_rng(1), hold_out=False, pictures=False)


@pytest.mark.slow(reason="a whole search of a drive with figures on held-out fixes")
def test_before_is_the_recording_as_it_came() -> None:
    """A clock 0.12 s late is put right before the search, and what the figures compare is still what came."""
    measured, nominal = recorded()
    late = replace(measured, imu=replace(measured.imu, t=measured.imu.t + 0.12))
    report = find_gap(late, nominal, rng=np.random.default_rng(1), pictures=False)
    assert [f.effect for f in report.findings] == ["imu_gnss_time_offset"]
    assert report.gap_before.low > 1.5 and report.gap_after.low < 1.2
    assert report.held_out.low > 0.0


def test_half_a_sample_is_said_of_values_at_stamps_alone() -> None:
    t = np.arange(100) * 0.01
    found = Finding(
        "imu_gnss_time_offset", "", "imu", (), (Value("offset", 0.0052, 0.0045, 0.0059, "s"),), 1.0, 50.0, ()
    )
    values = ImuRecord(t, np.zeros((100, 3)), np.zeros((100, 3)), "sample")
    said = with_half_sample(found, values)
    assert said.variant == HALF_SAMPLE and "kind=mean" in finding_action(said)
    assert with_half_sample(found, replace(values, kind="mean")) is found
    other = replace(found, parameters=(Value("offset", 0.008, 0.007, 0.009, "s"),))
    assert with_half_sample(other, values) is other
