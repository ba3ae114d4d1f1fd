"""What stands for several effects at once: an equation, a slow process."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.foreign.judge import Job, drawn, taken
from insemu.gap import find_gap


@pytest.mark.slow(reason="a whole search of a drive or a log, whose parts have quick tests")
def test_two_effects_that_a_product_of_inputs_stands_for_are_named() -> None:
    """A scale factor and a misalignment of 210 and 69 nats: f_z^2, which is no effect, explains 4 nats more than either and leaves the rest."""
    measured, nominal = taken(*drawn(Job("two", 801022, 360.0, True, False, False))[:2])
    report = find_gap(measured, nominal, rng=np.random.default_rng(1), hold_out=False, pictures=False)
    assert report.verdict in ("named", "class") and not report.remainder
    classes = [{m.effect for m in f.members} for f in report.findings]
    assert len(classes) == 2
    for effect in ("scale_factor", "misalignment"):
        assert any(effect in members for members in classes)


@pytest.mark.slow(reason="a whole search of a drive or a log, whose parts have quick tests")
def test_what_is_outside_is_not_lost_behind_what_follows() -> None:
    """An error outside the catalogue that several effects follow a part of."""
    world, hidden, _ = drawn(Job("outside", 840003, 360.0, True, False, False))
    measured, nominal = taken(world, hidden)
    report = find_gap(measured, nominal, rng=np.random.default_rng(1), hold_out=False, pictures=False)
    assert (report.findings[0].effect, report.findings[0].axes) == ("expression", (hidden[0].equation,))


@pytest.mark.slow(reason="a whole search of a drive, whose parts have quick tests")
def test_a_slow_process_gives_way_to_shapes_of_two_sensors() -> None:
    """A scale factor of a gyroscope (80 nats) and a temperature coefficient of an accelerometer (75) were one random walk of 89."""
    measured, nominal = taken(*drawn(Job("two", 850202, 360.0, True, False, False))[:2])
    report = find_gap(measured, nominal, rng=np.random.default_rng(1), hold_out=False, pictures=False)
    assert {(f.effect, f.sensor) for f in report.findings} == {("scale_factor", "gyro"), ("temperature", "accel")}
    assert report.verdict == "named"
