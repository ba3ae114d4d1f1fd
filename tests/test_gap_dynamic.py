"""The gap of a drive or flight: signatures against the whole filter, evidence against dense algebra, naming end to end."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import butter, group_delay, lfilter, sosfilt

from benchmarks.trial.run import Job
from insemu import earth
from insemu.effects import EFFECTS, Column, EffectUse, FixGeometry, Motion, catalogue_columns, effect_of
from insemu.emulate import built_in, corrupt, gnss_fixes, ideal_imu
from insemu.errors import InputError
from insemu.filters import FilterOptions, FilterResult, InitialSigma, run_filter
from insemu.gap import Nominal, find_gap
from insemu.gap.candidates import AxisState
from insemu.gap.candidates.shapes import Variant, bank, best_pair, linear_hypotheses
from insemu.gap.candidates.spectral import vibration_line
from insemu.gap.candidates.tones import wandering, without_tones
from insemu.gap.data.counts import lattice
from insemu.gap.data.log import Reduced, moving_spectrum
from insemu.gap.data.samples import advanced, coarse, repair, unclipped, without_motion
from insemu.gap.drive.preparation import COVARIANCE_S, Flown, fast_parts, starting_state
from insemu.gap.drive.scene import Scene
from insemu.gap.drive.signatures import Loop, columns_response, knot_response, ramps
from insemu.gap.evidence.climb import laplace_many
from insemu.gap.evidence.linear import (
    ROWS_AT_ONCE,
    Field,
    gauss_markov_root,
    marginal,
    quadratic_evidence,
    random_walk_root,
)
from insemu.gap.evidence.merged import between_fixes, merged_states
from insemu.gap.evidence.model import Explanation, Likelihood, fit
from insemu.gap.evidence.modes import Free, laplace
from insemu.gap.evidence.rolloff import Rolloff
from insemu.gap.evidence.surrogate import Colour, FixNoise, Surrogate
from insemu.gap.hypothesis import Found, best_first, class_of
from insemu.gap.policy import Policy, rules
from insemu.gap.problems.band import fast_effects
from insemu.gap.problems.findings import unknown_part
from insemu.gap.problems.search_result import rivals_of
from insemu.gap.verdict import Finding, Value
from insemu.lost import filled, width_at_rest
from insemu.noise import RW, WN, NoiseModel
from insemu.records import AXES, GnssRecord, ImuRecord, Recording, Trajectory
from insemu.scenario import Gnss, Initial
from insemu.work import processes

Array = NDArray[np.float64]
BELIEF = {a: NoiseModel((WN(1e-4), RW(1e-6)) if a.startswith("gyro") else (WN(1e-3), RW(1e-5))) for a in AXES}
LEVER = (0.5, 0.1, -1.0)
DURATION = 240.0


@functools.cache
def ideal() -> tuple[ImuRecord, Trajectory]:
    made = ideal_imu(built_in("lemniscate"), 100.0, span=(0.0, DURATION))
    return made.imu, made.reference


def recording(*effects: EffectUse, seed: int = 3, kind: str = "increment") -> Recording:
    imu, reference = ideal()
    if kind == "mean":
        imu = replace(imu, gyro=imu.gyro / imu.dt, accel=imu.accel / imu.dt, kind="mean")
    one, two = np.random.default_rng(seed).spawn(2)
    temperature = 25.0 + 10.0 * np.sin(imu.t / DURATION * 5.0)
    made = corrupt(imu, BELIEF, one, effects=effects, reference=reference, temperature=temperature).imu
    fixes = gnss_fixes(reference, 1.0, (0.05, 0.05, 0.1), (0.05, 0.05, 0.05), LEVER, rng=two, effects=effects)
    return Recording(made, fixes, reference)


def flown(r: Recording, every: int = 1) -> FilterResult:
    assert r.gnss is not None
    assert r.reference is not None
    sigma = InitialSigma(0.1, 0.05, (0.005, 0.005, 0.01))
    return run_filter(
        r.imu,
        r.gnss,
        r.reference,
        sigma,
        BELIEF,
        lever_arm=LEVER,
        options=FilterOptions(store="fixes", node_every=10.0, covariance_every=every),
    )


def use(**mapping: object) -> EffectUse:
    return EffectUse.from_mapping(mapping)


@functools.cache
def nominal_run(kind: str = "increment") -> tuple[FilterResult, Motion, Loop]:
    r = recording(kind=kind)
    result = flown(r)
    return result, Motion.of(r.imu, result.nav, result.nodes.epoch), Loop.of(result)


#: The number that this flight shows best, where that is not the last.
SHOWN = {"misalignment": "value_yx", "temperature_misalignment": "value_yx"}
#: Seen elsewhere: this flight is level (tests/test_effects_velocity_filter.py), a filtered position has several columns
#: (tests/test_effects_position_filter.py); a drift runs with the stamps, and an expression has an equation (below).
ELSEWHERE = ("gnss_velocity_filter", "gnss_position_filter", "clock_drift", "expression")
#: One number of every effect with columns, on every sensor: effect, sensor, label.
SIGNATURES = [
    (e.id, sensor, label)
    for e in EFFECTS.values()
    for sensor in e.sensors
    if e.does("columns") and e.id not in ELSEWHERE
    for label in [SHOWN.get(e.id) or e.parameter(e.size or e.parameters[0].name).labels(e.axes)[-1]]
]
#: Datasheet's scales that are tried: a time offset well above what the noise of the samples that it moves past each other does.
SHARE = {"imu_gnss_time_offset": 20.0}


@pytest.mark.parametrize(("name", "sensor", "label"), SIGNATURES)
def test_a_signature_is_the_finite_difference_of_the_whole_filter(name: str, sensor: str, label: str) -> None:
    effect = effect_of(name)
    parameter = effect.parameter(label.partition("_")[0])
    value = effect.scale(parameter.name, sensor) * SHARE.get(name, 1.0)
    numbers = tuple(value if own == label else 0.0 for own in parameter.labels(effect.axes))
    (column,) = (c for c in catalogue() if (c.effect, c.sensor, c.label) == (name, sensor, label))
    held_against_the_filter(column, EffectUse(name, sensor, {parameter.name: numbers}), value)


@pytest.mark.parametrize(
    ("sensor", "equation"),
    [
        ("gyro", "z = rate_z * force_z"),
        ("accel", "x = speed ** 2"),
        ("accel", "y = rate_z * force_x"),
        ("gnss", "east = speed * cos(heading)"),
    ],
)
def test_the_signature_of_an_equation_is_the_finite_difference_too(sensor: str, equation: str) -> None:
    (column,) = (c for c in catalogue() if (c.effect, c.sensor, c.axes) == ("expression", sensor, (equation,)))
    held_against_the_filter(column, EffectUse("expression", sensor, {"value": (column.scale,)}, equation), column.scale)


def catalogue() -> list[Column]:
    result, motion, _ = nominal_run()
    return catalogue_columns(motion, FixGeometry.of(motion, result.fixes.t, LEVER))


def held_against_the_filter(column: Column, effect: EffectUse, value: float) -> None:
    result, motion, loop = nominal_run()
    G = columns_response(loop, motion, [column])
    changed = flown(recording(effect))
    difference = np.einsum(
        "kij,kj->ki", loop.white, np.nan_to_num(changed.fixes.innovation - result.fixes.innovation)
    ).ravel()
    predicted = loop.whiten(G)[:, 0] * value
    assert np.corrcoef(difference, predicted)[0, 1] > 0.998
    assert (difference @ predicted) / (predicted @ predicted) == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize("kind", ["increment", "mean"])
def test_the_signature_of_a_clock_that_drifts_is_the_finite_difference_too(kind: str) -> None:
    result, motion, loop = nominal_run(kind)
    columns = effect_of("clock_drift").columns(motion, FixGeometry.of(motion, result.fixes.t, LEVER))
    predicted = (loop.whiten(columns_response(loop, motion, columns))[:, 0] * 2e-4).reshape(-1, 6)
    changed = flown(recording(use(effect="clock_drift", drift=2e-4), kind=kind))
    _, here, there = np.intersect1d(result.fixes.t, changed.fixes.t, return_indices=True)
    assert here.size > 200
    moved = np.nan_to_num(changed.fixes.innovation[there] - result.fixes.innovation[here])
    difference = np.einsum("kij,kj->ki", loop.white[here], moved).ravel()
    expected = predicted[here].ravel()
    # fixes now fall between stamps: the way back to their time takes the noise of one sample along, which the signature does not know
    assert np.corrcoef(difference, expected)[0, 1] > 0.99
    assert (difference @ expected) / (expected @ expected) == pytest.approx(1.0, abs=0.01)


def test_knots_of_a_constant_are_the_constant() -> None:
    _, motion, loop = nominal_run()
    columns = effect_of("turn_on_bias").columns(motion, FixGeometry.of(motion, loop.result.fixes.t, LEVER))
    G, ramp = columns_response(loop, motion, columns), ramps(loop, motion)
    knots = np.linspace(motion.t[0], motion.t[-1], 7)
    for axis in range(6):
        np.testing.assert_allclose(
            knot_response(loop, motion, ramp, knots, axis).sum(axis=2),
            G[:, :, axis],
            rtol=1e-9,
            atol=1e-9 * np.abs(G[:, :, axis]).max(),
        )


def test_surrogate_with_the_nominal_noise_is_the_nominal_likelihood() -> None:
    result, _, loop = nominal_run()
    expected = -0.5 * float(loop.y @ loop.y)
    for k in range(len(result.fixes)):
        expected -= 0.5 * float(np.linalg.slogdet(result.fixes.S[k])[1])
    s = Surrogate.of(result)
    # the noise of the gyros on the lever arm correlates the components of a velocity fix by a thousandth; the surrogate leaves that out
    assert s.log_likelihood() == pytest.approx(expected, abs=0.05)
    assert s.log_likelihood(np.full(6, 3.0)) < s.log_likelihood() - 50.0


def test_two_fixes_of_one_epoch_have_the_noise_that_is_stated() -> None:
    """Velocities that were moved against the positions by less than a sample: the second one meets a filter that had the first."""
    r, apart = recording(), 1e-6
    assert r.gnss is not None and r.gnss.vel_ned is not None
    n = len(r.gnss)
    none = np.full((n, 3), np.nan)
    llh, velocity = np.stack([none, r.gnss.llh], axis=1), np.stack([r.gnss.vel_ned, none], axis=1)
    t = np.stack([r.gnss.t - apart, r.gnss.t], axis=1).ravel()
    std = np.tile([0.05, 0.05, 0.1], (2 * n, 1)), np.tile([0.05, 0.05, 0.05], (2 * n, 1))
    fixes = GnssRecord(t, llh.reshape(-1, 3), velocity.reshape(-1, 3), *std)
    s = Surrogate.of(flown(replace(r, gnss=fixes)))
    position, speed = s.use[:, 0] == 1, s.use[:, 3] == 1
    assert position[1::2].all() and s.use.sum() == 3 * len(s.t) and speed.sum() + position.sum() == len(s.t)
    # the gyros' noise on the lever arm adds a thousandth, as above
    np.testing.assert_allclose(np.sqrt(s.R[position, :3]), std[0][: position.sum()], rtol=1e-3)
    np.testing.assert_allclose(np.sqrt(s.R[speed, 3:]), std[1][: speed.sum()], rtol=1e-3)


def test_many_noises_at_once_are_each_as_it_is_alone() -> None:
    s, rng = Surrogate.of(nominal_run()[0]), np.random.default_rng(4)
    # a receiver whose stated standard deviations change from fix to fix
    s = replace(s, R=s.R * rng.uniform(0.3, 3.0, s.R.shape), stated=np.ones((0, 6)))
    noises = [
        FixNoise(
            rng.uniform(0.5, 2.0, 6),
            Colour(
                rng.uniform(0.0, 0.5, 6) * (np.arange(6) < k % 4), float(rng.uniform(2.0, 60.0)), follows=k % 3 == 0
            ),
        )
        for k in range(11)
    ]
    alone = [s.whiten(s.nu[:, :, None], n.factor, n.colour)[1] for n in noises]
    np.testing.assert_allclose(s.log_likelihoods(noises), alone, rtol=1e-11)


def test_states_of_which_only_the_sum_shows_are_one() -> None:
    Phi = np.tile(np.eye(13), (4, 1, 1))
    Phi[:, 0, 9:12], Phi[:, 3, 9:11] = 0.3, -0.2
    Phi[:, 12, 12] = 0.9
    sums = merged_states(Phi, np.zeros((2, 6, 13)))
    assert [list(np.flatnonzero(row)) for row in sums[9:]] == [[9, 10], [11], [12]]
    kept = sums.argmax(axis=1)
    np.testing.assert_allclose(sums @ Phi, (sums @ Phi[:, :, kept]) @ sums, atol=1e-15)  # at most two terms of order 1


def test_climbs_side_by_side_end_where_each_alone_does() -> None:
    free = [(Free("a", 0.05, 8.0),), (Free("a", 0.1, 30.0), Free("b", 1.0, 300.0))]

    def top(k: int, x: Array) -> float:  # a variance and its estimate, as a level of the noise has it
        z = x - np.array([0.4, 2.0])[: x.size]
        return float(-200.0 * np.sum(2.0 * z + np.exp(-2.0 * z)) - 30.0 * np.prod(z) * (x.size - 1))

    starts = [np.array([-1.5]), np.array([1.5, 0.5])]
    together = laplace_many(lambda points: np.array([top(k, x) for k, x in points]), starts, free, 1e-6)
    for k, mode in enumerate(together):
        alone = laplace(
            lambda x, k=k: top(k, x) + sum(f.log_density(v) for f, v in zip(free[k], x, strict=True)),
            starts[k],
            free[k],
        )
        np.testing.assert_allclose(mode.x, alone.x, atol=1e-3)
        np.testing.assert_allclose(mode.covariance, alone.covariance, rtol=0.02, atol=1e-6)
        assert mode.evidence == pytest.approx(alone.evidence, abs=0.01)


def test_a_climb_far_behind_one_of_its_kind_ends_early() -> None:
    free, starts = [(Free("a", 0.01, 100.0),)] * 2, [np.array([1.5]), np.array([1.5])]

    def climbed(kinds: tuple[str, str]) -> tuple[int, float]:
        """How often the lower hill is looked at, and the top of the higher one."""
        looked = [0, 0]

        def likelihoods(points: Sequence[tuple[int, Array]]) -> Array:
            for k, _ in points:
                looked[k] += 1
            return np.array([-1000.0 * k - 200.0 * float(x[0] + 0.5 * math.exp(-2.0 * x[0])) for k, x in points])

        higher, _ = laplace_many(likelihoods, starts, free, 1e-6, kinds)
        return looked[1], float(higher.x[0])

    (all_the_way, top), (given_up, same) = climbed(("a", "b")), climbed(("a", "a"))
    assert given_up < all_the_way and same == top


def test_transitions_from_fix_to_fix_are_products_of_those_between_nodes() -> None:
    rng, n = np.random.default_rng(7), 12
    Phi = np.eye(n) + 0.1 * rng.standard_normal((6, n, n))
    Phi[:, 9:, :9] = 0.0
    Phi[:, 9:, 9:] = np.eye(3)
    Phi[:, :, 11] = Phi[:, :, 9]
    Phi[:, 11, 11], Phi[:, 9, 11] = 1.0, 0.0
    roots = rng.standard_normal((2, 6, n, n))
    after, extra = (r @ r.transpose(0, 2, 1) for r in roots)
    before = np.concatenate([after[:1], Phi[1:] @ after[:-1] @ Phi[1:].transpose(0, 2, 1) + extra[1:]])
    sums = merged_states(Phi[1:], np.zeros((3, 6, n)))
    assert [list(np.flatnonzero(row)) for row in sums[9:]] == [[9, 11], [10]]
    first = sums.argmax(axis=1)
    at = np.array([1, 1, 4, 5])
    moved, driven = between_fixes(Phi, before, after, at, sums.argmax(axis=0), first)
    own = [sums @ p[:, first] for p in Phi]
    noise = [sums @ q @ sums.T for q in extra]
    np.testing.assert_allclose(moved[[0, 3]], [own[1], own[5]], rtol=1e-12)
    np.testing.assert_array_equal(moved[1], np.eye(11))
    np.testing.assert_array_equal(driven[1], 0.0)
    np.testing.assert_allclose(moved[2], own[4] @ own[3] @ own[2], rtol=1e-12, atol=1e-12)
    carried = own[3] @ noise[2] @ own[3].T + noise[3]
    np.testing.assert_allclose(driven[2], own[4] @ carried @ own[4].T + noise[4], rtol=1e-9, atol=1e-9)


def test_log_factor_is_the_ratio_of_dense_gaussians() -> None:
    rng = np.random.default_rng(1)
    G, y = rng.standard_normal((40, 5)), rng.standard_normal(40)
    data = Field(y, G)
    root = rng.standard_normal((3, 2))
    other = np.diag([0.3, 2.0])
    C = np.eye(40) + G[:, :3] @ root @ root.T @ G[:, :3].T + G[:, 3:] @ other @ other.T @ G[:, 3:].T
    expected = -0.5 * np.linalg.slogdet(C)[1] - 0.5 * y @ np.linalg.solve(C, y) + 0.5 * y @ y
    got = data.log_factor([(np.arange(3), root), (np.array([3, 4]), other)])
    assert got == pytest.approx(expected, rel=1e-10)


def test_quadratic_evidence_and_conditioning_are_the_same_algebra() -> None:
    rng = np.random.default_rng(2)
    G, y = rng.standard_normal((50, 7)), rng.standard_normal(50)
    data = Field(y, G, 1.1)
    given = [(np.array([0, 1]), rng.standard_normal((2, 2)))]
    index, root = np.array([3, 4, 6]), rng.standard_normal((3, 3))
    A, b = data.conditioned(given)
    got = quadratic_evidence(A[np.ix_(index, index)], b[index], root, np.array([0.5, 2.0]))
    for k, amplitude in enumerate((0.5, 2.0)):
        expected = data.log_factor([*given, (index, root * amplitude)]) - data.log_factor(given)
        assert got[k, 0] == pytest.approx(expected, rel=1e-9)


def test_what_is_integrated_out_leaves_the_posterior_of_the_rest() -> None:
    rng = np.random.default_rng(4)
    data = Field(rng.standard_normal(60), rng.standard_normal((60, 8)), 1.3)
    given = [(np.array([0, 1, 5]), rng.standard_normal((3, 2)))]
    block = (np.array([3, 4, 6]), rng.standard_normal((3, 3)))
    mean, covariance = marginal(*data.conditioned(given), block)
    _, every, scatter = data.posterior([block, *given])
    np.testing.assert_allclose(mean, every[:3], rtol=1e-9)
    np.testing.assert_allclose(covariance, scatter[:3, :3], rtol=1e-9)


def test_longer_steps_of_the_covariance_move_the_innovations_by_a_thousandth() -> None:
    r = recording()
    fine, coarse = (Loop.of(flown(r, every)).y for every in (1, round(COVARIANCE_S / r.imu.dt)))
    assert 0.0 < np.sqrt(np.mean((coarse - fine) ** 2)) < 1e-3


def test_axes_that_explain_alike_are_a_class() -> None:
    """Seen of a quadrotor and a walker of another simulator: the wrong one of two axes half a nat apart, with a confidence of 1.000."""
    gnss = Gnss(position_sigma=(0.05, 0.05, 0.1), velocity_sigma=(0.05, 0.05, 0.05), lever_arm=LEVER)
    scene = Scene.of(Flown.of(recording(), Nominal(dict(BELIEF), gnss)).prepared)
    x, y, z = (
        next(k for k, c in enumerate(scene.columns) if (c.effect, c.sensor, c.label) == ("scale_factor", "gyro", name))
        for name in ("value_x", "value_y", "value_z")
    )
    G = scene.data.G.copy()
    G[:, y] = G[:, x]
    rng = np.random.default_rng(7)
    size = 8.0 * G[:, x] / np.linalg.norm(G[:, x])
    for columns, places in (((x, y), {("x",), ("y",)}), ((z,), {("z",)})):
        signal = size if z not in columns else 8.0 * G[:, z] / np.linalg.norm(G[:, z])
        data = Field(rng.standard_normal(G.shape[0]) + signal, G)
        ranked = best_first(linear_hypotheses(scene, bank(scene), data, (), ()))
        assert (ranked[0].effect, ranked[0].sensor) == ("scale_factor", "gyro")
        members, _, confidence = class_of(*rivals_of(Found(ranked[0], tuple(ranked))))
        own = [m for m in members if (m.effect, m.sensor) == ("scale_factor", "gyro")]
        assert {m.axes for m in own} == places
        # together they are as likely as the effect is
        assert np.logaddexp.reduce([m.nats for m in own]) == pytest.approx(ranked[0].nats)
        assert confidence <= 1.0 / len(places)


@pytest.mark.parametrize("known", [False, True])
def test_a_field_with_more_columns_is_the_field_of_all(known: bool) -> None:
    rng = np.random.default_rng(5)
    y, G = rng.standard_normal(30), rng.standard_normal((30, 6))
    part, whole = Field(y, G[:, :4], 0.9), Field(y, G, 0.9)
    if known:
        assert part.A.shape == (4, 4)
    wide = part.wider(G[:, 4:])
    assert ("A" in wide.__dict__) == known
    np.testing.assert_allclose(wide.A, whole.A, rtol=1e-12)
    np.testing.assert_allclose(wide.b, whole.b, rtol=1e-12)


@pytest.mark.parametrize("rows", [40, 3 * ROWS_AT_ONCE + 7])
def test_predictive_residuals_have_the_likelihood_of_the_dense_model(rows: int) -> None:
    rng = np.random.default_rng(3)
    G, y, root = rng.standard_normal((rows, 3)), rng.standard_normal(rows), rng.standard_normal((3, 2))
    data = Field(y, G)
    e, logdet = data.residual([(np.arange(3), root)])
    C = np.eye(rows) + G @ root @ root.T @ G.T
    # each from those before it only: the whitening of the dense covariance in order of time
    np.testing.assert_allclose(e, np.linalg.solve(np.linalg.cholesky(C), y), rtol=1e-9)
    assert 0.5 * float(e @ e) + logdet == pytest.approx(
        0.5 * float(y @ np.linalg.solve(C, y)) + 0.5 * np.linalg.slogdet(C)[1]
    )
    late = np.arange(rows) >= 25
    part, log_late = data.predictive([(np.arange(3), root)], late)
    early = Field(y[:25], G[:25])
    total = early.log_factor([(np.arange(3), root)]) - 0.5 * float(early.y @ early.y)
    assert -0.5 * float(part @ part) - log_late == pytest.approx(
        data.log_factor([(np.arange(3), root)]) - 0.5 * float(y @ y) - total
    )


def test_a_coloured_fix_noise_whitens_what_it_made() -> None:
    result, _, _ = nominal_run()
    s = Surrogate.of(result)
    colour = Colour(np.array([0.2, 0.2, 0.3, 0.0, 0.0, 0.0]), 20.0)
    made = recording(use(effect="gnss_correlated_noise", sigma=[0.2, 0.2, 0.3], tau=20.0))
    changed = Surrogate.of(flown(made))
    white, value = changed.whiten(changed.nu[:, :, None], None, colour)
    z = white[:, :, 0][changed.use == 1]
    assert float(np.mean(z * z)) == pytest.approx(1.0, abs=4.0 * math.sqrt(2.0 / z.size))
    assert value > changed.log_likelihood() + 20.0
    assert s.log_likelihood(None, colour) < s.log_likelihood() - 20.0


def test_gaps_are_bridged_and_clipped_stretches_filled_in() -> None:
    t = np.arange(4000) * 0.01
    clean = np.column_stack([np.sin(t), 2.0 * np.sin(0.7 * t), np.cos(t)])
    noisy = clean + 1e-3 * np.random.default_rng(1).standard_normal(clean.shape)
    keep = np.ones(t.size, dtype=bool)
    keep[[500, 1200, 1201, 3000]] = False
    for kind, width in (("mean", 1.0), ("increment", 0.01)):
        imu = ImuRecord(t[keep], np.clip(noisy, -1.9, 1.9)[keep] * width, noisy[keep] * width, kind)  # type: ignore[arg-type]
        mended = repair(imu)
        named = {s.effect: s for s in mended.findings}
        assert set(named) == {"dropped_samples", "saturation"}
        assert (named["saturation"].sensor, named["saturation"].axes) == ("gyro", ("y",))
        assert named["saturation"].parameters[0].value == pytest.approx(1.9)
        assert named["dropped_samples"].parameters[1].value == pytest.approx(4.0 / 3.0)
        np.testing.assert_allclose(mended.imu.t, t, atol=1e-9)
        np.testing.assert_allclose(mended.imu.accel / width, noisy, atol=6e-3)
        before = np.abs(np.clip(clean, -1.9, 1.9) - clean).max()
        assert np.abs(mended.imu.gyro / width - clean).max() < 0.4 * before
    assert not repair(ImuRecord(t, noisy, noisy, "mean")).findings


def shaken(n: int, seed: int) -> NDArray[np.float64]:
    """Signals (n, 3) that turn slowly and shake at 20 Hz, white noise far below, at 100 Hz."""
    rng = np.random.default_rng(seed)
    t = np.arange(n) * 0.01
    shaking = np.stack([np.convolve(rng.standard_normal(n + 8), np.cos(0.4 * np.pi * np.arange(9)), "valid")] * 3)
    return np.asarray(np.sin(t)[:, None] + 0.1 * shaking.T + 1e-3 * rng.standard_normal((n, 3)))


@pytest.mark.parametrize("how", ["stamps that skip", "rows that repeat"])
def test_the_integral_over_lost_samples_is_known_as_well_as_is_said(how: str) -> None:
    n, dt = 40_000, 0.01
    signal, t, rng = shaken(n, 3), np.arange(n) * dt, np.random.default_rng(4)
    gone = np.zeros(n, dtype=bool)
    for k in range(100, n - 100, 150):
        gone[k : k + rng.integers(1, 3)] = True
    if how == "stamps that skip":
        imu = ImuRecord(t[~gone], signal[~gone] * dt, signal[~gone] * dt, "increment")
    else:
        last = np.maximum.accumulate(np.where(gone, 0, np.arange(n)))
        imu = ImuRecord(t, signal[last] * dt, signal[last] * dt, "increment")
    mended = repair(imu)
    (finding,) = mended.findings
    assert finding.effect == "dropped_samples" and finding.nats > 1000.0
    assert finding.parameters[0].low < 1.0 / 150.0 < finding.parameters[0].high
    np.testing.assert_allclose(mended.imu.gyro[~gone], signal[~gone] * dt, rtol=1e-12)
    # so many are white noise: errors of the angle over the time
    off = (mended.imu.gyro - signal * dt)[:, 0]
    over = np.add.reduceat(off, np.flatnonzero(np.diff(gone.astype(int)) == 1) + 1)
    assert mended.filled == ()
    # of a belief that holds their noise none is added
    before = repair(imu, filled=("dropped_samples",))
    assert before.findings == mended.findings and not before.loss.any() and not before.filled
    np.testing.assert_array_equal(before.imu.gyro, mended.imu.gyro)
    assert mended.loss[0] == pytest.approx(float(np.sum(over**2)) / t[-1], rel=0.3)
    # far more than the noise of the sensor, and what a sample of the vibration weighs
    assert mended.loss[0] > 30.0 * 1e-3**2 * dt


def test_few_lost_samples_are_carried_one_by_one() -> None:
    n, dt = 4_000, 0.01
    signal, t = shaken(n, 5), np.arange(n) * dt
    gone = np.zeros(n, dtype=bool)
    gone[[500, 1200, 1201, 3000]] = True
    mended = repair(ImuRecord(t[~gone], signal[~gone], signal[~gone], "mean"))
    assert len(mended.filled) == 18 and not mended.loss.any()
    assert {(round(f.start, 9), round(f.end, 9)) for f in mended.filled} == {(4.99, 5.0), (11.99, 12.01), (29.99, 30.0)}
    assert all(0.0 < f.sigma < 0.05 for f in mended.filled)


def test_a_row_that_holds_the_whole_gap_leaves_nothing_open() -> None:
    n, dt = 4_000, 0.01
    signal, t = (5.0 + shaken(n, 6)) * dt, np.arange(n) * dt
    total = np.cumsum(signal, axis=0)
    keep = np.ones(n, dtype=bool)
    keep[[500, 1200, 1201, 3000]] = False
    whole = np.diff(total[keep], axis=0, prepend=0.0)
    mended = repair(ImuRecord(t[keep], whole, whole, "increment"))
    assert mended.filled == () and not mended.loss.any()
    np.testing.assert_allclose(np.cumsum(mended.imu.gyro, axis=0)[keep], total[keep], atol=1e-12)


def test_rows_that_repeat_by_themselves_are_not_lost() -> None:
    rng, t = np.random.default_rng(7), np.arange(4_000) * 0.01
    # six axes of counts repeat together in 3 of 1000 rows
    gyro, accel = np.round(0.7 * rng.standard_normal((2, t.size, 3)))
    imu = ImuRecord(t, gyro, accel, "mean")
    assert imu.repeated().sum() > 3
    assert "dropped_samples" not in {s.effect for s in repair(imu).findings}
    still = np.zeros((t.size, 3))
    assert not repair(ImuRecord(t, still, still, "mean")).filled


def test_the_integral_of_a_clipped_stretch_is_known_as_well_as_is_said() -> None:
    rng, dt = np.random.default_rng(8), 0.02
    t = np.arange(30_000) * dt
    shape = butter(2, 1.5, fs=1.0 / dt, output="sos")
    signal = sosfilt(shape, rng.standard_normal(t.size))
    signal /= signal.std()
    noisy = signal + 0.01 * rng.standard_normal(t.size)
    clipped = np.clip(noisy, -2.2, 2.2)
    out, stretches = unclipped(t, clipped, np.abs(noisy) >= 2.2)
    assert len(stretches) > 40
    z, before, after = [], [], []
    for start, end, sigma in stretches:
        inside = (t > start + 0.5 * dt) & (t < end + 0.5 * dt)
        error = float(np.sum((out - signal)[inside])) * dt
        z.append(error / sigma)
        after.append(error)
        before.append(float(np.sum((clipped - signal)[inside])) * dt)
    assert 0.3 < float(np.std(z)) < 1.7
    assert float(np.std(after)) < 0.4 * float(np.std(before))
    np.testing.assert_array_equal(out[np.abs(noisy) < 2.2], noisy[np.abs(noisy) < 2.2])


def test_output_counts_are_seen_beside_lost_samples() -> None:
    rng, dt = np.random.default_rng(9), 0.01
    t = np.arange(4000) * dt
    kept = rng.random(t.size) > 0.004
    values = np.outer(np.sin(t) * t / t[-1], np.ones(3)) + 1e-2 * rng.standard_normal((t.size, 3))
    values[:, 1] = np.round(values[:, 1] / 0.02) * 0.02
    for kind, width in (("mean", 1.0), ("increment", dt)):
        mended = repair(ImuRecord(t[kept], values[kept] * width, values[kept, ::-1] * width, kind))  # type: ignore[arg-type]
        found = {(s.effect, s.sensor): s for s in mended.findings}
        assert set(found) == {("dropped_samples", "imu"), ("quantization", "gyro"), ("quantization", "accel")}
        assert found["quantization", "gyro"].axes == ("y",)
        assert found["quantization", "gyro"].parameters[0].value == pytest.approx(0.02)


def test_counts_are_a_lattice_while_values_repeat_and_noise_is_none() -> None:
    rng = np.random.default_rng(11)
    noise = rng.standard_normal(20_000)
    moving = 40.0 * np.sin(0.01 * np.arange(noise.size)) + 0.03 * noise
    counts = np.round(moving / 0.015) * 0.015
    assert np.unique(counts).size > 0.2 * counts.size
    assert lattice(counts) == pytest.approx(0.015)
    for values in (noise, moving, moving.astype(np.float32).astype(float), np.cumsum(noise)):
        assert lattice(values) == 0.0


def test_two_shapes_that_cancel_are_found_together() -> None:
    rng = np.random.default_rng(12)
    G = rng.standard_normal((400, 6))
    G[:, 4] = G[:, 1] + 0.2 * G[:, 4]
    scale = np.array([1.0, 0.5, 2.0, 1.0, 0.3, 1.0])
    y = rng.standard_normal(400) + 3.0 * G[:, 1] - 3.0 * G[:, 4]
    data = Field(y, G)
    variants = [
        Variant("e", "imu", (), "", np.array([k]), (((), np.array([[scale[k]]])),), np.ones(1)) for k in range(6)
    ]
    gain, first, second = best_pair(variants, data.A, data.b)
    assert {int(first[0][0]), int(second[0][0])} == {1, 4}
    # the pooled evidence is a mean over the grid that holds the best
    assert data.log_factor([first, second]) - math.log(25.0) < gain < data.log_factor([first, second])
    assert max(data.log_factor([(v.index, 10.0 * v.shapes[0][1])]) for v in variants) < gain - 20.0


def test_a_line_of_a_moving_sensor_is_steady_and_a_loud_stretch_is_none() -> None:
    rng, dt, n = np.random.default_rng(10), 0.02, 18_000
    t = np.arange(n) * dt
    noise = rng.standard_normal(n)
    line = 12.0 / math.sqrt(n) * np.sin(2.0 * np.pi * 17.3 * t)
    hum = np.where((t > 100.0) & (t < 110.0), 6.0, 1.0) * noise

    def gain(values: Array) -> float:
        data = axis_part("gyro_x", values, dt)
        state = AxisState(data, fit(Likelihood(data), Explanation.nominal(NoiseModel((WN(math.sqrt(dt)),)))))
        return max((w.nats for w in vibration_line(state)), default=-math.inf)

    assert gain(noise + line) > 10.0
    assert gain(noise) < 3.0
    assert gain(hum) < 3.0


def test_samples_are_lost_from_stamps_of_a_millisecond_too() -> None:
    rng = np.random.default_rng(21)
    t = np.arange(4000) * 0.010003
    signal = np.sin(t)[:, None] + 1e-3 * rng.standard_normal((t.size, 3))
    keep = rng.random(t.size) > 0.01
    keep[[0, -1]] = True
    (step,) = repair(ImuRecord(np.round(t, 3)[keep], signal[keep], signal[keep], "sample")).findings
    assert step.effect == "dropped_samples"
    assert step.parameters[0].low < 0.01 < step.parameters[0].high
    assert not repair(ImuRecord(np.round(t, 3), signal, signal, "sample")).findings


def test_motion_does_not_reach_the_band_above_it() -> None:
    rng, dt = np.random.default_rng(4), 0.01
    t = np.arange(60_000) * dt
    noise = rng.standard_normal(t.size)
    moving = noise + 3e4 * np.sin(0.3 * t) + 1e4 * np.sin(2.0 * np.pi * 0.5 * t)
    left = without_motion(moving, dt, 4.8)
    same = without_motion(noise, dt, 4.8)
    assert left.size == same.size
    np.testing.assert_allclose(left, same, atol=5e-3)  # of forty thousand


def test_several_tones_are_a_vehicle_and_one_is_a_sensor() -> None:
    rng, dt = np.random.default_rng(5), 0.01
    t = np.arange(60_000) * dt
    noise = without_motion(rng.standard_normal(t.size), dt, 4.8)
    one = 0.2 * np.sin(2.0 * np.pi * 20.3 * t[: noise.size])
    belief = NoiseModel((WN(0.1),))
    for signal, kept in ((one, True), (one + 0.15 * np.sin(2.0 * np.pi * 22.1 * t[: noise.size]), False)):
        f, power, dof = moving_spectrum(noise + signal, dt, 8.0)
        data = Reduced("gyro_x", "rad/s", dt, noise + signal, 1, np.zeros(0), f, power, dof)
        out = without_tones(data, Explanation.nominal(belief))
        assert (out is data) == kept


def test_a_strong_band_is_no_tones() -> None:
    rng, dt = np.random.default_rng(15), 0.01
    band = lfilter([1.0], [1.0, -2.0 * 0.9 * math.cos(2.0 * math.pi * 23.0 * dt), 0.81], rng.standard_normal(60_000))
    data = axis_part("gyro_x", rng.standard_normal(60_000) + 10.0 * band, dt)
    assert without_tones(data, Explanation.nominal(NoiseModel((WN(0.1),)))) is data


def searched(name: str, values: Array, dt: float, model: NoiseModel) -> dict[str, dict[str, float]]:
    """What the band above the motion of one axis is said to hold."""
    parts = {name: axis_part(name, values, dt)}
    ((_, result),) = fast_effects(parts, Nominal({name: model}), 10.0, (), lambda _: None)
    return {f.chosen.effect: {v.name: v.value for v in f.chosen.values} for f in result.found}


def test_a_low_pass_is_found_where_it_leaves_next_to_nothing() -> None:
    rng, dt = np.random.default_rng(16), 0.01
    values = lfilter(*butter(2, 0.32), 1e-2 * rng.standard_normal(72_000))  # the power falls to 1e-8 at the last bin
    found = searched("accel_x", values, dt, NoiseModel((WN(0.9e-3), RW(1e-4))))
    assert set(found) == {"decimation_filter"}
    assert found["decimation_filter"]["cutoff"] == pytest.approx(16.0, rel=0.03)
    assert found["decimation_filter"]["order"] == pytest.approx(2.0, abs=0.05)


def test_outliers_of_a_moving_sensor_keep_their_share_and_size() -> None:
    rng, dt = np.random.default_rng(17), 0.01
    wild = np.where(rng.random(72_000) < 0.002, 1.5 * rng.standard_normal(72_000), 0.0)
    values = 3.0 * np.sin(0.5 * np.arange(72_000) * dt) + 1e-2 * rng.standard_normal(72_000) + wild
    found = searched("accel_y", values, dt, NoiseModel((WN(1e-3),)))
    assert set(found) == {"outliers"}
    assert found["outliers"]["probability"] == pytest.approx(0.002, rel=0.2)
    assert found["outliers"]["sigma"] == pytest.approx(1.5, rel=0.2)


def test_stamps_that_jitter_do_not_smear_increments() -> None:
    rng, dt = np.random.default_rng(18), 0.01
    t = np.arange(6000) * dt
    signal = np.column_stack([np.sin(t), np.cos(t), np.round(np.sin(1.3 * t) / 0.02) * 0.02])
    gyro = np.clip(signal + [1e-3, 1e-3, 0.0] * rng.standard_normal(signal.shape), -0.96, 0.96)
    accel = [0.0, 0.0, -9.8] + 1e-3 * rng.standard_normal(signal.shape)
    jittered = t + rng.uniform(-2e-5, 2e-5, t.size)
    named = {(s.effect, s.axes) for s in repair(ImuRecord(jittered, gyro * dt, accel * dt, "increment")).findings}
    assert named == {("saturation", ("x",)), ("saturation", ("y",)), ("saturation", ("z",)), ("quantization", ("z",))}
    part = fast_parts(Recording(ImuRecord(jittered, gyro * dt, accel * dt, "increment"), None, None), Nominal({}))[
        "accel_z"
    ]
    assert np.std(part.values) == pytest.approx(1e-3, rel=0.1)


def test_coarse_counts_say_nothing_about_the_noise() -> None:
    step = Finding("quantization", "samples", "gyro", ("y",), (Value("lsb", 0.01, 0.01, 0.01, "rad/s"),), 1.0, 1.0, ())
    beliefs = {a: NoiseModel((WN(1e-4),)) for a in AXES}  # 1 mrad/s per sample
    assert coarse(beliefs, (step,), 0.01) == {"gyro_y"}
    assert not coarse(beliefs | {"gyro_y": NoiseModel((WN(1e-3),))}, (step,), 0.01)


def test_counts_of_one_sensor_say_nothing_about_those_of_another() -> None:
    lsb = tuple(Value(f"lsb_{a}", 0.01, 0.01, 0.01, "rad/s") for a in "xy")
    step = Finding("quantization", "samples", "gyro", ("x", "y"), lsb, 1.0, 1.0, ())
    assert unknown_part(step, (use(effect="quantization", sensor="accel", lsb=[0.01, 0.01, 0.01]),)) is step
    left = unknown_part(step, (use(effect="quantization", sensor="gyro", lsb=[0.01, 0, 0]),))
    assert left is not None
    assert (left.axes, [v.name for v in left.parameters]) == (("y",), ["lsb_y"])
    assert unknown_part(step, (use(effect="quantization", sensor="gyro", lsb=[0.01, 0.01, 0]),)) is None


def axis_part(name: str, values: Array, dt: float) -> Reduced:
    values = without_motion(values, dt, 4.8)
    return Reduced(name, "rad/s", dt, values, 1, np.zeros(0), *moving_spectrum(values, dt, 8.0))


def test_a_tone_that_wanders_on_one_axis_is_seen_and_hum_lines_and_bands_are_not() -> None:
    rng, dt = np.random.default_rng(6), 0.02
    t = np.arange(18_000) * dt
    noise = {name: rng.standard_normal(t.size) for name in AXES}
    sweep = np.sin(2.0 * np.pi * (10.0 * t + 0.5 * 10.0 / t[-1] * t**2))
    line = np.sin(2.0 * np.pi * 15.0 * t)
    band = butter(2, [14.5, 15.5], "bandpass", fs=1.0 / dt, output="sos")
    shaking = sosfilt(band, 8.0 * rng.standard_normal(t.size))

    def seen(**added: Array) -> dict[str, tuple[float, float]]:
        return wandering({name: axis_part(name, noise[name] + added.get(name, 0.0), dt) for name in AXES})

    found = seen(gyro_y=sweep)
    assert list(found) == ["gyro_y"]
    low, high = found["gyro_y"]
    assert abs(low - 10.0) < 1.0
    assert abs(high - 20.0) < 1.0
    assert not seen()
    assert not seen(gyro_y=line)
    assert not seen(gyro_y=shaking)
    assert not seen(gyro_y=sweep, accel_x=0.8 * sweep, accel_z=1.5 * sweep)


def test_the_delay_of_a_low_pass_is_that_of_its_filter() -> None:
    dt = 0.01
    for order, corner in ((1, 8.0), (2, 12.0), (4, 30.0)):
        _, late = group_delay(butter(order, corner * 2.0 * dt), w=[1e-3])
        assert Rolloff("butterworth", (corner, float(order)), ()).delay(dt) == pytest.approx(late[0] * dt, rel=1e-3)
    _, late = group_delay((np.full(7, 1.0 / 7.0), 1.0), w=[1e-3])
    assert Rolloff("moving average", (1.0 / (7 * dt),), ()).delay(dt) == pytest.approx(late[0] * dt, rel=1e-6)


@pytest.mark.parametrize("kind", ["increment", "mean"])
def test_a_sensor_is_set_forward_by_a_delay(kind: str) -> None:
    dt, by = 0.01, 0.0137
    t = np.arange(1, 2001) * dt
    # means over the interval before each stamp
    wave = np.column_stack([np.sin(a * t) for a in (1.0, 4.0, 9.0)])
    later = np.column_stack([np.sin(a * (t + by)) for a in (1.0, 4.0, 9.0)])
    width = dt if kind == "increment" else 1.0
    imu = ImuRecord(t, wave * width, wave * width, kind)
    out = advanced(imu, "gyro", by)
    np.testing.assert_allclose(out.gyro[5:-5], later[5:-5] * width, atol=1e-5 * width)
    np.testing.assert_array_equal(out.accel, imu.accel)


def test_roots_have_the_covariance_of_their_process() -> None:
    t = np.array([0.0, 10.0, 30.0, 60.0])
    R = random_walk_root(t)
    np.testing.assert_allclose(R @ R.T, np.minimum(t[:, None], t[None, :]))
    M = gauss_markov_root(t, 20.0)
    np.testing.assert_allclose(M @ M.T, np.exp(-np.abs(t[:, None] - t[None, :]) / 20.0), atol=1e-8)


def believed(rng: np.random.Generator) -> Nominal:
    wrong = {
        a: NoiseModel(
            tuple(p.with_parameters({n: v * rng.uniform(0.85, 1.17) for n, v in p.parameters.items()}) for p in m)
        )
        for a, m in BELIEF.items()
    }
    gnss = Gnss(position_sigma=(0.05, 0.05, 0.1), velocity_sigma=(0.05,) * 3, lever_arm=LEVER)
    return Nominal(
        wrong,
        gnss,
        Initial(position_sigma=(0.1,) * 3, velocity_sigma=(0.05,) * 3, tilt_sigma=0.005, heading_sigma=0.01),
    )


def test_a_nominal_flight_lacks_nothing() -> None:
    report = find_gap(recording(seed=4), believed(np.random.default_rng(4)), rng=np.random.default_rng(1))
    assert report.verdict == "nothing missing", report.findings
    assert report.gap_before.low < 1.0 < report.gap_before.high


def test_an_axis_that_hardly_moves_does_not_explain_the_noise_that_it_makes() -> None:
    _, motion, _ = nominal_run()
    imu, _ = ideal()
    noise = 1e-4 / math.sqrt(imu.dt)
    assert np.std(motion.rate[:, 0] - imu.gyro[:, 0] / imu.dt) < 0.2 * noise
    assert np.std(motion.rate[:, 2] - imu.gyro[:, 2] / imu.dt) < 0.3 * noise


@pytest.mark.slow(reason="a whole search of a drive or a log, whose parts have quick tests")
def test_a_wrong_lever_arm_is_named_and_the_gap_closes() -> None:
    report = find_gap(
        recording(use(effect="lever_arm", value=[0.3, 0, 0]), seed=5),
        believed(np.random.default_rng(5)),
        rng=np.random.default_rng(1),
    )
    assert report.findings[0].effect == "lever_arm"
    assert report.findings[0].sensor == "gnss"
    x = next(p for p in report.findings[0].parameters if p.name == "value_x")
    assert x.low < 0.3 < x.high
    assert report.held_out.value > 0.05
    assert abs(report.gap_after.value - 1.0) < abs(report.gap_before.value - 1.0)
    assert math.isfinite(report.to_json()["gap_index"]["after"]["value"])


@pytest.mark.slow(reason="a whole search of a drive, whose parts have quick tests")
def test_held_out_figures_of_another_process_are_the_same() -> None:
    """Under a policy of the caller's, too, which another process does not know by itself."""
    made, nominal = recording(use(effect="lever_arm", value=[0.3, 0, 0]), seed=5), believed(np.random.default_rng(5))
    half = replace(rules(), naming_share=0.5)

    def looked(pool: Executor | None, policy: Policy | None) -> dict[str, Any]:
        rng = np.random.default_rng(1)
        return find_gap(made, nominal, rng=rng, pictures=False, policy=policy, pool=pool).to_json()

    here = looked(None, half)
    with processes(2) as pool:
        assert pool is not None and pool.submit(abs, -1).result() == 1  # begun before the policy is in force
        assert looked(pool, half) == here
    assert looked(None, None)["held_out"] != here["held_out"]


@pytest.mark.slow(reason="a whole search of a drive or a log, whose parts have quick tests")
def test_a_steep_slope_is_no_random_walk() -> None:
    r = recording(seed=6)
    sloped = r.imu.accel + np.outer(r.imu.t - r.imu.t[0], [0.0, 2e-4, 0.0]) * r.imu.dt  # 200 times the datasheet's
    report = find_gap(
        replace(r, imu=replace(r.imu, accel=sloped)),
        believed(np.random.default_rng(6)),
        rng=np.random.default_rng(1),
        hold_out=False,
    )
    step = report.findings[0]
    assert (step.effect, step.sensor, step.axes) == ("ramp", "accel", ("y",))
    assert step.parameters[0].value == pytest.approx(2e-4, rel=0.1)


def test_a_filter_starts_on_positions_alone() -> None:
    r = recording(seed=7)
    assert r.gnss is not None
    assert r.reference is not None
    nominal = believed(np.random.default_rng(7))
    _, _, state, sigma = starting_state(Recording(r.imu, replace(r.gnss, vel_ned=None, vel_std_ned=None)), nominal)
    imu, _, best, _ = starting_state(Recording(r.imu, r.gnss), nominal)
    at = int(np.searchsorted(r.reference.t, imu.t[0]))
    assert np.all(np.abs(state.vel_ned - best.vel_ned) < 5.0 * np.asarray(sigma.velocity) + 0.5)
    off = (state.rpy - r.reference.rpy[at] + np.pi) % (2.0 * np.pi) - np.pi
    assert np.all(np.abs(off) < 4.0 * np.asarray(sigma.attitude))


def test_an_imu_upside_down_against_its_reference_is_said() -> None:
    """Forward, left, up beside the attitudes of a reference ended in a covariance that was not positive definite."""
    r, nominal = recording(seed=7), believed(np.random.default_rng(7))
    signs = np.array([1.0, -1.0, -1.0])
    turned = replace(r, imu=replace(r.imu, gyro=r.imu.gyro * signs, accel=r.imu.accel * signs))
    with pytest.raises(InputError, match=r"points down in the attitudes of the reference, expected up.*axes=FLU"):
        starting_state(turned, nominal)
    starting_state(replace(turned, reference=None), nominal)  # mounted so, for all that is known
    pushed = np.where(r.imu.t[:, None] < r.imu.t[0] + 3.0, -r.imu.accel, r.imu.accel)
    starting_state(replace(r, imu=replace(r.imu, accel=pushed)), nominal)  # an aeroplane that pushes over at the start


def test_a_drive_does_not_start_at_a_position_that_is_far_from_its_neighbours() -> None:
    r = recording(seed=7)
    assert r.gnss is not None and r.reference is not None
    nominal = believed(np.random.default_rng(7))
    first = starting_state(replace(r, reference=None), nominal)[0].t[0]
    at = int(np.searchsorted(r.gnss.t, first - 1e-6))
    off = earth.move(r.gnss.llh[at], np.array([50.0, 0.0, 0.0]))
    llh = np.where((np.arange(len(r.gnss)) == at)[:, None], off, r.gnss.llh)
    imu, _, state, sigma = starting_state(replace(r, gnss=replace(r.gnss, llh=llh), reference=None), nominal)
    k = int(np.searchsorted(r.reference.t, imu.t[0]))
    away = earth.position_difference(state.llh[None], r.reference.llh[k][None])[0]
    assert (np.abs(away) < 4.0 * np.asarray(sigma.position)).all() and np.abs(away).max() < 5.0


@pytest.mark.slow(reason="a whole search of a drive, whose parts have quick tests")
@pytest.mark.parametrize(
    "reference", [True, pytest.param(False, marks=pytest.mark.slow(reason="another case of a quick test"))]
)
def test_errors_of_a_turned_sensor_are_named_in_its_own_axes_and_the_lever_arm_in_the_body(reference: bool) -> None:
    turned = use(effect="mounting", rpy=["100 deg", "-60 deg", "160 deg"])
    misaligned = use(effect="misalignment", sensor="gyro", value=[0, 0, 0, -0.01, 0, 0])  # y errs with z
    r = recording(turned, misaligned, use(effect="lever_arm", value=[0, 0.4, 0]), seed=9)
    nominal = replace(believed(np.random.default_rng(9)), effects=(turned,))
    if not reference:
        r = replace(r, reference=None)
    report = find_gap(r, nominal, rng=np.random.default_rng(1), hold_out=False)
    found = {(s.effect, s.sensor, s.axes): s.parameters[0].value for s in report.findings}
    assert set(found) == {("misalignment", "gyro", ("y",)), ("lever_arm", "gnss", ("y",))}
    assert found["misalignment", "gyro", ("y",)] == pytest.approx(-0.01, rel=0.15)
    assert found["lever_arm", "gnss", ("y",)] == pytest.approx(0.4, rel=0.15)


def test_a_recording_that_cannot_be_started_says_why() -> None:
    r = recording()
    assert r.gnss is not None
    still = GnssRecord(r.gnss.t, r.gnss.llh, np.zeros((len(r.gnss), 3)), r.gnss.pos_std_ned, r.gnss.vel_std_ned)
    with pytest.raises(InputError, match="does not move enough to tell the heading"):
        find_gap(Recording(r.imu, still), believed(np.random.default_rng(1)), rng=np.random.default_rng(1))
    with pytest.raises(InputError, match="no noise model is believed for accel_x"):
        find_gap(r, Nominal({a: BELIEF[a] for a in AXES[:3]}), rng=np.random.default_rng(1))


@pytest.mark.slow(reason="a whole search of a drive or a log, whose parts have quick tests")
def test_a_large_quadratic_accelerometer_is_an_equation() -> None:
    # larger than any datasheet says: with a bounded prior it was called an asymmetry, alone and surely
    trial = Job("dynamic", (), 60.0, 5004, "quadratic_accelerometer", minutes=6.0).run()
    assert trial.track == "aeroplane"
    assert [(s.effect, s.axes) for s in trial.steps] == [("expression", ("y = force_y ** 2",))]


def with_thermal_scale(sensor: str, value: float) -> Finding:
    """What is found first where a scale factor of axis z follows the temperature."""
    hidden = use(effect="temperature_scale_factor", sensor=sensor, value=value, axes="z")
    return find_gap(
        recording(hidden, seed=7), believed(np.random.default_rng(7)), rng=np.random.default_rng(1), hold_out=False
    ).findings[0]


@pytest.mark.slow(reason="a whole search of a drive or a log, whose parts have quick tests")
def test_a_scale_factor_that_follows_the_temperature_is_named() -> None:
    first = with_thermal_scale("gyro", 5e-4)
    assert (first.effect, first.sensor, first.axes) == ("temperature_scale_factor", "gyro", ("z",))
    own = next(p for p in first.parameters if p.name == "value_z")
    assert own.low < 5e-4 < own.high


@pytest.mark.slow(reason="a whole search of a drive or a log, whose parts have quick tests")
def test_of_a_level_vehicle_the_thermal_bias_of_the_vertical_is_said_first() -> None:
    first = with_thermal_scale("accel", 5e-5)
    assert [(m.effect, m.sensor, m.axes) for m in first.members][:2] == [
        ("temperature", "accel", ("z",)),
        ("temperature_scale_factor", "accel", ("z",)),
    ]


@pytest.mark.parametrize(("width", "motion"), [(8.0, True), (width_at_rest(0.01), False)])
def test_lost_samples_are_as_noisy_as_the_others(width: float, motion: bool) -> None:
    """In motion a thousand times the noise, and in noise with a memory; interpolated ones would have half of its variance."""
    rng, n = np.random.default_rng(4), 20_000
    t = np.arange(n) * 0.01
    sigma = 1e-3
    noise = sigma * lfilter([1.0], [1.0, 0.0 if motion else -0.6], rng.standard_normal((n, 1)), axis=0)
    truth = noise + (np.sin(9.0 * t)[:, None] if motion else 0.0)
    missing = rng.random(n) < (0.01 if motion else 0.15)
    missing[[0, -1]] = False
    missing[9000:9030] = True  # longer than what is looked at on either side
    out = filled(truth[~missing], missing, width, rng)
    np.testing.assert_array_equal(out[~missing], truth[~missing])
    missing[8990:9040] = False
    third = np.diff(out - truth + noise, 3, axis=0)[:, 0]
    touched = np.convolve(missing, np.ones(4), "valid") > 0
    assert np.var(third[touched]) / np.var(np.diff(noise, 3, axis=0)) == pytest.approx(1.0, abs=0.25)


@pytest.mark.parametrize("rate", [1.0, 10.0, 100.0])
def test_white_noise_at_rest_is_filled_in_as_large_as_it_is(rate: float) -> None:
    rng = np.random.default_rng(5)
    noise, missing = rng.standard_normal((20_000, 3)), rng.random(20_000) < 0.03
    out = filled(noise[~missing], missing, width_at_rest(1.0 / rate), rng)
    # three standard errors of a standard deviation from 1,800 draws
    assert out[missing].std() == pytest.approx(1.0, abs=3.0 / np.sqrt(2.0 * 1800.0))
