"""De-noising keeps what is slow, removes what is fast, and refuses what it cannot do."""

from __future__ import annotations

import numpy as np
import pytest

from insemu.denoise import Mode, delayed_approximation, denoise, outstanding, sure_threshold
from insemu.errors import InputError


def test_a_slow_signal_in_white_noise_comes_out_closer_to_the_truth() -> None:
    t = np.arange(8192) / 100.0
    slow = 9.8 + 0.5 * np.sin(2 * np.pi * t / 40.0)
    noisy = slow + 0.3 * np.random.default_rng(1).standard_normal(t.size)
    before, after = np.std(noisy - slow), np.std(denoise(noisy, 6) - slow)
    assert after < 0.2 * before
    assert np.std(denoise(noisy, 3) - slow) > 1.5 * after  # fewer octaves remove less


def test_no_levels_is_the_identity_and_columns_are_independent() -> None:
    x = np.random.default_rng(2).standard_normal((1000, 2))
    np.testing.assert_array_equal(denoise(x, 0), x)
    np.testing.assert_allclose(denoise(x, 4)[:, 1], denoise(x[:, 1], 4), atol=1e-13)  # sums of numbers of order 1


def test_scaling_and_offset_pass_through() -> None:
    x = np.random.default_rng(3).standard_normal(1501)
    np.testing.assert_allclose(denoise(5.0 * x + 9.8, 5), 5.0 * denoise(x, 5) + 9.8, atol=1e-12)
    assert denoise(x, 5).size == 1501


def test_sure_threshold_minimises_the_risk_by_brute_force() -> None:
    d = np.random.default_rng(4).standard_normal(200) * np.where(np.arange(200) % 10 == 0, 8.0, 1.0)

    def risk(t: float) -> float:
        return float(d.size - 2 * (np.abs(d) <= t).sum() + np.minimum(d**2, t**2).sum())

    assert sure_threshold(d) == pytest.approx(min(np.abs(d), key=risk), rel=1e-15)  # the root of a square


def scene(shake: float) -> tuple[np.ndarray, np.ndarray]:
    """A slow motion with a vibration that wanders about 12 Hz, and its measurement in white noise at 100 Hz."""
    t = np.arange(1 << 14) / 100.0
    motion = 2.0 * np.sin(2 * np.pi * t / 8.0) + shake * np.sin(2 * np.pi * (12.0 * t + 0.3 * np.sin(t / 3.0)))
    return motion, motion + 0.5 * np.random.default_rng(5).standard_normal(t.size)


@pytest.mark.parametrize("levels", [5, 7])
def test_packets_keep_a_vibration_that_octaves_take_for_noise(levels: int) -> None:
    motion, noisy = scene(0.6)
    octaves, packets = (np.std(denoise(noisy, levels, rule=rule) - motion) for rule in ("sure", "packets"))
    assert octaves > 0.4  # the vibration, 0.42, is gone
    assert packets < 0.5 * octaves


def test_packets_remove_noise_as_octaves_do() -> None:
    for shake in (0.0, 0.6):
        motion, noisy = scene(shake)
        for levels in (1, 3, 5, 7):
            octaves, packets = (np.std(denoise(noisy, levels, rule=rule) - motion) for rule in ("sure", "packets"))
            assert packets < 1.05 * octaves
    # one octave cannot be divided: only what holds little but noise is treated otherwise
    x = np.random.default_rng(6).standard_normal(1501) * np.where(np.arange(1501) % 7 == 0, 9.0, 1.0)
    np.testing.assert_allclose(denoise(x, 1, rule="packets"), denoise(x, 1), atol=1e-12)


@pytest.mark.parametrize("mode", ["soft", "hard"])
@pytest.mark.parametrize("n", [997, 4096])
def test_bands_of_packets_put_together_are_the_signal(mode: Mode, n: int) -> None:
    """A vibration without noise passes through, whatever the length of the record; scaled and moved as it is."""
    x = scene(0.6)[0][:n]
    clean = denoise(x, 5, rule="packets", mode=mode)
    assert clean.size == n and np.std(clean - x) < 0.05 * 0.42
    np.testing.assert_allclose(denoise(-3.0 * x + 9.8, 5, rule="packets", mode=mode), -3.0 * clean + 9.8, atol=1e-9)
    np.testing.assert_allclose(
        denoise(np.full(n, 9.8), 3, rule="packets", mode=mode), 9.8, rtol=n * np.spacing(1.0)
    )  # of a mean


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"levels": 20}, "expected 0 to"),
        ({"levels": 2, "wavelet": "db99"}, "unknown wavelet 'db99'"),
        ({"levels": 2, "rule": "stein"}, "expected one of: sure, universal, approximation, packets"),
    ],
)
def test_bad_options_are_refused(arguments: dict[str, object], said: str) -> None:
    with pytest.raises(InputError, match=said):
        denoise(np.zeros(500), **arguments)  # type: ignore[arg-type]


def test_nan_is_refused() -> None:
    with pytest.raises(InputError, match="1 value"):
        denoise([0.0, np.nan, 1.0] * 1, 0)


def test_what_stands_out_of_noise_is_the_motion_and_an_axis_at_rest_is_a_constant() -> None:
    rng = np.random.default_rng(5)
    t = np.arange(20_000) * 0.01
    turn = 0.5 * np.exp(-0.5 * ((t - 80.0) / 3.0) ** 2)
    noise = 0.01 * rng.standard_normal((t.size, 2))
    seen = outstanding(np.column_stack([turn, np.full(t.size, 0.3)]) + noise, 10)
    assert np.ptp(seen[:, 1]) < 1e-12
    assert seen[0, 1] == pytest.approx(0.3, abs=1e-3)
    assert np.std(seen[:, 0] - turn) < 0.005
    assert np.max(np.abs(seen[:, 0] - turn)) < 0.02


def test_the_approximation_alone_is_what_the_low_octaves_hold() -> None:
    x = np.random.default_rng(6).standard_normal(4096)
    kept = denoise(x, 5, rule="approximation")
    # white noise of unit level: 1/32 of its power is left
    assert np.var(kept) == pytest.approx(1 / 32, rel=0.3)
    # a projection, but for the ends, which are continued by reflection
    np.testing.assert_allclose(denoise(kept, 5, rule="approximation")[500:-500], kept[500:-500], atol=1e-10)
    np.testing.assert_allclose(denoise(2.0 * x, 5, rule="approximation"), 2.0 * kept, atol=1e-12)


@pytest.mark.parametrize("delay", [0, 3, 40])
def test_a_delayed_approximation_is_that_of_the_window_that_has_come_in(delay: int) -> None:
    x = 9.8 + np.cumsum(np.random.default_rng(7).standard_normal(1500)) * 0.01
    seen = delayed_approximation(x, 3, delay)
    window = 8 * 16
    for k in (window, 700, 1500 - 1 - delay):
        came = x[k + delay - window + 1 : k + delay + 1]
        assert seen[k] == pytest.approx(denoise(came, 3, rule="approximation")[window - 1 - delay], abs=1e-12)
    changed = x.copy()
    changed[900:] += 5.0
    np.testing.assert_allclose(delayed_approximation(changed, 3, delay)[: 900 - delay], seen[: 900 - delay], atol=1e-12)
    assert abs(delayed_approximation(changed, 3, delay)[900 - delay] - seen[900 - delay]) > 1e-10


def test_a_delay_longer_than_the_filter_is_refused() -> None:
    with pytest.raises(InputError, match="expected 0 to 64"):
        delayed_approximation(np.zeros(100), 3, 65)


def test_what_is_known_of_the_noise_keeps_slow_motion_behind_vibration() -> None:
    rng = np.random.default_rng(4)
    t = np.arange(8192) * 0.01
    gust = 0.1 * np.sin(2.0 * np.pi * 0.5 * t)
    shaken = gust + 2.0 * np.sin(2.0 * np.pi * 33.0 * t) + 1e-3 * rng.standard_normal(t.size)
    judged, known = (outstanding(shaken[:, None], 9, noise=n)[:, 0] for n in (None, np.array([1e-3])))

    def seen(x: np.ndarray) -> float:
        return float(x @ gust / (gust @ gust))

    assert abs(seen(judged)) < 0.05 and seen(known) == pytest.approx(1.0, abs=0.02)
    # noise that is louder than known is judged by the first octave still
    rest = 1e-3 * rng.standard_normal((t.size, 1))
    assert np.ptp(outstanding(rest, 9, noise=np.array([1e-2]))) < 1e-6
