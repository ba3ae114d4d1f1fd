"""What is kept of any number of realizations: the same bits whatever the way, and the figures of plain arrays."""

from __future__ import annotations

import numpy as np
import pytest

from insemu.evaluate.errors import RESAMPLED, bootstrap_mean, paired_ratio, resampled_means
from insemu.evaluate.sketch import ACCURACY, quantiles, sketched
from insemu.evaluate.tally import Ladder, Tally, pieces, tally

T = np.arange(40.0)
OUTAGES = [(10.0, 8.0), (25.0, 10.0)]


def flown(count: int) -> list[dict[str, np.ndarray]]:
    rng = np.random.default_rng(7)
    out = []
    for _ in range(count):
        error = rng.standard_normal((2, T.size, 9)) * np.geomspace(1e-3, 1e3, 9)
        sigma = np.broadcast_to(np.geomspace(1e-3, 1e3, 9), error.shape)
        out.append({"error": error, "sigma": sigma, "nees": (error**2 / sigma**2).sum(axis=-1), "seconds": np.ones(2)})
    return out


def same(one: Tally, other: Tally) -> bool:
    return one.to_bytes() == other.to_bytes()


def test_the_sums_are_those_of_plain_arrays_and_their_bits_do_not_depend_on_the_way() -> None:
    items = flown(150)
    nodes: dict[tuple[int, int], Tally] = {}
    ladder = Ladder(made=lambda size, first, node: nodes.update({(size, first): node}))
    for item in items:
        ladder.push(tally(item, T, OUTAGES))
    whole = ladder.total()
    error = np.stack([i["error"] for i in items])
    np.testing.assert_allclose(whole.sums["error_square"], (error**2).sum(axis=0), rtol=1e-13)
    np.testing.assert_array_equal(whole.runs["end_error"][:, 33, 1], error[33, :, 35])
    np.testing.assert_allclose(whole.runs["north_max_m"][1, :, 0], np.abs(error[:, 1, 11:19, 0]).max(axis=1))
    assert set(nodes) == {(8, k) for k in range(0, 144, 8)} | {(64, 0), (64, 64)}
    for held in ({(64, 0)}, {(8, 8), (64, 64)}, set(nodes)):
        again = Ladder()
        plan = pieces(range(150), lambda size, first, there=frozenset(held): (size, first) in there)
        for size, first in plan:
            kept = nodes[size, first] if size > 1 else tally(items[first], T, OUTAGES)
            again.push(Tally.of_bytes(kept.to_bytes()))
        assert same(again.total(), whole)
    fewer = Ladder()
    for item in items[:-1]:
        fewer.push(tally(item, T, OUTAGES))
    assert not same(fewer.total(), whole)
    plain = items[0]["error"] ** 2
    for item in items[1:]:
        plain = plain + item["error"] ** 2
    # the order of sums does matter: without the tree the bits are others
    assert (plain != whole.sums["error_square"]).any()


def test_a_part_that_starts_in_the_middle_makes_the_nodes_that_it_can() -> None:
    items = flown(40)
    made: list[tuple[int, int]] = []
    ladder = Ladder(13, made=lambda size, first, node: made.append((size, first)))
    for item in items[13:]:
        ladder.push(tally(item, T, OUTAGES))
    assert made == [(8, 16), (8, 24), (8, 32)]


def test_quantiles_are_within_one_per_cent() -> None:
    rng = np.random.default_rng(3)
    values = np.exp(3.0 * rng.standard_normal((5, 3000)))
    sketch = sum((sketched(column) for column in values.T[1:]), start=sketched(values[:, 0]))
    levels = (0.05, 0.5, 0.95, 0.99)
    exact = np.quantile(values, levels, axis=1, method="lower")
    assert np.abs(quantiles(sketch, levels) / exact - 1.0).max() <= ACCURACY * (1 + 1e-9)
    assert np.isnan(quantiles(sketched([1.0, np.nan]), [0.5]))[0].tolist() == [False, True]


def test_intervals_of_many_are_those_of_the_bootstrap() -> None:
    """Just above the limit the normal interval takes the place of the resampled one: their ends differ by what 10,000 resamples can tell."""
    rng = np.random.default_rng(5)
    b = rng.exponential(size=RESAMPLED + 1)
    a = 0.9 * b + 0.1 * rng.exponential(size=b.size)
    normal = bootstrap_mean(b)
    low, high = np.quantile(resampled_means(b[:, None])[:, 0], [0.025, 0.975])
    assert normal.low is not None and normal.high is not None
    assert (normal.low, normal.high) == pytest.approx((low, high), abs=0.1 * (high - low))
    pair, ratios = paired_ratio(a, b), np.divide(*resampled_means(np.stack([a, b], axis=1)).T)
    assert (pair.low, pair.high) == pytest.approx(
        tuple(np.quantile(ratios, [0.025, 0.975])), abs=0.1 * float(np.ptp(np.quantile(ratios, [0.025, 0.975])))
    )
    other = paired_ratio(1.2 * a, b)
    assert other.p_value == 1e-4 and pair.p_value is not None and pair.p_value > 1e-4
    assert paired_ratio(b, b).p_value == 1.0
