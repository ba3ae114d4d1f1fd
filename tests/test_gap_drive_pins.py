"""What constants of the policy decide in a drive and in the final tests: a case on either side of each border, as in test_gap_policy_pins."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from insemu import earth
from insemu.effects import having
from insemu.errors import InputError
from insemu.gap import session
from insemu.gap.beliefs.nominal import Nominal
from insemu.gap.candidates import robust, shapes, steps
from insemu.gap.candidates.axis import state_of
from insemu.gap.candidates.shapes import Change
from insemu.gap.candidates.unexplained import Unexplained
from insemu.gap.checks import drive as drive_checks
from insemu.gap.data.log import Reduced, reduce
from insemu.gap.drive import shaking
from insemu.gap.drive.preparation import starting_state
from insemu.gap.evidence import fixes
from insemu.gap.evidence.linear import Field
from insemu.gap.evidence.model import Explanation
from insemu.gap.hypothesis import Found, Hypothesis, class_of
from insemu.gap.problems import band, drive, rest
from insemu.gap.problems import search_result as problem_named
from insemu.gap.problems.findings import VARYING, rejected, remainder
from insemu.gap.verdict import Finding, Member, Where
from insemu.noise import WN, NoiseModel
from insemu.records import AXES, GnssRecord, ImuRecord, Recording, Series

DT = 0.01
WHITE = NoiseModel((WN(DT**0.5),))  # of unit variance


# -- what is left over ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("p", "left"), [(0.0008, True), (0.0013, False)])
def test_a_model_is_left_unexplained_by_a_corrected_p_value_of_a_thousandth(p, left):
    assert (
        bool(remainder(rejected([Where("tails", "gyro", "x", 0.01, p), Where("mean", "gyro", "y", None, 0.3)]), {}))
        == left
    )


@pytest.mark.parametrize(("p", "varies"), [(0.8e-6, True), (1.3e-6, False)])
def test_a_spectrum_that_changes_beyond_doubt_ends_the_fast_search(p, varies, monkeypatch):
    log = Series(WHITE.simulate(12_000, DT, np.random.default_rng(3)), 1.0 / DT, "rad/s", "gyro_x")
    state = state_of(reduce(log), Explanation.nominal(WHITE))
    problem = rest.AxisProblem(state)
    monkeypatch.setattr(rest.checks, "drifting_spectrum", lambda _: p)
    line = Hypothesis("vibration_line", 40.0, (), state)
    problem.apply(Found(line, (line,)))
    assert (problem.outsider == VARYING) == varies


@pytest.mark.parametrize(("square", "passes"), [(1.235, True), (1.268, False)])
def test_a_nis_keeps_three_quarters_of_its_variance_at_the_least(square, passes, monkeypatch):
    """Levels that follow all of it: a mean square of 1.235 would fail if half were kept, one of 1.268 pass if five sixths were."""
    n = 200
    z = stats.norm.ppf((np.arange(n) + 0.5) / n)[np.random.default_rng(1).permutation(n)]
    y = np.full((n, 6), np.nan)
    y[:, 0] = z * math.sqrt(square / float(np.mean(z * z)))
    everything = (np.zeros((1, 6)) + 2.0 * n, np.array([[0.5 / n]]))
    monkeypatch.setattr(drive_checks, "trimmed_levels", lambda _: everything)
    scene = SimpleNamespace(
        prepared=SimpleNamespace(swings=False, result=SimpleNamespace(fixes=SimpleNamespace(t=np.arange(float(n))))),
        loop=SimpleNamespace(use=np.isfinite(y)),
    )
    told = {name: p for name, *_, p in drive_checks.innovation_tests(scene, y[:, 0])}
    assert (told["position innovation NIS"] > 0.004) == passes


# -- what is said at all, and what beside it --------------------------------------------------------------------------------------


@pytest.mark.parametrize(("nats", "said"), [(2.4, False), (3.6, True)])
def test_nothing_is_said_below_three_nats(nats, said):
    log = Series(WHITE.simulate(12_000, DT, np.random.default_rng(3)), 1.0 / DT, "rad/s", "gyro_x")
    state = state_of(reduce(log), Explanation.nominal(WHITE))
    line = Hypothesis("vibration_line", nats, (), state)
    assert (rest.AxisProblem(state).choose([line]) is not None) == said


def members(*nats: float) -> int:
    return len(class_of([Member(str(k), "gyro", (), g) for k, g in enumerate(nats)], 0)[0])


def test_what_is_less_than_three_nats_behind_is_of_the_class():
    assert (members(30.0, 27.6), members(30.0, 26.4)) == (2, 1)


def test_members_of_a_class_hold_96_percent_together():
    """After two of them 94.6 % are held, and the third is one; after 97.4 % a third that is as near is none."""
    assert (members(30.0, 29.5, 27.6), members(30.0, 29.8, 27.01)) == (3, 2)


@pytest.mark.parametrize(("nats", "taken"), [(3.5, False), (4.2, True)])
def test_a_search_ends_where_nothing_keeps_a_fifth(nats, taken):
    ranked = [Hypothesis("ramp", nats, (), Change()), *(Hypothesis(str(k), 0.0, (), Change()) for k in range(20))]
    problem = SimpleNamespace(
        scene=None, data=None, threshold=3.0, blocks=list, _hidden_pair=lambda _: None, _simpler=lambda best: best
    )
    assert (drive.DriveProblem.choose(problem, ranked) is not None) == taken


def test_sizes_of_shapes_reach_from_a_tenth_of_a_datasheet_to_thirty_a_hundred_and_a_thousand():
    """The sensors' own to 30, of an antenna or a stamp to 100, slopes to 1000."""
    scene = SimpleNamespace(
        knots=np.linspace(0.0, 200.0, 21), slow=lambda first, count=1: np.arange(first, first + count)
    )
    ramp = next(v for v in shapes._slow(scene) if v.effect == "ramp")
    tried = (shapes.sizes("scale_factor"), shapes.sizes("lever_arm"), ramp.amplitudes)
    assert [np.log10([x[0], x[-1]]) for x in tried] == [
        pytest.approx([-1.0, top], abs=0.1) for top in (math.log10(30.0), 2.0, 3.0)
    ]


def test_refinements_of_plainer_errors_are_these():
    assert having("second_order") == {
        "scale_asymmetry",
        "g2_sensitivity",
        "temperature_scale_factor",
        "temperature_misalignment",
        "gnss_velocity_lag",
        "gnss_velocity_filter",
        "gnss_position_filter",
    }


@pytest.mark.parametrize(("lead", "first"), [(1.1, "scale_factor"), (1.7, "scale_asymmetry")])
def test_the_plain_error_is_four_times_as_common_as_its_refinement(lead, first):
    def variant(effect: str) -> shapes.Variant:
        return shapes.Variant(effect, "accel", ("x",), "", np.array([0]), (((), np.eye(1)),), np.ones(1))

    tried = [variant("scale_factor"), variant("scale_asymmetry")]
    evidence = shapes.pooled_evidence(tried, [[np.array([[20.0]])], [np.array([[20.0 + lead]])]])
    assert max(evidence, key=lambda key: evidence[key][0])[0] == first


def northward(speed: float) -> Recording:
    """Two minutes straight to the north, with positions only: no change of velocity tells the heading, the course does."""
    t, fixes = np.arange(1.0, 12_001.0) * DT, np.arange(121.0)
    swaying = np.outer(
        0.02 * np.sin(2.0 * np.pi * t / 5.0), [1.0, 0.0, 0.0]
    )  # no rest for which constant speed is taken
    still = ImuRecord(t, swaying, np.tile([0.0, 0.0, -9.8], (t.size, 1)), "sample")
    path = earth.move(np.tile([0.8, 0.1, 100.0], (fixes.size, 1)), fixes[:, None] * np.array([speed, 0.0, 0.0]))
    return Recording(still, GnssRecord(fixes, path, None, np.full((fixes.size, 3), 0.02), None))


@pytest.mark.parametrize(("speed", "starts"), [(2.5, False), (3.6, True)])
def test_a_track_below_three_metres_a_second_tells_no_heading(speed, starts):
    believed = Nominal(dict.fromkeys(AXES, WHITE))
    if not starts:
        with pytest.raises(InputError, match=r"does not move enough to tell the heading.*a fix faster than 3 m/s"):
            starting_state(northward(speed), believed)
        return
    attitude = starting_state(northward(speed), believed)[3].attitude
    assert attitude[0] == pytest.approx(0.035, rel=0.25)
    assert attitude[2] == pytest.approx(0.09, rel=0.25)


# -- the search of a drive --------------------------------------------------------------------------------------------------------


def found(effect: str, nats: float, **change: object) -> Found[Change]:
    h = Hypothesis(effect, nats, (), Change(**change), "", "gyro", ("x",))
    return Found(h, (h,))


@pytest.mark.parametrize(("nats", "early"), [(33.0, False), (50.0, True)])
def test_noise_of_the_fixes_came_early_where_something_strong_follows(nats, early):
    block = (np.array([0]), np.eye(1))
    noise, shape = found("gnss_noise_level", 60.0), found("scale_factor", nats, block=block, columns=(0,))
    assert drive.DriveProblem.noise_came_early(SimpleNamespace(found=[noise, shape])) == early


@pytest.mark.parametrize(("nats", "idle"), [(1.6, True), (2.4, False)])
def test_an_effect_worth_less_than_two_nats_beside_the_others_is_idle(nats, idle, monkeypatch):
    old = found("ramp", 30.0, block=(np.array([0]), np.eye(1)))
    one = Hypothesis("ramp", nats, (), old.chosen.change, "", "gyro", ("x",))
    monkeypatch.setattr(drive, "linear_hypotheses", lambda *_: [one])
    # nothing is left that its score could go with
    monkeypatch.setattr(robust, "too_much", lambda *_: 0.0)
    problem = SimpleNamespace(
        scene=None,
        variants=(),
        data=None,
        threshold=3.0,
        blocks=lambda _: [],
        _skip=lambda _: set(),
        _compatible=lambda _: (),
        _unexplained=lambda _: None,
    )
    assert drive.DriveProblem.again(problem, old).idle == idle


@pytest.mark.parametrize(("nats", "more"), [(120.0, False), (180.0, True)])
def test_strong_effects_of_fixes_and_timing_together_ask_for_a_second_pass(nats, more):
    def finding(effect: str, sensor: str, worth: float) -> Finding:
        return Finding(effect, "", sensor, (), (), 1.0, worth, ())

    weak = [finding("lever_arm", "gnss", 0.6 * nats), finding("imu_gnss_time_offset", "imu", 0.4 * nats)]
    assert session._bends([*weak, finding("scale_factor", "gyro", 900.0)]) == more


@pytest.mark.parametrize(("share", "told"), [(0.08, False), (0.13, True)])
def test_a_rival_of_a_tenth_of_the_repetitions_is_told(share, told, monkeypatch):
    shares = {("scale_factor", "gyro"): 1.0, ("misalignment", "gyro"): share}
    repetitions = SimpleNamespace(of=lambda *_: SimpleNamespace(shares=lambda *_: shares))
    monkeypatch.setattr(problem_named, "Repetitions", repetitions)
    monkeypatch.setattr(problem_named, "bank", lambda _: [])
    f = found("scale_factor", 30.0, block=(np.array([0]), np.eye(1)), columns=(0,))
    data = SimpleNamespace(posterior=lambda _: (np.array([0]), np.ones(1), np.eye(1)))
    named = SimpleNamespace(scene=SimpleNamespace(data=data), found=(f,), blocks=[])
    finding = Finding("scale_factor", "", "gyro", ("x",), (), 1.0, 30.0, ())
    (out,) = problem_named.with_confusable([finding], named, (), np.random.default_rng(1))
    assert bool(out.confusable) == told


def test_slow_processes_are_tried_from_a_thousandth_to_three_thousand_of_a_datasheet():
    scene = SimpleNamespace(
        knots=np.linspace(0.0, 200.0, 21), slow=lambda first, count=1: np.arange(first, first + count)
    )
    walk = next(v for v in shapes._slow(scene) if v.effect == "random_walk" and len(v.axes) == 1)
    scale = shapes.EFFECTS["random_walk"].scale(shapes.PROCESSES["random_walk"], walk.sensor)
    assert np.log10(walk.amplitudes[[0, -1]] / scale) == pytest.approx([-3.0, math.log10(3000.0)], abs=0.1)


def test_a_slow_process_may_be_ten_times_more_or_less_above_the_motion(monkeypatch):
    asked = {}
    monkeypatch.setattr(band, "fast_effects", lambda *a: asked.update(a[5]) or [])
    walk = found("random_walk", 30.0)
    walk.chosen.__dict__["values"] = (SimpleNamespace(name="K", value=1e-4),)
    band.again_with_processes([("gyro_x", SimpleNamespace(found=(walk,)))], [walk], {"gyro_x": None}, None, 3.0, (), ())
    (component,) = asked["gyro_x"]
    assert (component.free[0].low, component.free[0].high) == pytest.approx((1e-5, 1e-3), rel=0.1)


# -- the fixes --------------------------------------------------------------------------------------------------------------------


def told_step(start: int, length: int, monkeypatch) -> list[float]:
    """Duration of the step that the scan tells in the position errors of 60 fixes, which no filter follows, of which `length` are off by 5 m."""
    t = np.arange(60.0)
    starts = t - 0.5
    G = np.kron((t[:, None] > starts[None, :]).astype(float), np.eye(3)) / 0.5  # noise of half a metre
    y = np.zeros((60, 3))
    y[start : start + length, 0] = 5.0 / 0.5
    monkeypatch.setattr(steps, "_axis_steps", lambda scene, s, c: G[:, c::3])
    scene = SimpleNamespace(
        noise=None, starts=starts, rows_t=np.repeat(t, 3), step_columns=G,
        whitened=lambda x: x, prepared=SimpleNamespace(result=SimpleNamespace(fixes=SimpleNamespace(t=t))),
    )  # fmt: skip
    found = steps.multipath_step(Unexplained(scene, Field(y.ravel(), G), slice(None), []))
    return [v.value for h in found for v in h.values if v.name == "duration"]


@pytest.mark.parametrize(("length", "step"), [(2, False), (3, True)])
def test_a_step_of_two_fixes_is_an_outlier(length, step, monkeypatch):
    assert (told_step(20, length, monkeypatch) == [pytest.approx(length)]) == step


@pytest.mark.parametrize(("length", "step"), [(33, True), (45, False)])
def test_a_step_lasts_for_six_tenths_of_the_fixes_at_most(length, step, monkeypatch):
    assert (told_step(8, length, monkeypatch) == [pytest.approx(length)]) == step


@pytest.mark.parametrize(("nats", "weighed"), [(12.0, False), (18.0, True)])
def test_a_step_beside_another_must_be_worth_15_nats(nats, weighed):
    def asked(*effects, known=()):
        found = [SimpleNamespace(chosen=SimpleNamespace(effect=e)) for e in effects]
        nominal = SimpleNamespace(effects=[SimpleNamespace(id=e) for e in known])
        scene = SimpleNamespace(original=SimpleNamespace(nominal=nominal))
        return nats > drive.DriveProblem._step_nats(SimpleNamespace(found=found, scene=scene))

    assert asked("lever_arm")
    assert asked("gnss_multipath_step") == asked(known=["gnss_multipath_step"]) == weighed


def level_evidence(truth: float, monkeypatch) -> float:
    """Evidence of a level of the positions whose likelihood has its top at ``truth``."""
    monkeypatch.setattr(fixes, "level_scores", lambda *_: (np.array([30.0]), np.array([[60.0]])))
    s = SimpleNamespace(
        use=np.ones((9, 6), bool),
        settled=np.ones(6),
        log_likelihoods=lambda noises: np.array([-600.0 * math.log(n.factor[0] / truth) ** 2 for n in noises]),
    )
    skip = ("gnss_velocity_noise", "gnss_correlated_noise")
    out = fixes.gnss_noise_fits(s, 0.0, np.eye(6), np.zeros(0), trimmed=np.ones(6), skip=skip)
    return next(f.nats for f in out if f.axes == fixes.NED)


@pytest.mark.parametrize(("level", "admitted"), [(7.0, True), (10.5, False), (0.06, True), (0.037, False)])
def test_receivers_state_from_an_eighth_to_twenty_times_their_scatter(level, admitted, monkeypatch):
    usual = level_evidence(1.5, monkeypatch)
    assert (level_evidence(level, monkeypatch) > usual - 0.1) == admitted


def test_slow_errors_of_fixes_are_from_a_tenth_to_thirty_times_what_is_stated():
    s = SimpleNamespace(sigma=lambda: np.ones(6), t=np.arange(100.0), stated_vary=lambda _: False)
    free = fixes._colours(s)[0][0].free
    assert (free[0].low, free[0].high) == pytest.approx((0.1, 30.0), rel=0.2)


# -- what the vehicle does above its motion -----------------------------------------------------------------------------------------

BINS = 40


def heard(name: str, values: np.ndarray, ratio: np.ndarray) -> Reduced:
    """A band from 8 to 48 Hz whose spectrum is so many times the believed one."""
    f = np.linspace(8.0, 47.0, BINS)
    dof = np.full(BINS, 60.0)
    return Reduced(name, "", DT, values, 1, np.zeros(0), f, ratio * WHITE.psd(f, DT), dof)


def excess(nats: float) -> float:
    """The ratio of a bin of 60 degrees of freedom that is worth so much beyond the tolerance of a level."""
    ratios = np.linspace(1.0, 8.0, 70_001)
    return 1.22**2 * float(np.interp(nats, 30.0 * (ratios - 1.0 - np.log(ratios)), ratios))


def without(loud: dict[str, np.ndarray], ratio: np.ndarray) -> set[str]:
    """The axes that are taken for the vehicle's motion."""
    axes = [f"{s}_{a}" for s in ("gyro", "accel") for a in "xyz"]
    noise = np.random.default_rng(5).standard_normal((6, 12_000))
    parts = {
        a: heard(a, x + loud.get(a, 0.0), ratio if a in loud else np.ones(BINS))
        for a, x in zip(axes, noise, strict=True)
    }
    out = shaking.without_shaking(parts, dict.fromkeys(axes, WHITE))
    return {a for a, data in out.items() if data.shaking is not None}


def peak(nats: float, bins: int = 8) -> np.ndarray:
    ratio = np.ones(BINS)
    ratio[20 : 20 + bins] = excess(nats)
    return ratio


def hum(seed: int) -> np.ndarray:
    z = np.fft.rfft(np.random.default_rng(seed).standard_normal(12_000))
    f = np.fft.rfftfreq(12_000, DT)
    x = np.fft.irfft(np.where((f > 28.0) & (f < 35.0), z, 0.0), 12_000)
    return np.asarray(2.0 * x / x.std())


@pytest.mark.parametrize(("nats", "shakes"), [(4.2, False), (6.2, True)])
def test_a_bin_beyond_doubt_exceeds_the_noise_by_five_nats(nats, shakes):
    shared = hum(1)
    both = without({"gyro_x": shared, "accel_z": shared}, peak(nats, 12))
    assert both == ({"gyro_x", "accel_z"} if shakes else set())


@pytest.mark.parametrize(("nats", "shakes"), [(24.0, False), (38.0, True)])
def test_an_axis_may_shake_from_thirty_nats_on(nats, shakes):
    shared = hum(1)
    both = without({"gyro_x": shared, "accel_z": shared}, peak(nats / 3.0, 3))
    assert both == ({"gyro_x", "accel_z"} if shakes else set())


@pytest.mark.parametrize(("count", "shakes"), [(3, False), (4, True)])
def test_four_axes_that_are_loud_at_once_are_the_vehicle(count, shakes):
    axes = ["gyro_x", "gyro_z", "accel_x", "accel_y"][:count]
    said = without({a: hum(10 + k) for k, a in enumerate(axes)}, peak(20.0))
    assert said == (set(axes) if shakes else set())


@pytest.mark.parametrize(("p", "together"), [(0.8e-6, True), (1.3e-6, False)])
def test_coherence_is_no_chance_below_one_in_a_million(p, together):
    count, lines = 60, 4
    squared = -math.expm1(-2.0 * stats.gamma.isf(p, 0.5 * lines) / (count - 1.0) / lines)
    a, b = np.zeros((count, lines), complex), np.zeros((count, lines), complex)
    a[0], b[0], b[1] = 1.0, math.sqrt(squared), math.sqrt(1.0 - squared)
    assert (shaking._coherence(a, b) > 0.0) == together


@pytest.mark.parametrize(("gathered", "tail"), [(4.2, False), (6.2, True)])
def test_a_tail_of_the_motion_gathers_five_standard_deviations(gathered, tail):
    ratio = np.ones(BINS)
    ratio[0] = 1.0 + (gathered + 0.5) / math.sqrt(30.0)
    assert (shaking._tail(heard("gyro_x", np.zeros(0), ratio), WHITE) == 1) == tail


@pytest.mark.parametrize(("gain", "swings"), [(8.0, False), (13.0, True)])
def test_a_swinging_antenna_must_explain_ten_nats(gain, swings, monkeypatch):
    n = 40
    still = np.zeros((4100, 3))
    imu = ImuRecord(np.arange(4100) * DT, still, still, "mean")
    k = 50 + 100 * np.arange(n)
    fix = SimpleNamespace(t=imu.t[k], innovation=np.zeros((n, 6)), epoch=k, S=np.tile(np.eye(6), (n, 1, 1)))
    nav = np.zeros((4100, 10))
    nav[:, 6] = 1.0
    scores = iter([0.0])
    monkeypatch.setattr(shaking, "_velocity_score", lambda *_: next(scores, gain))
    gnss = GnssRecord(imu.t[k], np.zeros((n, 3)), np.zeros((n, 3)), np.ones((n, 3)), np.ones((n, 3)))
    arm = np.array([0.5, 0.0, 0.0])
    out = shaking.steadied(imu, gnss, gnss, SimpleNamespace(fixes=fix, nav=nav), arm, arm)
    assert (out is not gnss) == swings


@pytest.mark.parametrize(("worth", "apart"), [(31.5, True), (30.5, False)])
def test_a_finding_of_three_axes_gives_way_to_simpler_ones_that_now_explain_more(worth, apart, monkeypatch):
    """Three axes of a bias that is worth 30 nats, against three effects that are worth more together beside everything else."""
    wide = found("turn_on_bias", 30.0, block=(np.array([0, 1, 2]), np.eye(3)))
    wide = replace(wide, chosen=replace(wide.chosen, axes=("x", "y", "z")))
    single = found("scale_factor", 20.0, block=(np.array([3]), np.eye(1))).chosen
    asked = []

    def greedy(_self, _variants, beside):
        asked.append(beside)
        return single, worth, 3

    monkeypatch.setattr(drive.DriveProblem, "_greedy", greedy)
    problem = object.__new__(drive.DriveProblem)
    problem.found, problem.variants = [wide], []
    assert problem.split() == apart
    assert problem.found[0].chosen is (single if apart else wide.chosen)
    assert asked[0] is wide  # weighed without itself
