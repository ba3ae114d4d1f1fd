"""Every constant that decides what is named, in one frozen object: name, value, unit, reason, and the run that calibrates it.

``find_gap(..., policy=Policy(lead=4.0))`` searches under another policy. Code below the door asks :func:`rules` for the one in force, which is
a context variable: it need not be handed through every function, and two threads may search under two policies. What only sets a precision
(blocks, knots, softness of a bound, draws) is no decision and stands where it is used. ``tests/policy_perturbation.yaml`` says what moves with each.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from typing import Any

from insemu.effects import MOTION_HZ
from insemu.lost import LONGEST_S, STRAY

#: The runs that calibrate: what each of them is, as a command or as the file of tests that pins the constant.
RUNS = {
    "null": "python -m benchmarks.trial --hidden 0 --no-hold-out --recordings 500",
    "one": "python -m benchmarks.trial --recordings 200",
    "two": "python -m benchmarks.trial --hidden 2 --no-hold-out --recordings 60",
    "outside": "python -m benchmarks.trial --outside --recordings 24",
    "rest-null": "python -m tests.gap_static_experiments null",
    "rest-effects": "python -m tests.gap_static_experiments effects",
    "rest-sets": "python -m tests.gap_static_experiments sets",
    "rest-map": "python -m tests.gap_static_experiments map",
    "rest-real": "python -m tests.gap_static_experiments real",
    "rest-thermal": "python -m tests.gap_static_experiments thermal",
    "drive-repeated": "python -m tests.gap_dynamic_experiments",
    "tests-rest": "tests/test_gap_static.py",
    "tests-drive": "tests/test_gap_dynamic.py",
    "tests-refined": "tests/test_gap_refined.py",
    "foreign": "python -m benchmarks.foreign --kinds none --recordings 100",
    "jump": "python -m benchmarks.foreign --kinds jump one --recordings 100",
    "real-drives": "the three real drives of docs/gap.md",
}


def _decides(value: Any, unit: str, run: str, reason: str) -> Any:
    return field(default=value, metadata={"unit": unit, "run": run, "reason": reason})


@dataclass(frozen=True)
class Policy:
    """The constants of the search; each field carries ``unit``, ``run`` (a key of :data:`RUNS`) and ``reason`` as metadata."""

    # fmt: off
    # -- what counts as a finding ---------------------------------------------------------------------------------------------------
    least_nats: float = _decides(3.0, "nats", "null", "Log evidence below which nothing is said in any recording: odds of 20 to 1.")
    lead: float = _decides(3.0, "nats", "one", "A name stands alone with this lead over every other effect; whatever is nearer is of its class.")
    class_share: float = _decides(0.96, "1", "one", "Members of a class in a drive hold this share of the posterior together.")
    something: float = _decides(0.8, "1", "null", "Probability that anything at all is missing, below which the search of a drive ends.")
    false_alarms: float = _decides(0.02, "1", "null", "Share of nominal recordings, all axes and effects together, that may be flagged.")
    omnibus: float = _decides(0.001, "1", "null", "Corrected p-value of a test of the final model below which it is called unexplained.")
    naming_share: float = _decides(2.0 / 3.0, "1", "one", "Share of a recording on which effects are named for the held-out figures.")
    mounting_share: float = _decides(
        0.5, "1", "real-drives", "The same for a wrong mounting: a drive whose angles are found in its first half is judged on all of the second."
    )
    keep_nats: float = _decides(2.0, "nats", "two", "What an effect or an axis of a drive must be worth next to the others to be kept.")
    swap_nats: float = _decides(0.5, "nats", "two", "By how much a rival must beat an earlier effect, reconsidered, to take its place.")
    confusable: float = _decides(
        0.1, "1", "drive-repeated", "Share of repeated recordings in which a rival stands next to an effect to be called confusable."
    )
    doubt: float = _decides(
        0.05, "1", "real-drives", "How rarely chance alone lets scores of stretches vary so much that the evidence of an effect counts less."
    )
    # -- tolerances and priors ------------------------------------------------------------------------------------------------------
    tolerance: float = _decides(0.22, "1", "null", "Relative error of a nominal noise level before that is an effect: 20 % and a margin.")
    prior_scales: tuple[float, ...] = _decides(
        (0.1, 0.3, 1.0, 3.0, 10.0), "datasheet scale", "one", "Prior standard deviations of a coefficient; evidence is averaged over them."
    )
    wider_scales: tuple[float, ...] = _decides(
        (30.0,), "datasheet scale", "one", "Further sizes of shapes in a drive: a sensor may be of another class than it is taken for."
    )
    far_scales: tuple[float, ...] = _decides(
        (100.0,), "datasheet scale", "foreign", "Further sizes of timing, fixes and model of the Earth: a wrong antenna or stamp has no datasheet."
    )
    second_order: float = _decides(
        1.4, "nats", "foreign", "Log prior odds, 4 to 1, against asymmetries, squares, thermal scale factors and lags: plain errors are more common."
    )
    widest_scales: tuple[float, ...] = _decides(
        (300.0, 1000.0), "datasheet scale", "one", "Further slopes in a drive: a random walk of any size follows a slope."
    )
    amplitude_range: float = _decides(1e5, "1", "rest-effects", "Ratio of the largest to the smallest amplitude that a prior admits.")
    slow_amplitudes: tuple[float, float] = _decides(
        (1e-3, 3000.0), "datasheet scale", "one", "Smallest and largest prior amplitude of a slow process in a drive."
    )
    # -- a log at rest --------------------------------------------------------------------------------------------------------------
    slow_blocks: float = _decides(3.0, "1/block", "rest-sets", "A process whose rate times a block is less lives in the block means.")
    drifting_p: float = _decides(
        1e-6, "1", "rest-real", "p-value of a stationary spectrum below which no stationary process is looked for in the fast band."
    )
    tail_share: float = _decides(0.25, "1", "rest-null", "Share of the simulated logs that counts as the tail of their best candidates.")
    tail_excess: float = _decides(0.75, "nats", "rest-null", "Mean excess of that tail on 400 simulated half hours.")
    tail_worth: float = _decides(6.0, "draws", "rest-null", "Number of draws that the knowledge of the usual excess is worth.")
    tail_start: float = _decides(0.0, "nats", "rest-null", "Where the tail starts as a rule (five kinds of noise: -0.3 to -0.1).")
    tail_highest: float = _decides(0.5, "nats", "rest-null", "Highest start of a tail that logs of 3 minutes to 2 h show.")
    highest_bandwidth: float = _decides(0.6, "1", "rest-effects", "Bandwidth over frequency of a resonance; a wider band is none.")
    highest_order: float = _decides(12.0, "1", "rest-effects", "Order of the steepest low-pass that is weighed.")
    most_outliers: float = _decides(0.1, "1", "real-drives", "Share of samples that outliers may be: two kinds of noise in turns are none.")
    telegraph_resolved: float = _decides(
        6.0, "nats", "rest-effects", "Lead over a Gaussian process of the same spectrum at which the path of two levels is taken out."
    )
    telegraph_rarer: float = _decides(
        0.7, "nats", "rest-effects", "Log prior odds against a switching level: burst noise is rarer than a Gauss-Markov process."
    )
    step_rarer: float = _decides(
        4.0, "nats", "jump", "Log prior odds, 55 to 1, against a bias that jumps: in a short recording a slow process looks like a jump."
    )
    thermal_odds: tuple[float, float, float, float] = _decides(
        (0.5, 0.2, 0.2, 0.1), "1", "rest-thermal", "Prior weight of a linear, a cubic, a lagged, and a cubic and lagged thermal bias."
    )
    longest_lag: float = _decides(0.3, "log length", "rest-thermal", "Longest thermal time constant that is tried.")
    # -- what samples show by themselves --------------------------------------------------------------------------------------------
    most_values: float = _decides(0.8, "1", "tests-rest", "Largest share of different values among the samples of a lattice.")
    material_lsb: float = _decides(
        0.05, "1", "tests-rest", "A lattice finer than this share of the noise adds 0.02 % to its variance and is the digits of a file."
    )
    coarse_lsb: float = _decides(
        3.0, "1", "real-drives", "Output counts of more standard deviations of the noise are coarse: it does not reach from one to the next."
    )
    stray: float = _decides(STRAY, "1", "tests-drive", "Share of the interval that a stamp may stray before it says nothing of lost samples.")
    longest_gap_s: float = _decides(LONGEST_S, "s", "tests-drive", "Longest gap that is bridged; a longer one is an outage of the IMU.")
    fewest_clipped: int = _decides(4, "1", "tests-drive", "Samples at one value that make a full scale.")
    pile_nats: float = _decides(20.0, "nats", "real-drives", "What a pile on a lattice must be worth: steady manoeuvres make piles too.")
    most_lost: float = _decides(0.2, "1", "tests-rest", "Share of samples that a static log may miss.")
    # -- the band above the motion --------------------------------------------------------------------------------------------------
    motion_hz: float = _decides(MOTION_HZ, "Hz", "one", "Lowest frequency at which a moving IMU shows its noise rather than its motion.")
    fast_nats: float = _decides(
        6.0, "nats", "null", "Least evidence there, over a vibration where most axes shake; nominal drives stay below 2 on every axis."
    )
    evident: float = _decides(10.0, "sigma", "one", "Residual of a sample that stands out by itself.")
    alike: float = _decides(0.8, "1", "one", "Share of such residuals that must look like single samples.")
    beside: float = _decides(5.0, "sigma", "one", "Residual that counts as an outlier next to an evident one.")
    alone: float = _decides(8.0, "sigma", "one", "Distance from the neighbours at which a sample is kept out of the high-pass.")
    tone_piece_s: float = _decides(4.0, "s", "outside", "Length of the pieces in which a tone is followed.")
    tone_pieces: int = _decides(12, "1", "outside", "Fewest pieces in which a tone is followed.")
    tone_loud: float = _decides(20.0, "1", "outside", "Height of a tone over the median of its piece; noise reaches it once in a million.")
    tone_share: float = _decides(0.3, "1", "outside", "Share of the pieces in which a wandering tone is loud.")
    tone_way: float = _decides(8.0, "ordinates", "outside", "Least way of a wandering tone, in ordinates of a piece.")
    tone_smooth: float = _decides(0.05, "1", "outside", "Von Neumann's ratio of a smooth way; 1 for independent frequencies.")
    tone_shared: float = _decides(0.3, "1", "outside", "Share of its pieces in which no other axis may follow a tone of one axis.")
    shaking_bin: float = _decides(5.0, "nats", "foreign", "Excess of a bin of the band over the believed noise that is beyond doubt.")
    shaking_nats: float = _decides(30.0, "nats", "foreign", "Excess of the whole band of an axis at which it is asked whether the vehicle shakes.")
    shaking_axes: int = _decides(4, "1", "foreign", "Axes with such an excess at once that are the vehicle: sensors do not fail together.")
    shaking_p: float = _decides(1e-6, "1", "foreign", "Chance below which two axes go together: twice fifteen pairs are looked at.")
    swing_nats: float = _decides(10.0, "nats", "foreign", "What it must explain of the velocities that the antenna swings as the vehicle shakes.")
    tail_sum: float = _decides(5.0, "1", "foreign", "Sum of standardised excesses from the edge of the band on that is a tail of the motion.")
    tail_peak: float = _decides(1.25, "1", "foreign", "A peak further above the edge of the band than this factor is no tail of the motion.")
    leak: float = _decides(10.0, "1", "two", "Factor by which a slow process may differ above the motion from what the fixes say.")
    # -- a drive or flight ----------------------------------------------------------------------------------------------------------
    correct_nats: float = _decides(
        40.0, "nats", "two", "A shape worth more is taken out of the data and the filter run again, so that the rest is small enough to be linear."
    )
    strong_nats: float = _decides(
        150.0, "nats", "two", "Effects of fixes and timing worth more together bend what is seen of the rest: the search runs once more."
    )
    shortest_step: float = _decides(2.5, "fixes", "one", "A shorter step in the fixes is an outlier.")
    longest_step: float = _decides(
        0.6, "of the fixes' span", "two", "What lasts longer is an offset of the rest: 909 of 964 s of a real drive."
    )
    further_step: float = _decides(
        15.0, "nats", "real-drives", "What a step in the fixes must be worth next to another: small ones follow any slow error."
    )
    lowest_level: float = _decides(0.05, "1", "real-drives", "Receivers state up to 20 times the scatter from fix to fix: they mean slow errors.")
    highest_level: float = _decides(8.0, "1", "one", "Largest ratio of a level of the fixes to what is stated.")
    colour_sizes: tuple[float, float] = _decides((0.1, 30.0), "1", "one", "Slow errors of the fixes over their stated standard deviation.")
    nis_left: float = _decides(0.75, "1", "foreign", "Share of its variance that a NIS keeps: a level of two components follows neither.")
    statistic_left: float = _decides(0.1, "1", "rest-map", "Share of its variance that any other statistic keeps of what a fit follows.")
    # -- settled before the search --------------------------------------------------------------------------------------------------
    offset_largest_s: float = _decides(0.6, "s", "real-drives", "Largest time offset that is tried; loggers further off are so by seconds.")
    offset_least_s: float = _decides(0.03, "s", "tests-refined", "A smaller one is left to the search, where it is linear.")
    offset_nats: float = _decides(100.0, "nats", "tests-refined", "What it must be worth: coloured noise explains some of it.")
    offset_share: float = _decides(0.5, "1", "tests-refined", "Share of the innovations' mean square that may be left with it.")
    offset_nis: float = _decides(1.5, "1", "tests-refined", "Mean NIS below which no large offset can hide.")
    road_roll: float = _decides(math.radians(1.5), "rad", "tests-refined", "Mean roll of a drive: roads fall to one side by 2 %, loads are uneven.")
    axle_sigma: float = _decides(3.0, "m", "tests-refined", "Way from the IMU to the axle that does not steer.")
    # fmt: on

    def moved(self, name: str, factor: float) -> Policy:
        """The policy with one constant times a factor; counts are rounded, and move by one at least."""
        value: Any = getattr(self, name)
        change: dict[str, Any] = {}
        if isinstance(value, tuple):
            change[name] = tuple(factor * v for v in value)
        elif isinstance(value, int):
            whole = round(value * factor)
            change[name] = whole if whole != value else value + (1 if factor > 1.0 else -1)
        elif name in _SHARES and factor * value >= 1.0:
            change[name] = 1.0 - (1.0 - value) / factor  # a share stays one
        else:
            change[name] = factor * value if value else factor - 1.0
        return replace(self, **change)


#: Constants that are shares of a whole.
_SHARES = (
    "class_share",
    "something",
    "naming_share",
    "mounting_share",
    "most_values",
    "alike",
    "offset_share",
    "nis_left",
)
_IN_FORCE: ContextVar[Policy] = ContextVar("policy")
_USUAL = Policy()


def rules() -> Policy:
    """The policy in force."""
    return _IN_FORCE.get(_USUAL)


@contextmanager
def under(chosen: Policy | None) -> Iterator[Policy]:
    """Run a block under a policy; ``None`` leaves the one in force."""
    token = _IN_FORCE.set(chosen or rules())
    try:
        yield rules()
    finally:
        _IN_FORCE.reset(token)
