"""Numbers as a reader is shown them."""

from __future__ import annotations

import pytest

from insemu.shown import count_of, with_interval


@pytest.mark.parametrize(
    ("numbers", "said"),
    [
        ((1.0353, 0.9372, 1.1334), "1.04 [0.937, 1.13]"),
        ((144.125, 143.75, 144.25), "144.1 [143.8, 144.2]"),  # the start of a step, told to half a second
        ((2.0, 2.0, 2.0), "2 [2, 2]"),
        ((1.0, 1.0 - 1e-12, 1.0 + 1e-12), "1 [1, 1]"),
    ],
)
def test_an_interval_has_the_digits_that_tell_its_ends_apart(numbers, said) -> None:
    assert with_interval(*numbers) == said


def test_one_thing_is_counted_in_the_singular() -> None:
    assert [count_of(n, "realization") for n in (0, 1, 24)] == ["0 realizations", "1 realization", "24 realizations"]
