"""Text and plain data of models, units, effects, column maps and sensor figures."""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from insemu import units
from insemu.effects import EFFECTS, EffectUse
from insemu.errors import InputError
from insemu.formats import parse_map
from insemu.formats.columns import guess_map, split_header
from insemu.noise import PROCESSES, NoiseModel
from insemu.noise.grammar import MOST_PROCESSES
from insemu.sensors import of_text, read_figures

_PARAMETERS = sorted({p.name for c in PROCESSES.values() for p in c.PARAMETERS})
_KEYS = (*_PARAMETERS, "ar", "ma", "order", "rate_hz", "Tc", "q", "p", "process", "", "x")
_TOKENS = (
    "deg", "rad", "s", "h", "m", "g", "mg", "ug", "\u00b5g", "Hz", "sqrt(Hz)", "rtHz", "\u221aHz", "\u00b0", "ppm", "%", "dps", "mdps", "LSB", "K",
    "degC", "ns", "us", "knots", "mph", "kg", "arcsec", "rad s^-1", "/", "*", "^", "^-1", "^2", "^(1/2)", "^(1/0)", "^1e9", "^-999999999999", "(",
    ")", "sqrt(", "**", " ", "\u00b7", "\u207b\u00b9", "\u00b2", "1", "e", "-", "",
)  # fmt: skip
_NUMBERS = (
    "0",
    "1",
    "-1",
    "1e-3",
    "1e308",
    "1e999",
    "-1e999",
    "nan",
    "inf",
    "0.5",
    ".5",
    "5.",
    "1_0",
    "0x1",
    "1,5",
    "\u0661",
    "9" * 400,
    "1e-400",
    "+-1",
    "1e",
    "1.0.0",
    "NaN",
    "-0",
)
_UNITS = ("rad/s", "m/s^2", "s", "Hz", "rad", "m", "", "K", "rad/s/sqrt(Hz)", "m/s/sqrt(s)")
_WORDS = (
    "ARW", "VRW", "angle random walk", "in-run bias stability", "bias instability", "noise density", "gyro", "accel", "gyroscope:",
    "accelerometer:", "RRW", "Tc", "typ", "max", "@ 25 degC", ",", ";", "\n", "of", "1 sigma", "range", "Allan",
)  # fmt: skip
_CLAUSES = (
    "ARW {} deg/sqrt(h)", "VRW {} m/s/sqrt(h)", "in-run bias stability {} deg/h", "RRW {} deg/h/sqrt(h)", "B = {} deg/h",
    "gyro noise density {} dps/rtHz", "accelerometer: bias instability {} ug", "noise density {} ug/\u221aHz typ, 2 ug/\u221aHz max", "ARW 0.3 {}",
    "correlation time {} s",
)  # fmt: skip
_ROLES = (
    "gyro", "accel", "time", "lat", "lon", "height", "rate", "axes", "kind", "zero", "vel", "gyro_x", "temperature", "", "leap",
)  # fmt: skip
_NAMES = (
    "omega_x",
    "a_y",
    "stamp",
    "lat[rad]",
    "gyr.z [deg/s]",
    "((((((((((",
    "t",
    "ax",
    "*",
    "omega_*[deg/s]",
    "[[[[[",
    "x]y[",
    '"a,b"',
    "\u03c9x",
    "time (ns)",
    "Latitude",
    "col3",
    "1",
    "-",
    "acc z",
    "_" * 300,
    "a" * 5000,
)


def _quantity(rng: random.Random) -> str:
    unit = "".join(rng.choice(_TOKENS) for _ in range(rng.randrange(7)))
    if rng.random() < 0.02:
        unit = rng.choice(("(", "sqrt(", "m^", "deg/", "((m)")) * rng.choice((50, 400, 4000))
    return rng.choice(_NUMBERS) + rng.choice((" ", "", "  ")) + unit


def _value(rng: random.Random, depth: int = 0) -> Any:
    kind = rng.randrange(9 if depth < 3 else 7)
    if kind < 3:
        return _quantity(rng)
    if kind < 5:
        return rng.choice(
            (0, 1, -3, 0.5, 1e-6, 1e308, -1e308, float("nan"), float("inf"), 10**400, -(2**70), 2**63, 5e-324)
        )
    if kind < 7:
        return rng.choice((None, True, False, b"1", "", "x", "z", "gyro", "1e-3", rng.choice(_NUMBERS)))
    if kind == 7:
        return [_value(rng, depth + 1) for _ in range(rng.randrange(5))]
    return {rng.choice((*_KEYS, 3, None)): _value(rng, depth + 1) for _ in range(rng.randrange(4))}


def _term(rng: random.Random) -> str:
    count = rng.choice(("", "", "", "2*", "0*", "1e9*", "1000000000*", "-1*", "2 * ", "9" * 5000 + "*"))
    name = rng.choice((*PROCESSES, "ARW", "RRW", "VRW", "gm", "ZZ", ""))
    arguments = []
    for _ in range(rng.randrange(4)):
        value = rng.choice((_quantity(rng), str(rng.choice(_NUMBERS)), str([0.5, 2])))
        arguments.append(value if rng.random() < 0.2 else f"{rng.choice(_KEYS)}={value}")
    return f"{count}{name}({', '.join(arguments)})" + rng.choice(("", "", "", "", ")", " ", "\n", "+", "("))


def _models(rng: random.Random) -> None:
    if rng.random() < 0.5:
        content: Any = " + ".join(_term(rng) for _ in range(rng.randrange(5)))
        if rng.random() < 0.3 and content:
            k = rng.randrange(len(content))
            content = content[:k] + rng.choice("()+*=,[]{}'\"\u00e9\x00 ") + content[k + rng.randrange(2) :]
    else:
        content = [
            {
                "process": rng.choice((*PROCESSES, _value(rng))),
                **{rng.choice(_KEYS): _value(rng) for _ in range(rng.randrange(4))},
            }
            for _ in range(rng.randrange(4))
        ]
        content = _value(rng) if rng.random() < 0.1 else content
    model = NoiseModel.from_list(content, rng.choice(("rad/s", "m/s^2", "")))
    assert len(model) <= MOST_PROCESSES, "more processes than the limit"
    str(model)
    if all(p.specified for p in model):  # what was read is written, and read again as the same
        again = NoiseModel.from_list(model.to_list("rad/s"), "rad/s")
        assert [p.symbol for p in again] == [p.symbol for p in model], "read again as another"


def _units(rng: random.Random) -> None:
    text, wanted = _quantity(rng), rng.choice(_UNITS)
    if rng.random() < 0.3:
        units.conversion(text.split(" ", 1)[-1], wanted)
    elif rng.random() < 0.2:
        units.parse(_value(rng), wanted)
    else:
        value = units.parse(text, wanted)
        assert np.isfinite(value), f"{text!r} is {value}"


def _effects(rng: random.Random) -> None:
    effect = EFFECTS[rng.choice(sorted(EFFECTS))]
    item: Any = {"effect": effect.id, "sensor": rng.choice(effect.sensors)}
    for p in effect.parameters:
        unit = effect.unit(p.name, item["sensor"])
        usual = [f"{10.0 ** rng.randint(-9, 3):g} {unit}" for _ in range(rng.choice((1, p.size)))]
        item[p.name] = usual[0] if len(usual) == 1 else usual
    for _ in range(rng.randint(0, 2)):
        key = rng.choice((*item, "axes", "sensor", "effect", rng.choice(_KEYS)))
        if rng.random() < 0.2:
            item.pop(key, None)
        else:
            item[key] = rng.choice((_value(rng), rng.choice(sorted(EFFECTS)), ["x", "q"], "gnss"))
    use = EffectUse.from_mapping(_value(rng) if rng.random() < 0.03 else item)
    assert EffectUse.from_mapping(use.to_mapping()) == use, "read again as another"


def _maps(rng: random.Random) -> None:
    parts = [
        f"{rng.choice(_ROLES)}={'/'.join(rng.choice(_NAMES) for _ in range(rng.randint(1, 3)))}"
        for _ in range(rng.randrange(5))
    ]
    text = ", ".join(parts) + rng.choice(("", "", "=", ",", "["))
    header = [
        rng.choice(_NAMES) + rng.choice(("", f" [{_quantity(rng)}]", f"({_quantity(rng)})"))
        for _ in range(rng.randrange(12))
    ]
    guess_map([split_header(cell)[0] for cell in header])
    parse_map(text)


def _cards(rng: random.Random) -> None:
    if rng.random() < 0.5:
        clauses = [rng.choice(_CLAUSES).format(rng.choice(_NUMBERS)) for _ in range(rng.randint(1, 4))]
        _ = of_text(rng.choice((", ", "; ", "\n")).join(clauses))
    words = [rng.choice((rng.choice(_WORDS), _quantity(rng))) for _ in range(rng.randrange(12))]
    (of_text if rng.random() < 0.5 else read_figures)(" ".join(words))


_KINDS: dict[str, Callable[[random.Random], None]] = {
    "models": _models,
    "units": _units,
    "effects": _effects,
    "maps": _maps,
    "cards": _cards,
}


def prepare(what: str, folder: Path) -> Callable[[random.Random], None]:
    """A function that tries one text or mapping."""
    one = _KINDS[what]
    for k in range(3):
        try:
            one(random.Random(k))
        except InputError:
            continue
    return one
