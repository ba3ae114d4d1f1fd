"""Hostile models: text, mappings and lists of any kind are read or refused by InputError, quickly and in little memory."""

import time
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from insemu.errors import InputError
from insemu.noise import PROCESSES, NoiseModel
from insemu.noise.grammar import MOST_PROCESSES
from insemu.noise.processes.autoregressive import MOST_ORDERS

NAMES = st.sampled_from([*PROCESSES, "ARW", "RRW", "gm", "ZZ", ""])
PARAMETERS = {p.name for c in PROCESSES.values() for p in c.PARAMETERS}
KEYS = st.sampled_from([*sorted(PARAMETERS), "ar", "ma", "order", "rate_hz", "Tc", "q", "p", "process", "", "x"])
NUMBERS = st.one_of(
    st.integers(-3, 5),
    st.sampled_from([10**400, -(10**400), 10**30, 2**63, 1 << 70]),
    st.floats(),
)
TEXTS = st.one_of(
    st.text(max_size=12),
    st.sampled_from(
        [
            "1e-3",
            "0.032 deg/s/sqrt(Hz)",
            "1 m^(1/0)",
            "1e400",
            "nan",
            "inf",
            "(" * 400,
            "1 " + "(" * 60,
            "0x1",
            "1_0",
            "20 Hz",
            "10 s",
        ]
    ),
)
VALUES: st.SearchStrategy[Any] = st.recursive(
    st.one_of(st.none(), st.booleans(), NUMBERS, TEXTS, st.binary(max_size=3)),
    lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(st.one_of(KEYS, NUMBERS), inner, max_size=3)),
    max_leaves=6,
)
ITEMS = st.dictionaries(st.one_of(KEYS, NUMBERS, st.none()), VALUES, max_size=4)
NAMED = st.builds(lambda item, name: {**item, "process": name}, ITEMS, st.one_of(NAMES, VALUES.filter(lambda v: True)))
ARGUMENT = st.one_of(
    TEXTS, st.builds(lambda k, v: f"{k}={v}", KEYS, st.one_of(TEXTS, NUMBERS, st.lists(NUMBERS, max_size=3)))
)
TERM = st.builds(
    lambda count, name, arguments, tail: f"{count}{name}{arguments}{tail}",
    st.one_of(st.just(""), st.sampled_from(["2*", "0*", "1e9*", "1000000000*", "-1*", "2 * ", "9" * 5000 + "*"])),
    NAMES,
    st.lists(ARGUMENT, max_size=3).map(lambda a: "(" + ", ".join(a) + ")"),
    st.sampled_from(["", ")", " ", "\n", "+", "("]),
)
MODELS = st.one_of(st.text(max_size=30), st.lists(TERM, max_size=4).map(" + ".join))
FEW = settings(max_examples=150, suppress_health_check=list(HealthCheck))


def read_or_refused(content: Any) -> None:
    started = time.process_time()
    try:
        model = NoiseModel.from_list(content, "rad/s")
    except InputError as error:
        assert len(str(error)) < 2000
    else:
        assert len(model) <= MOST_PROCESSES
        # what was read is written, and read again as the same
        if all(p.specified for p in model):
            again = NoiseModel.from_list(model.to_list("rad/s"), "rad/s")
            assert [p.symbol for p in again] == [p.symbol for p in model]
        str(model)
    assert time.process_time() - started < 2.0


@FEW
@given(MODELS)
def test_text(text: str) -> None:
    read_or_refused(text)


@FEW
@given(st.one_of(st.lists(st.one_of(NAMED, VALUES), max_size=4), VALUES))
def test_plain_data(content: Any) -> None:
    read_or_refused(content)


@pytest.mark.parametrize(
    "content",
    [
        "1000000000*GM()",
        "9" * 5000 + "*GM()",
        "AR(999999999)",
        "AR(" + "9" * 5000 + ")",
        "AR(ar=[" + "1," * 100000 + "1], sigma2=1)",
        "GM(" * 5000,
        "+".join(["WN()"] * 100000),
        [{"process": "AR", "order": 10**9}],
        [{"process": "ARMA", "order": [1, 2, 3]}],
        [{"process": "ARMA", "order": []}],
        [{"process": "ARMA", "order": [2]}],
        [{"process": ["GM"]}],
        [{"process": {"a": 1}}],
        [{"process": "GM", "sigma": {"a": 1}, "beta": 1}],
        [{"process": "GM", "sigma": 10**400, "beta": 1}],
        [{"process": "GM", 3: 1}],
        [{"process": "WN", "N": "1e-3 rad/s/sqrt(Hz)"}] * 100000,
        [{"process": "AR1", "phi": 0.5, "sigma2": 1.0, "rate_hz": -1}],
        [{"process": "AR", "ar": [0.5], "sigma2": 1.0, "rate_hz": 0}],
        [{"process": "WN", "N": b"1"}],
        {"process": "WN"},
        None,
        3,
    ],
    ids=lambda c: str(c)[:40],
)
def test_refused_at_once(content: Any) -> None:
    started = time.process_time()
    with pytest.raises(InputError) as refused:
        NoiseModel.from_list(content, "rad/s")
    assert time.process_time() - started < 2.0
    assert len(str(refused.value)) < 2000


def test_limits_are_allowed() -> None:
    assert len(NoiseModel.parse(f"{MOST_PROCESSES}*GM()")) == MOST_PROCESSES
    assert NoiseModel.parse(f"AR({MOST_ORDERS})").processes[0].order == MOST_ORDERS


def test_a_product_is_limited_in_python_too() -> None:
    with pytest.raises(InputError, match="processes"):
        10**9 * PROCESSES["GM"]()
