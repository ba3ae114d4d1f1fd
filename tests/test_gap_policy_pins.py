"""What constants of the policy decide that the scoreboard does not show: a case on either side of each border, half of it and more away.

`python -m tests.policy_perturbation` runs these under moved constants; a constant whose border does not stand where a case here says fails one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from importlib import import_module
from types import SimpleNamespace

import numpy as np
import pytest

from insemu.errors import InputError
from insemu.gap.candidates import bias_steps, mounting, spectral, thermal, timing
from insemu.gap.candidates.axis import amplitudes, state_of
from insemu.gap.candidates.mounting import Sideways, _held_out, estimate, find_mounting
from insemu.gap.candidates.noise import gauss_markov
from insemu.gap.candidates.outliers import evident_outliers
from insemu.gap.candidates.tones import wandering
from insemu.gap.checks.rest import residual_variance
from insemu.gap.data.counts import lattice
from insemu.gap.data.log import moving_spectrum, reduce
from insemu.gap.data.samples import clipped, coarse, repair, spikes
from insemu.gap.data.sources import static_of
from insemu.gap.evidence.model import Explanation
from insemu.gap.evidence.modes import level
from insemu.gap.evidence.sandwich import excess
from insemu.gap.hypothesis import Found, Hypothesis
from insemu.gap.policy import Policy
from insemu.gap.problems import rest
from insemu.gap.problems.rest import is_slow
from insemu.gap.search import reconsider, search
from insemu.gap.threshold import certain, tail_of, threshold_of, usual_tail
from insemu.gap.verdict import Finding, Member, Value
from insemu.noise import WN, NoiseModel
from insemu.records import ImuRecord, Recording, Series

DT = 0.01
WHITE = NoiseModel((WN(1e-3),))


def imu_of(t, *, rng=None, kind="sample"):
    rng = np.random.default_rng(1) if rng is None else rng
    smooth = np.sin(2 * np.pi * 0.2 * np.asarray(t))[:, None]
    return ImuRecord(
        t, 0.1 * smooth + 0.01 * rng.standard_normal((len(t), 3)), smooth + 0.1 * rng.standard_normal((len(t), 3)), kind
    )


# -- stamps, lost and clipped samples, counts ------------------------------------------------------------------------------------


def named(imu) -> set[str]:
    return {f.effect for f in repair(imu, ("quantization",)).findings}


@pytest.mark.parametrize(("strays", "lost"), [(0.2, True), (0.3, False)])
def test_a_stamp_that_strays_says_nothing_of_lost_samples(strays, lost):
    t = np.delete(np.arange(4000.0), np.arange(50, 4000, 97)) * DT
    last = np.flatnonzero(np.diff(t) > 1.5 * DT)
    t[last] -= strays * DT  # the gap is longer by a share of the interval
    t[last - 1] -= strays * DT
    assert ("dropped_samples" in named(imu_of(t))) == lost


@pytest.mark.parametrize(("gap_s", "bridged"), [(0.42, True), (0.6, False)])
def test_a_longer_gap_is_an_outage_of_the_imu(gap_s, bridged):
    t = np.arange(6000) * DT
    t[3000:] += gap_s - DT
    assert ("dropped_samples" in named(imu_of(t))) == bridged


@pytest.mark.parametrize(("share", "read"), [(0.16, True), (0.25, False)])
def test_a_log_at_rest_misses_a_fifth_of_its_samples_at_most(share, read):
    k = np.arange(3000)
    # a rate that the digits of the stamps do not round
    t = np.cumsum(np.where(k % round(1 / share) == 0, 2, 1)) * 1.03 * DT
    if read:
        assert static_of(Recording(imu_of(t))).missing.sum() > 0.8 * share * t.size
    else:
        with pytest.raises(InputError, match="expected at most"):
            static_of(Recording(imu_of(t)))


@pytest.mark.parametrize(("count", "full_scale"), [(3, False), (5, True)])
def test_so_many_equal_extremes_make_a_full_scale(count, full_scale):
    x = np.random.default_rng(2).standard_normal(2000)
    order = np.argsort(x)
    x[order[-count:]] = x[order[-count]]
    assert (clipped(x) is not None) == full_scale


@pytest.mark.parametrize(("piled", "full_scale"), [(71, False), (82, True)])
def test_a_pile_of_counts_is_worth_twenty_nats(piled, full_scale):
    inner = np.repeat([7.0, 8.0, 9.0], [400, 16, 16])
    rest = np.random.default_rng(3).integers(-6, 7, 2000)
    x = np.random.default_rng(4).permutation(np.concatenate([inner, rest, np.full(piled, 10.0)]))
    assert (clipped(x, 1.0) is not None) == full_scale


@pytest.mark.parametrize(("values", "on"), [(0.7, True), (0.9, False)])
def test_values_that_hardly_repeat_lie_on_no_lattice(values, on):
    n = 1000
    x = np.arange(n, dtype=float)
    x[round(values * n) :] = x[: n - round(values * n)]
    assert (lattice(np.sort(x)) > 0.0) == on


@pytest.mark.parametrize(("lsb", "said"), [(0.035, False), (0.07, True)])
def test_counts_finer_than_a_twentieth_of_the_noise_are_digits_of_a_file(lsb, said):
    imu = imu_of(np.arange(40_000) * DT)
    rates = np.round(imu.gyro / (0.01 * lsb)) * 0.01 * lsb
    found = repair(replace(imu, gyro=rates)).findings
    assert ("gyro" in {f.sensor for f in found if f.effect == "quantization"}) == said


@pytest.mark.parametrize(("lsb", "is_coarse"), [(2.4, False), (3.6, True)])
def test_coarse_counts_are_three_standard_deviations(lsb, is_coarse):
    sd = 1e-3 / math.sqrt(DT)
    value = Value("lsb", lsb * sd, lsb * sd, lsb * sd, "rad/s")
    finding = Finding(
        "quantization", "samples", "gyro", ("x",), (value,), 1.0, 9.0, (Member("quantization", "gyro", ("x",), 9.0),)
    )
    assert bool(coarse({"gyro_x": WHITE}, [finding], DT)) == is_coarse


# -- outliers and tones of a moving sensor ----------------------------------------------------------------------------------------


def moving_state(values):
    data = reduce(Series(values, 1.0 / DT, "rad/s", "gyro_x"))
    f, power, dof = moving_spectrum(values, DT, 8.0)
    none = np.zeros(0)
    return state_of(replace(data, differences=none, f=f, power=power, dof=dof), Explanation.nominal(WHITE))


def noisy(n=20_000, seed=5):
    return 1e-2 * np.random.default_rng(seed).standard_normal(n)


@pytest.mark.parametrize(("sigma", "evident"), [(10.0, False), (18.0, True)])
def test_single_samples_that_stand_out_by_ten_sigma_are_evident(sigma, evident):
    x = noisy()
    x[500::1900] += sigma * 1e-2
    assert (evident_outliers(moving_state(x)) is not None) == evident


@pytest.mark.parametrize(("single", "outliers"), [(7, False), (10, True)])
def test_most_of_what_stands_out_must_be_single_samples(single, outliers):
    x = noisy()
    at = np.arange(500, 20_000, 1900)[:10]
    x[at[:single]] += 0.3
    for k, size in ((-1, 0.18), (0, 0.36), (1, 0.18)):  # a hump, not a sample
        x[at[single:] + k] += size
    assert (evident_outliers(moving_state(x)) is not None) == outliers


def test_beside_evident_ones_those_above_five_sigma_count():
    x = noisy()
    x[500::1900] += 0.3
    x[1000::1900] += 0.085  # 7 sigma of the residual against the neighbours
    x[1400::1900] += 0.04  # 3.3 sigma
    found = evident_outliers(moving_state(x))
    assert found is not None and abs(np.count_nonzero(found.change.data.values != x) - 22) <= 1


@pytest.mark.parametrize(("share", "outliers"), [(1 / 12, True), (1 / 7, False)])
def test_more_than_a_tenth_of_the_samples_are_no_outliers(share, outliers):
    x = noisy()
    x[500::1900] += 0.3
    x[:: round(1.0 / share)] += 0.4  # each shows in three residuals
    assert (evident_outliers(moving_state(x)) is not None) == outliers


TONE = {"seconds": 160.0, "height": 120.0, "share": 1.0, "way": 6.0, "jitter": 0.0, "other": 0.0}


@pytest.mark.parametrize(
    ("change", "wanders"),
    [
        ({}, True),
        ({"seconds": 68.0}, True), ({"seconds": 44.0}, False),  # twelve pieces of four seconds
        ({"height": 20.0}, True), ({"height": 12.0}, False),
        ({"share": 0.4}, True), ({"share": 0.24}, False),
        ({"way": 2.6}, True), ({"way": 1.6}, False),  # eight ordinates of 0.25 Hz
        ({"jitter": 0.08}, True), ({"jitter": 0.09}, False),
        ({"other": 0.26}, True), ({"other": 0.4}, False),
    ],
)  # fmt: skip
def test_a_wandering_tone_is_loud_long_smooth_and_alone(change, wanders):
    assert ("gyro_x" in wandering(chirp(**{**TONE, **change}))) == wanders


def chirp(seconds, height, share, way, jitter, other):
    """Spectra of two axes: a tone that goes from 20 Hz by ``way`` Hz on the first one, followed by the second over a share of the time."""
    rng = np.random.default_rng(8)
    n = round(seconds / DT)
    piece = round(4.0 / DT)
    count = n // piece
    on = np.linspace(0.0, 1.0, count, endpoint=False)
    steady = np.clip(on / share, 0.0, 1.0) + jitter * rng.standard_normal(count)
    u = np.minimum(np.arange(n) // piece, count - 1)
    t = np.arange(n) * DT
    size = math.sqrt(8.0 * height / piece)
    tone = size * np.sin(2 * np.pi * (20.0 + way * steady)[u] * t)
    hum = 3.0 * size * np.sin(2 * np.pi * (45.0 - 10.0 * on)[u] * t)  # what the other axis shows else
    first = rng.standard_normal(n) + tone * (on < share)[u]
    second = rng.standard_normal(n) + np.where((on < other * share)[u], tone, hum if other else 0.0)
    out = {}
    for name, x in (("gyro_x", first), ("gyro_y", second)):
        data = reduce(Series(x, 1.0 / DT, "rad/s", name))
        f_bins, power, dof = moving_spectrum(x, DT, 8.0)
        out[name] = replace(data, f=f_bins, power=power, dof=dof)
    return out


# -- false alarms at rest, what is left of a statistic, the search ----------------------------------------------------------------


def test_the_threshold_of_six_axes():
    """Two in a hundred nominal logs exceed it: with the tail of 400 simulated half hours, ln(6 x 0.25 / 0.02) times 0.75 nats."""
    six = threshold_of([usual_tail()] * 6, 0.0)
    assert six == pytest.approx(3.24, abs=0.15)
    assert certain(6) == pytest.approx(4.82, abs=0.1)
    assert usual_tail().exceeds(-0.1) == pytest.approx(usual_tail().exceeds(0.0)) and usual_tail().exceeds(
        0.3
    ) < 0.9 * usual_tail().exceeds(0.0)


def test_few_simulated_logs_move_the_tail_half_way():
    gains = np.concatenate([np.zeros(18), np.full(6, 0.25)])  # six draws of a tail of 0.25 nats
    assert tail_of(gains).excess == pytest.approx(0.5, abs=0.04)


@pytest.mark.parametrize(("spent", "left"), [(0.5, 0.5), (0.87, 0.13), (0.99, 0.1)])
def test_a_fit_leaves_a_tenth_of_a_statistics_variance_at_the_least(spent, left):
    assert residual_variance(1.0, 1.0, np.array([1.0]), np.array([[spent]])) == pytest.approx(left, abs=0.02)


class Pair:
    """A problem with one finding and a rival; what became of it."""

    def __init__(self, ahead):
        kept = Hypothesis("ramp", 10.0, (), None)
        self.found = [Found(kept, (kept,))]
        self.next = SimpleNamespace(idle=False, rival=Hypothesis("random_walk", 10.0 + ahead, (), None), kept=kept)
        self.put_in = ""

    def again(self, old):
        return self.next

    def put(self, old, new, again):
        self.put_in = new.effect


@pytest.mark.parametrize(
    ("ahead", "stands", "lead"), [(0.4, "ramp", None), (0.7, "random_walk", None), (0.1, "random_walk", 0.0)]
)
def test_a_rival_takes_the_place_of_a_finding_half_a_nat_ahead(ahead, stands, lead):
    problem = Pair(ahead)
    reconsider(problem, lead)
    assert problem.put_in == stands


# -- levels, amplitudes, slow processes, spikes ------------------------------------------------------------------------------------


@pytest.mark.parametrize(("ratio", "nominal"), [(1.2, True), (1 / 1.2, True), (1.3, False), (1 / 1.3, False)])
def test_a_nominal_level_may_be_off_by_twenty_percent(ratio, nominal):
    free = level("N", 1.0)
    assert (free.log_density(math.log(ratio)) > free.log_density(0.0) - 1.0) == nominal


def test_amplitudes_are_tried_over_five_decades():
    assert -math.log10(amplitudes(1.0)[0]) == pytest.approx(5.0, abs=0.1)


@pytest.mark.parametrize(("blocks", "slow"), [(2.4, True), (3.6, False)])
def test_a_process_faster_than_a_third_of_a_block_lives_above_them(blocks, slow):
    data = reduce(Series(noisy(), 1.0 / DT, "rad/s", "gyro_x"))
    beta = Value("beta", blocks / data.block_s, 0.0, 1.0, "1/s")
    assert is_slow(Hypothesis("gauss_markov", 5.0, (beta,), None), data) == slow


@pytest.mark.parametrize(("sigma", "kept_out"), [(6.4, False), (10.0, True)])
def test_a_sample_eight_sigma_from_its_neighbours_is_kept_out_of_the_high_pass(sigma, kept_out):
    x = np.random.default_rng(6).standard_normal(8000)
    scatter = np.std(x - 0.25 * (np.roll(x, 1) + np.roll(x, -1) + np.roll(x, 2) + np.roll(x, -2)))
    at = np.arange(200, 8000, 400)
    x[at] = sigma * scatter
    assert (np.count_nonzero(spikes(x)) > 10) == kept_out


# -- the mounting -------------------------------------------------------------------------------------------------------------------


def sideways(roll_deg=0.0, axle=0.0, n=200):
    rng = np.random.default_rng(7)
    rate = np.zeros((n, 3))
    rate[:, 2] = 0.3 * np.sin(np.arange(n) / 5.0)
    u = np.column_stack(
        [15.0 + np.zeros(n), 0.1 * rng.standard_normal(n) + axle * rate[:, 2], 0.1 * rng.standard_normal(n)]
    )
    return Sideways(np.arange(float(n)), u, rate, math.radians(roll_deg))


VEHICLE = SimpleNamespace(vehicle=SimpleNamespace(sigma=0.1, mounting_sigma=math.radians(5.0)))


@pytest.mark.parametrize(("roll_deg", "leans"), [(2.5, False), (3.7, True)])
def test_a_vehicle_that_leans_three_degrees_on_average_is_mounted_so(roll_deg, leans):
    assert (estimate(sideways(roll_deg), VEHICLE).angles[0] > math.radians(0.5)) == leans


def test_a_mounting_is_judged_on_the_second_half():
    _, dof, _ = _held_out(sideways(), VEHICLE)
    assert dof == pytest.approx(200, abs=4)


@pytest.mark.parametrize("known", [False, True])
def test_a_mounting_that_is_known_to_be_wrong_is_estimated_however_little_it_lacks(known, monkeypatch):
    for name in ("prepare", "fast_parts"):
        monkeypatch.setattr(mounting, name, lambda *_: None)
    monkeypatch.setattr(Sideways, "of", lambda _: sideways())
    assert estimate(sideways(), VEHICLE).nats < Policy().least_nats
    assert (find_mounting(None, VEHICLE, known=known).finding is not None) == known


def test_the_axle_is_within_a_few_metres():
    """As much information as a prior of 3 m holds draws the axle half way."""
    n = 200
    s = sideways(n=n)
    s.rate[:, 2] = 0.1 / 3.0 / math.sqrt(n) * np.where(np.arange(n) % 2, 1.0, -1.0)
    s.u[:, 1], s.u[:, 2] = 6.0 * s.rate[:, 2], 0.0
    assert estimate(s, VEHICLE).axle[0] == pytest.approx(3.0, abs=0.5)


# -- candidates of a log at rest ------------------------------------------------------------------------------------------------------


def resting_state(temperature=None, n=12_000):
    log = Series(WHITE.simulate(n, 0.1, np.random.default_rng(3)), 10.0, "rad/s", "gyro_x")
    return state_of(reduce(log), Explanation.nominal(WHITE), temperature)


@pytest.mark.parametrize(
    ("candidate", "name", "inside", "outside"),
    [("vibration_band", "ratio", 0.55, 0.75), ("decimation_filter", "order", 10.0, 15.0)],
)
def test_a_wider_band_is_no_resonance_and_a_steeper_filter_none(candidate, name, inside, outside, monkeypatch):
    tried = []
    monkeypatch.setattr(
        spectral, "best_of", lambda state, effect, variant, starts, *_, **__: tried.extend(starts) or []
    )
    getattr(spectral, candidate)(resting_state())
    frees = [
        f for e in tried for part in (*e.components, e.rolloff) if part is not None for f in part.free if f.name == name
    ]
    assert frees
    middle = frees[0].log_density(math.log(inside / 3.0))
    assert frees[0].log_density(math.log(inside)) > middle - 0.02
    assert frees[0].log_density(math.log(outside)) < middle - 0.15


@pytest.mark.parametrize(("excess", "resolved"), [(5.0, False), (7.0, True)])
def test_levels_are_taken_out_where_they_lead_by_six_nats_and_bursts_are_rarer(excess, resolved, monkeypatch):
    twin = Hypothesis("gauss_markov", 30.0, (), gauss_markov(resting_state())[0].change)
    told = SimpleNamespace(excess=excess, x=np.zeros(2), sigma=np.ones(2), path=np.zeros(120), block=100)
    module = import_module("insemu.gap.candidates.telegraph")
    monkeypatch.setattr(module, "gauss_markov", lambda _: [twin])
    monkeypatch.setattr(module, "_switching", lambda *_: told)
    found = module.telegraph(resting_state())[0]
    assert (found.variant == "levels") == resolved
    assert found.nats == pytest.approx(30.0 + excess - 0.7, abs=0.15)


def test_a_bias_that_jumps_is_rarer_than_a_slow_process() -> None:
    n = 72_000
    y = 1e-3 / math.sqrt(0.05) * np.random.default_rng(5).standard_normal(n) + 4e-4 * (np.arange(n) > 28_000)
    state = state_of(reduce(Series(y, 20.0, "rad/s", "gyro_x")), Explanation.nominal(WHITE))
    (jump,) = bias_steps.at_rest(state)
    # its evidence at its best start, less the spread of the starts and the odds of 55 to 1
    assert 41.0 < jump.nats < 43.4


def test_a_linear_thermal_bias_is_the_likeliest_and_lags_end_at_a_third_of_the_log(monkeypatch):
    n = 12_000
    state = resting_state(20.0 + 5.0 * np.sin(np.arange(n) / 2000.0))
    lags, nats, lagged, regression = [], [], thermal.lagged, thermal.regression
    monkeypatch.setattr(thermal, "lagged", lambda d, dt, lag: lags.append(lag) or lagged(d, dt, lag))
    monkeypatch.setattr(thermal, "regression", lambda *a: [nats.append(w.nats) or w for w in regression(*a)])
    monkeypatch.setattr(thermal, "less", lambda w, *_: w)
    linear = thermal.temperature(state)[0]
    assert linear.nats - nats[0] == pytest.approx(math.log(0.5), abs=0.2)
    tried = [lag for lag in lags if lag][:10]  # before the best of them is refined
    assert max(tried) / (0.1 * n) == pytest.approx(0.3, abs=0.05)


def test_effects_are_named_on_two_thirds_for_the_held_out_figures(monkeypatch):
    pieces = []
    log = Series(np.zeros(12_000), 10.0, "rad/s", "gyro_x")
    monkeypatch.setattr(rest, "piece", lambda data, first, last: pieces.append((first, last)) or data)
    monkeypatch.setattr(rest, "state_of", lambda *_: None)
    monkeypatch.setattr(rest, "search_axis", lambda *_, **__: SimpleNamespace(end=None, taken_out=lambda: None))
    monkeypatch.setattr(rest, "score_axis", lambda *_: None)
    at = rest._Log([log], {"gyro_x": WHITE}, None, (), {}, lambda _: None)
    at.held_out({"gyro_x": SimpleNamespace(start=SimpleNamespace(data=resting_state().data))}, 3.0)
    assert pieces[0][1] == pytest.approx(8000, abs=100) and pieces[1][0] == pieces[0][1]


# -- a large time offset ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "settled"),
    [
        ({}, True),
        ({"offset": 0.038}, True), ({"offset": 0.024}, False),
        ({"nats": 125.0}, True), ({"nats": 80.0}, False),
        ({"left": 0.42}, True), ({"left": 0.6}, False),
        ({"square": 1.9}, True), ({"square": 1.25}, False),
        ({"offset": 1.4, "nats": 4000.0}, True), ({"offset": 2.5, "nats": 8000.0}, False),
    ],
)  # fmt: skip
def test_what_a_time_offset_must_be_to_be_settled_before_the_search(change, settled, monkeypatch):
    """A stand-in for the filter, whose likelihood has one top: its height, its place, and the mean square that it leaves."""
    told = {"offset": 0.06, "nats": 400.0, "left": 0.2, "square": 4.0, **change}
    found = offset_found(monkeypatch, **told)
    assert (found is not None and abs(found - told["offset"]) < 0.02) == settled


def test_a_finer_first_step_finds_the_same_offset(monkeypatch):
    coarse_step = offset_found(monkeypatch, 0.2, 400.0, 0.2, 4.0)
    monkeypatch.setattr(timing, "FIRST_S", 0.5 * timing.FIRST_S)
    assert offset_found(monkeypatch, 0.2, 400.0, 0.2, 4.0) == pytest.approx(coarse_step, abs=1e-3)


@dataclass(frozen=True)
class Stamps:
    t: float = 0.0


@dataclass(frozen=True)
class Moved:
    imu: Stamps = Stamps()
    gnss: Stamps = Stamps()


def offset_found(monkeypatch, offset, nats, left, square):
    def tried(prepared, _):
        x = -prepared.recording.imu.t
        away = ((x - offset) / (offset if x < offset else 0.3)) ** 2
        mean = square * (left + (1.0 - left) * min(away, 1.0))
        return timing._Tried(-nats * away, -math.inf, mean, mean)

    monkeypatch.setattr(timing, "_tried", tried)
    nominal = SimpleNamespace(recording=Moved(), shifted=lambda recording: SimpleNamespace(recording=recording))
    found = timing.find_times(SimpleNamespace(recording=Moved(), prepared=nominal))
    return found[0].parameters[0].value if found else None


class Turns:
    """A problem in which each of two effects, once found, leaves nothing for the other, and neither is kept."""

    def __init__(self):
        self.found, self.asked = [], 0

    def rank(self):
        return []

    def choose(self, ranked):
        self.asked += 1
        named = Hypothesis(("ramp", "random_walk")[self.asked % 2], 5.0, (), None)
        return Found(named, (named,))

    def apply(self, new):
        self.found.append(new)
        return True

    def again(self, old):
        return SimpleNamespace(idle=True)

    def drop(self, old, again):
        self.found.remove(old)


def test_what_is_found_and_dropped_in_turns_ends_a_search():
    problem = Turns()
    search(problem, lambda _: None)
    assert problem.asked == 1 and not problem.found


# -- evidence beside what is left -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("squares", "doubted"), [(30.6, False), (32.4, True)])
def test_evidence_is_doubted_where_chance_does_so_once_in_twenty_times(squares, doubted):
    """Of 20 stretches with a shape in them the squares of the scores have a sum of 31.4 at 95 %."""
    shape, t = np.zeros(400), np.arange(400.0)
    shape[::20] = 1.0
    left = shape * math.sqrt(squares / 20)
    assert (excess(shape, left, t, 1.0) > 1.0) == doubted
