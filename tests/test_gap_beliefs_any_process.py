"""What a log is believed to be may be written in any process: the evidence asks the process and knows none."""

import math

import numpy as np
import pytest

from insemu.gap import find_static_gap
from insemu.gap.candidates.axis import state_of, whitened
from insemu.gap.candidates.telegraph import _background
from insemu.gap.data.log import reduce
from insemu.gap.evidence.model import Explanation, Likelihood
from insemu.gap.policy import rules
from insemu.noise import AR, AR1, ARMA, BI, DR, GM, MA, QN, RC, RW, SIN, WN, NoiseModel, Process
from insemu.records import Series

RATE = 20.0
GAUSS_MARKOV = GM(4e-4, 1.0 / 40.0)
WHITE = WN(1e-3)


def twins() -> dict[str, NoiseModel]:
    """One process, three ways to write it."""
    phi, sigma2 = GAUSS_MARKOV.discrete(1.0 / RATE)
    return {
        "GM": WHITE + GAUSS_MARKOV,
        "AR1": WHITE + AR1(phi, sigma2, RATE),
        "AR(1)": WHITE + AR((phi,), sigma2=sigma2, rate_hz=RATE),
    }


def a_log(seed: int, n: int = 36_000) -> Series:
    return Series((WHITE + GAUSS_MARKOV).simulate(n, 1.0 / RATE, np.random.default_rng(seed)), RATE, "rad/s", "gyro_x")


def test_the_evidence_of_one_process_does_not_depend_on_how_it_is_written() -> None:
    likelihood = Likelihood(reduce(a_log(3)))
    values = {
        name: (likelihood.low(e), likelihood.high(e), likelihood.along(e)(e.start()))
        for name, e in ((name, Explanation.nominal(model)) for name, model in twins().items())
    }
    for name, (low, high, _) in values.items():
        assert low == pytest.approx(values["GM"][0], abs=1e-5), name
        assert high == pytest.approx(values["GM"][1], abs=1e-5), name
    # a variance has twice the prior width of a deviation in its logarithm
    assert values["AR1"][2] == pytest.approx(values["GM"][2] - math.log(2.0), abs=1e-5)


def test_a_nominal_log_believed_as_an_autoregression_misses_nothing() -> None:
    for name, belief in twins().items():
        report = find_static_gap([a_log(5)], {"gyro_x": belief}, rng=np.random.default_rng(1), hold_out=False)
        assert report.verdict == "nothing missing", (name, report.findings)


@pytest.mark.parametrize(
    ("process", "name"),
    [
        (AR1(0.9, 1e-6, RATE), "sigma2"),
        (ARMA((0.5,), (0.3,), 1e-6, RATE), "sigma2"),
        (GAUSS_MARKOV, "sigma"),
        (RW(1e-5), "K"),
        (BI(1e-5), "B"),
    ],
    ids=lambda v: v if isinstance(v, str) else v.symbol,
)
def test_the_level_of_every_noise_is_free_by_as_much(process: Process, name: str) -> None:
    (free,) = Explanation.nominal(NoiseModel((process,))).free
    power = process.level.power
    assert free.name == name
    assert free.high / process.parameters[name] == pytest.approx((1.0 + rules().tolerance) ** power)
    scaled = process.scaled(1.0 + rules().tolerance)
    assert scaled.parameters[name] == pytest.approx(free.high)


def test_a_signal_of_one_draw_has_no_level_to_free() -> None:
    assert Explanation.nominal(SIN(1e-3, 2.0) + DR(1e-6) + RC(1e-3)).free == ()


def test_a_level_of_zero_is_no_process() -> None:
    """A fit that found no white noise leaves ``N = 0``; the gap is looked for all the same."""
    belief = NoiseModel.parse("WN(N=0) + GM(sigma=4e-4, Tc=40 s)", "rad/s")
    assert len(Explanation.nominal(belief).components) == 1
    report = find_static_gap([a_log(5)], {"gyro_x": belief}, rng=np.random.default_rng(1), hold_out=False)
    assert [s.effect for s in report.findings] == ["white_noise"]


def test_noise_that_is_mostly_memory_has_no_outlier_where_its_ends_meet() -> None:
    """The discrete transform is periodic: the last sample meets the first, and a belief with much memory flagged that jump in 12 % of logs."""
    belief = NoiseModel.parse("ARMA(ar=[1.2, -0.21], ma=[0.4], sigma2=1e-6, rate_hz=20) + WN(N=5e-4)", "rad/s")
    x = belief.simulate(20_000, 1.0 / RATE, np.random.default_rng(8))
    x += np.linspace(-0.5, 0.5, x.size) * (
        6.0 * x.std() + x[0] - x[-1]
    )  # slow enough to be below the band, but for the jump
    state = state_of(reduce(Series(x, RATE, "rad/s", "gyro_x")), Explanation.nominal(belief))
    assert np.abs(whitened(state)).max() < 6.0


def test_what_is_slow_does_not_depend_on_how_a_belief_is_written() -> None:
    """A level that switches is looked for beside the same background, however the Gauss-Markov process beneath it is written."""
    dt = 1.0 / RATE
    phi, sigma2 = GAUSS_MARKOV.discrete(dt)
    longer = AR((phi, 0.0), sigma2=sigma2, rate_hz=RATE)
    data = reduce(a_log(1, 4000))
    ways = [*twins().values(), WHITE + longer, WHITE + ARMA((phi,), (0.0,), sigma2, RATE)]
    first, *others = (_background(state_of(data, Explanation.nominal(m)), 1.0)[1] for m in ways)
    assert first > 0.0
    assert others == pytest.approx([first] * 4, rel=1e-6)
    assert all(p.remembers(dt) for p in (RW(1.0), BI(1.0), longer))
    assert not any(p.remembers(dt) for p in (WN(1.0), QN(1.0), MA(ma=(0.5,), sigma2=1.0, rate_hz=RATE), DR(1.0)))
    assert longer.remembers(dt, 30.0) and not longer.remembers(dt, 50.0)
