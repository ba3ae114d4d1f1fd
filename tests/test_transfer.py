"""Static models carried to a drive: known factors come back, outages judge, and a wrong input is said."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats
from typer.testing import CliRunner

from benchmarks.trial.drives import stage
from insemu.augment import Extras
from insemu.cli import app
from insemu.effects import EffectUse
from insemu.errors import InputError
from insemu.filters import Innovations, likeliest, uncertainty
from insemu.gap import Nominal
from insemu.noise import GM, RC, WN, NoiseModel, save
from insemu.records import AXES
from insemu.transfer import CONSTANTS, Estimate, Factor, Levels, estimated, judge, judged, levels_of, session, transfer
from tests import filter_cases as cases

TRUE = {"gyro": NoiseModel((WN(1e-3), GM(3e-4, 0.01))), "accel": NoiseModel((WN(1e-2), GM(5e-3, 0.02)))}
#: By what the drive's white noise exceeds the static one.
FACTOR = 7.0


def drive_of(quieter: float, scale: float = 0.0, across: float = 0.0, seed: int = 5) -> Levels:
    """Six minutes of a vehicle that turns; the white noise, so much quieter than ``TRUE``, is believed too small.

    ``scale``: error of gyro z. ``across``: what accelerometer z sees of x, rad.
    """
    true = {
        sensor: NoiseModel(tuple(p.scaled(1.0 / quieter) if isinstance(p, WN) else p for p in model))
        for sensor, model in TRUE.items()
    }
    static = {
        axis: NoiseModel(
            tuple(p.scaled(1.0 / FACTOR) if isinstance(p, WN) else p for p in true[axis.partition("_")[0]])
        )
        for axis in AXES
    }
    ideal = cases.later(cases.drive(365.0, seed=3), 5.0)
    rng = np.random.default_rng(seed)
    start = cases.start(ideal, rng), cases.START_SIGMA
    gyro, accel = ideal.imu.gyro.copy(), ideal.imu.accel.copy()
    gyro[:, 2] *= 1.0 + scale
    accel[:, 2] += across * ideal.imu.accel[:, 0]
    imu = cases.corrupt(replace(ideal.imu, gyro=gyro, accel=accel), true, rng)
    return Levels(imu, cases.fixes(ideal, rng), start, static, np.zeros(3))


@pytest.fixture(scope="module")
def levels() -> Levels:
    return drive_of(1.0)


@pytest.mark.slow(reason="hours of flight or many realizations")
def test_known_factors_come_back_inside_their_intervals(levels: Levels) -> None:
    found = {f.name: f for f in estimated(levels).factors}
    for sensor in ("gyro", "accel"):
        factor = found[f"{sensor} white"]
        assert factor.decisive
        assert factor.low < FACTOR < factor.high
        assert factor.low > 4.0
    for name in ("fixes position", "fixes velocity"):
        assert found[name].low < 1.0 < found[name].high


#: Scale of gyro z, what accelerometer z sees of x (rad): true errors of the unit.
SCALE, ACROSS = 0.012, -0.02


@pytest.fixture(scope="module")
def skewed() -> Levels:
    """A quiet unit with errors of scale and alignment, whose filter estimates them."""
    return replace(drive_of(10.0, SCALE, ACROSS), extras=CONSTANTS)


def test_constants_of_the_imu_are_estimated_with_the_factors(levels: Levels, skewed: Levels) -> None:
    assert levels.constants([1.0] * len(levels.names)) == ()
    true = [FACTOR if name.endswith("white") else 1.0 for name in skewed.names]
    found = {c.name: c for c in skewed.constants(true)}
    assert len(found) == 3 + 3 + 6
    for name, value in (("gyro_z.scale", SCALE), ("accel_z.from_x", ACROSS)):
        c = found[name]
        assert abs(c.value - value) < 4.0 * c.sigma and c.sigma < 0.5 * c.before
        assert abs(c.value) > 3.0 * c.sigma
    for c in found.values():
        assert c.before == pytest.approx(0.01 if c.name.endswith("scale") else 0.0175)


@pytest.mark.slow(reason="hours of flight or many realizations")
def test_noise_and_constants_are_tuned_together(skewed: Levels) -> None:
    """The innovations are likelier with the constants, which no factor can stand for, and the factors are the true ones."""
    found = estimated(skewed)
    together = {f.name: f for f in found.factors}
    alone = estimated(replace(skewed, extras=Extras()), at=found.log)
    for name in ("gyro slow", "accel slow", "fixes position", "fixes velocity"):
        assert together[name].low < 1.0 < together[name].high
    assert found.value > alone.value + 10.0


def test_the_search_finds_the_maximum_keeps_its_bound_and_survives_a_filter_that_diverges() -> None:
    z = np.random.default_rng(2).standard_normal((400, 2))
    true = np.array([2.5, -1.2])  # logarithms of the standard deviations of two components

    def run(x: np.ndarray) -> Innovations:
        if x[0] > 2.8:
            raise InputError("diverged")
        S = np.zeros((400, 2, 2))
        S[:, 0, 0], S[:, 1, 1] = np.exp(2.0 * x)
        return Innovations(np.arange(400.0), np.exp(true) * z, S)

    wanted = true + 0.5 * np.log(np.mean(z**2, axis=0))
    found = likeliest(run, np.zeros(2), 100.0)
    np.testing.assert_allclose(found.x, wanted, atol=5e-3)
    spread = np.sqrt(np.diag(uncertainty(run, found, 100.0)))
    assert np.all((spread > 0.95 / np.sqrt(800.0)) & (spread < 1.3 / np.sqrt(800.0)))  # a variance of 400 draws
    bound = likeliest(run, np.zeros(2), 100.0, np.array([-np.inf, 0.0]))
    np.testing.assert_allclose(bound.x, [wanted[0], 0.0], atol=5e-3)
    assert likeliest(run, np.zeros(2), 0.02).x[0] == pytest.approx(1.37, abs=0.05)  # a narrow prior holds it back
    with pytest.raises(InputError, match="diverged"):
        likeliest(run, np.array([3.0, 0.0]), 100.0)


@pytest.mark.slow(reason="hours of flight or many realizations")
def test_outages_prefer_the_transferred_model(levels: Levels) -> None:
    by = {j.name: j for j in judge(levels)}
    assert by["transferred"].gain[0] > by["transferred"].gain[1] > 0.0
    assert by["transferred"].score > by["by hand"].score
    assert by["static"].inside < 0.6 < by["transferred"].inside
    assert by["static"].gain == (0.0, 0.0)


def test_a_static_model_without_turn_on_bias_gets_one(levels: Levels) -> None:
    for axis in AXES:
        assert sum(isinstance(p, RC) for p in levels.beliefs[axis]) == 1
    own = Levels(levels.imu, levels.gnss, levels.start, levels.beliefs, levels.lever_arm)
    assert own.beliefs == levels.beliefs


@pytest.mark.parametrize(
    ("value", "low", "high", "asks"),
    [
        (3.0, 2.0, 4.0, True),
        (0.3, 0.2, 0.5, True),
        (1.2, 1.1, 1.3, False),
        (1.8, 0.9, 3.6, False),
        (9.0, 2.0, 40.0, False),
    ],
)
def test_reasons_are_looked_for_where_a_factor_is_not_1(value: float, low: float, high: float, asks: bool) -> None:
    assert Factor("gyro white", value, low, high).asks is asks


def test_thinned_fixes_are_that_far_apart(levels: Levels) -> None:
    assert np.diff(levels.thinned(5.0).gnss.t).min() >= 5.0 - 1e-3
    assert len(levels.thinned(0.0).gnss) == len(levels.gnss)


def test_a_missing_axis_is_named(levels: Levels) -> None:
    beliefs = {a: m for a, m in levels.beliefs.items() if a != "gyro_y"}
    with pytest.raises(InputError, match="no noise model of gyro_y"):
        Levels(levels.imu, levels.gnss, levels.start, beliefs, levels.lever_arm)


def test_spans_without_fixes_are_refused(levels: Levels) -> None:
    with pytest.raises(InputError, match="no fix in the spans"):
        estimated(levels, [(1e6, 2e6)])


def test_what_is_known_is_taken_off_and_the_static_models_are_carried(monkeypatch: pytest.MonkeyPatch) -> None:
    s = stage(3, 2.0, 50.0)
    offset = EffectUse("imu_gnss_time_offset", "imu", {"offset": (0.205,)})
    seen = []

    class SeenError(Exception):
        """Enough is known."""

    def fitted(levels: Levels, *_: object) -> None:
        seen.append(levels)
        raise SeenError

    monkeypatch.setattr(session, "fitted", fitted)
    static = Nominal({a: NoiseModel((WN(1e-3), RC(1e-2))) for a in AXES})
    for given in ({}, {"known": replace(s.nominal, effects=(offset,))}):
        with pytest.raises(SeenError):
            transfer(s.record(), static, rng=np.random.default_rng(1), **given)
    alone, besides = seen
    assert alone.beliefs == besides.beliefs == static.beliefs
    # stamps that are a quarter of a sample off move the samples against the fixes
    assert (besides.imu.t[0] - alone.imu.t[0]) / alone.imu.dt % 0.5 == pytest.approx(0.25, abs=1e-6)


def test_known_lost_samples_are_filled_in() -> None:
    s = stage(3, 2.0, 50.0)
    made, last = s.record(), np.arange(len(s.record().imu))
    last[200::40] -= 1
    held = replace(made, imu=replace(made.imu, gyro=made.imu.gyro[last], accel=made.imu.accel[last]))
    lost = EffectUse("dropped_samples", "imu", {"probability": (0.025,), "burst": (1.0,)})
    as_recorded, filled = (levels_of(held, replace(s.nominal, effects=e)).imu for e in ((), (lost,)))
    assert as_recorded.repeated().sum() > 100 and filled.repeated().sum() == 0


def test_outages_that_end_at_no_position_are_refused(levels: Levels, monkeypatch: pytest.MonkeyPatch) -> None:
    n = len(levels.names)
    monkeypatch.setattr(judged, "fitted", lambda *_: (Estimate(levels.names, np.zeros(n), np.eye(n), 0.0), 0.0))
    nowhere = replace(levels, gnss=replace(levels.gnss, llh=np.full_like(levels.gnss.llh, np.nan)))
    with pytest.raises(InputError, match="no outage ends at a position"):
        judge(nowhere)


def test_a_log_at_rest_is_refused(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    log, models = tmp_path / "log.csv", tmp_path / "models.yaml"
    rows = np.column_stack([np.arange(400) * 0.01, rng.standard_normal((400, 6)) * 1e-3 + [0, 0, 0, 0, 0, -9.81]])
    header = "t [s]," + ",".join(f"{a} [{'rad/s' if a.startswith('gyro') else 'm/s^2'}]" for a in AXES)
    np.savetxt(log, rows, delimiter=",", header=header, comments="")
    save({a: NoiseModel((WN(1e-3),)) for a in AXES}, models)
    result = CliRunner().invoke(app, ["transfer", str(models), str(log)])
    assert isinstance(result.exception, InputError)
    assert "is a log at rest" in str(result.exception)


def test_factors_and_intervals_are_those_of_their_logarithms() -> None:
    """Log factors within 0.2 and 0.05: the factors' 95 % are exp(1.96 times that) on both sides."""
    found = Estimate(("gyro white", "fixes position"), np.log([3.0, 0.5]), np.diag([0.04, 0.0025]), 0.0).factors
    z = stats.norm.isf(0.025)
    for factor, value, sd in zip(found, (3.0, 0.5), (0.2, 0.05), strict=True):
        assert factor.value == pytest.approx(value)
        assert np.log([factor.high / value, value / factor.low]) == pytest.approx(sd * z, rel=1e-4)


def test_a_belief_is_judged_by_what_it_gains_and_what_its_ellipsoid_holds() -> None:
    """Four outages: mean and standard error of what is gained, root mean square, and the share inside 95 % of three degrees of freedom (7.81)."""
    static = np.array([[-4.0, 9.0, 3.0], [-5.0, 1.0, 4.0], [-3.0, 8.0, 12.0], [-6.0, 7.0, 0.0]])
    own = static + np.array([[1.0, -1.5, 0.0], [2.0, 0.0, 0.0], [3.0, 0.0, 1.0], [4.0, 0.0, 0.0]])
    got = judged._judged("transferred", own, static)
    assert got.score == pytest.approx(own[:, 0].mean()) and got.outages == 4
    assert got.gain == pytest.approx((2.5, np.sqrt(5.0 / 3.0) / 2.0))
    assert got.inside == pytest.approx(0.75)
    assert got.metres == pytest.approx(np.sqrt((9.0 + 16.0 + 169.0) / 4.0))
