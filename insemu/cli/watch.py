"""``insemu watch``: a noise model together with a stream, with alarms where a window differs from those before."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING

import typer

from insemu import units
from insemu.cli.logs import column_names, hertz
from insemu.cli.options import DRAWS, Arguments, argument, option
from insemu.units import parse_unit

if TYPE_CHECKING:
    import numpy as np

    from insemu.fit import Alarm, Update
    from insemu.records import Series

    Pieces = Iterator[list[np.ndarray]]


class WatchArguments(Arguments):
    """Of ``insemu watch``."""

    file: str = argument(
        "LOG", "Log at rest; - reads lines of CSV from standard input as they come (header with units)."
    )
    model: str = option("--model", ...)
    window: str = option("--window", "60 s")
    false_alarms: float = option("--false-alarm", 1e-3, "Probability that a window of an axis alarms wrongly.")
    learn: int = option("--learn", 10, min=1, max=DRAWS)
    every: int = option("--every", 10, min=1, max=DRAWS)
    columns: list[str] | None = option("--columns", None)
    rate: str = option("--rate", "")
    as_json: bool = option("--json", False, "A line of JSON per fit and alarm.")


def command(args: WatchArguments) -> None:
    """Watch a signal: the noise model with intervals as it is learnt, and alarms at a stated rate of false ones."""
    from insemu.fit import OnlineFit
    from insemu.noise import NoiseModel

    read = _standard_input if args.file == "-" else partial(_file, args.file)
    series, pieces = read(hertz(args.rate), args.columns)
    watched = [
        OnlineFit(
            NoiseModel.parse(args.model, s.unit),
            s.rate_hz,
            window_s=units.parse(args.window, "s"),
            false_alarms=args.false_alarms,
            learn=args.learn,
            every=args.every,
            unit=s.unit,
            name=s.name,
        )
        for s in series
    ]
    alarms = 0
    for piece in pieces:
        for one, values in zip(watched, piece, strict=True):
            for event in one.push(values):
                alarms += _tell(one.name, event, args.as_json)
    if not args.as_json:
        typer.echo(f"{alarms} alarms; {args.false_alarms:g} of the windows of an axis alarm without a cause", err=True)


def _file(file: str, rate_hz: float | None, columns: list[str] | None) -> tuple[list[Series], Pieces]:
    """The axes of a log, and its samples in pieces."""
    from insemu.logs import open_log

    series = open_log(file, rate_hz, column_names(columns)).series(gaps=True)
    step = 1 << 16
    return series, ([s.values[k : k + step] for s in series] for k in range(0, len(series[0]), step))


def _standard_input(rate_hz: float | None, columns: list[str] | None) -> tuple[list[Series], Pieces]:
    """The axes of lines of CSV, and their samples line by line."""
    import sys
    from itertools import chain

    import numpy as np

    from insemu.errors import InputError, nearest
    from insemu.formats import AXIS_OF_COLUMN, round_rate, split_header
    from insemu.records import Series
    from insemu.sample_times import beat

    def row(line: str, number: int) -> list[float]:
        cells = line.split(",")
        try:
            values = [float(c) if c.strip() else np.nan for c in cells]
        except ValueError:
            raise InputError(f"found '{line.strip()[:60]}', expected numbers", where=f"-:{number}") from None
        if len(values) != len(head):
            raise InputError(f"found {len(values)} cells, expected {len(head)}", where=f"-:{number}")
        return values

    first = sys.stdin.readline()
    head = [split_header(cell.strip()) for cell in first.split(",")]
    if not first.strip() or any(not name or name[0] in "0123456789+-." for name, _ in head):
        raise InputError("expected a header such as 't [s],gx [deg/s]'", where="-:1")
    time = next((k for k, (name, _) in enumerate(head) if name.lower() in ("t", "time", "timestamp")), None)
    keep = [k for k in range(len(head)) if k != time]
    names = [AXIS_OF_COLUMN.get(head[k][0], head[k][0]) for k in keep]
    wanted = column_names(columns)
    for w in wanted or []:
        if AXIS_OF_COLUMN.get(w, w) not in names:
            raise InputError(f"has no column '{w}'" + nearest(w, names), where="-")
    if wanted:
        chosen = {AXIS_OF_COLUMN.get(w, w) for w in wanted}
        keep, names = [k for k, n in zip(keep, names, strict=True) if n in chosen], [n for n in names if n in chosen]
    lines = ((row(line, n), n) for n, line in enumerate(sys.stdin, start=2) if line.strip())
    begun: list[list[float]] = []
    if rate_hz is None:
        if time is None:
            raise InputError("says no sampling rate; give one (--rate '100 Hz'), or a time column", where="-")
        while len(begun) < 100 and (got := next(lines, None)) is not None:
            begun.append(got[0])
        stamps = np.array([r[time] for r in begun]) * (parse_unit(head[time][1]).factor if head[time][1] else 1.0)
        step = beat(stamps)
        if not step > 0.0:
            raise InputError("the time column does not rise", where="-")
        rate_hz = round_rate(1.0 / step)
    factor = np.array([parse_unit(head[k][1]).factor if head[k][1] else 1.0 for k in keep])
    si = {"gyro": "rad/s", "accel": "m/s^2"}
    series = [Series(np.zeros(3), rate_hz, si.get(n.partition("_")[0], ""), n) for n in names]
    rows = chain(begun, (r for r, _ in lines))
    return series, ([np.array([v]) for v in np.array(r)[keep] * factor] for r in rows)


def _tell(name: str, event: Update | Alarm, as_json: bool) -> int:
    """Print one event; 1 for an alarm."""
    import json
    import math

    from insemu.fit import Update

    if isinstance(event, Update):
        found = event.result
        if as_json:
            plain = {"event": "fit", "axis": name, "t_s": event.t_s, "windows": event.windows}
            typer.echo(json.dumps(plain | {"parameters": found.to_json()["parameters"]}, allow_nan=False))
        else:
            said = ", ".join(f"{e.label} {e.value:.4g} ({e.low:.4g} … {e.high:.4g}) {e.unit}" for e in found.parameters)
            typer.echo(f"{event.t_s:10.1f} s  {name}: {said}")
        return 0
    if as_json:
        numbers = {"tau_s": event.tau_s, "ratio": event.ratio, "p_value": event.p_value}
        known = {k: v if math.isfinite(v) else None for k, v in numbers.items()}
        typer.echo(json.dumps({"event": event.kind, "axis": name, "t_s": event.t_s} | known, allow_nan=False))
    elif event.kind == "missing":
        typer.echo(f"{event.t_s:10.1f} s  {name}: samples are missing")
    else:
        words = {
            "level": "alarm, another level",
            "outliers": "alarm, outliers",
            "change": "changed for good, learnt anew",
        }
        typer.echo(
            f"{event.t_s:10.1f} s  {name}: {words[event.kind]}: {event.ratio:.3g} times the variance at {event.tau_s:.3g} s (p {event.p_value:.1g})"
        )
    return int(event.kind != "missing" and event.kind != "change")
