"""The page of a solved recording: what to take, what a minute without GNSS costs, map, time plots, calibration."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from insemu import earth, rotation
from insemu.report.charts import GREY, INK, RED, Chart, Line, View
from insemu.report.experiment_charts import colour
from insemu.report.page import Card, Folded, Items, Page, Section, Table, Text
from insemu.report.tables import short
from insemu.solve import KNOWS, Comparison, Outages, Scored, Solution, worst_outages
from insemu.units import datasheet

#: Epochs of a chart at most.
MOST_EPOCHS = 1500


def solve_answer(s: Solution) -> str:
    """What an engineer reads first: what is suspect, which design, how far off, whether it knows."""
    o = s.taken.outages
    parts = [f"{_metres(o, k)} after {o.horizons[k]:g} s" for k in range(o.horizons.size) if np.isfinite(o.rms(k))]
    suspect = [
        f"{a.replace('_', ' ')} errs by {f'{short(v)} times what its samples scatter' if np.isfinite(v) else 'noise that its samples do not show'}"
        for a, v in s.suspects.items()
    ]
    first = f"Look at the recording first: {'; '.join(suspect)}. " if suspect else ""
    take = f"Take {s.taken.candidate.name}: {', '.join(parts)} without GNSS (rms), and {_knows(s.taken)}."
    left = "".join(f" {said[0].upper()}{said[1:]}." for said in s.drive.left_out)
    return f"{first}{take}{left}"


def _metres(o: Outages, k: int) -> str:
    """The rms after an outage, or what it is below where the fixes' own scatter hides it."""
    low, high = o.interval(k)
    return f"below {short(high)} m" if low == 0.0 and high > 0.0 else f"{short(o.rms(k))} m"


def _knows(s: Scored) -> str:
    if np.isnan(s.factor):
        return "the recording is too short for an outage"
    if s.factor == 1.0:
        return "it knows its error"
    more = s.factor if s.factor > 1.0 else 1.0 / s.factor
    return f"it is {'optimistic' if s.factor > 1.0 else 'pessimistic'} by a factor of {short(more)}"


def solve_rows(tried: Sequence[Scored]) -> tuple[list[str], list[list[str]]]:
    """Header and rows of the table of designs."""
    horizons = tried[0].outages.horizons
    known = [k for k in range(horizons.size) if any(np.isfinite(s.outages.rms(k)) for s in tried)]
    header = ["design", "states", "NIS/dof", "GNSS sigma x"]
    header += [f"{what} {horizons[k]:g} s" for k in known for what in ("rms m", "stated")] + ["NEES/dof", "log score"]
    rows = []
    for s in tried:
        o, c = s.outages, s.candidate
        last = max((k for k in range(o.horizons.size) if np.isfinite(o.rms(k))), default=0)
        cells = [short(v) for k in known for v in (o.rms(k), o.stated(k))]
        factor = short(c.position) + (f", {short(c.velocity)}" if s.run.fixes.dof.max(initial=0) > 3 else "")
        rows.append([c.name, str(s.run.layout.n), short(s.nis), factor, *cells, short(o.nees(last)), f"{s.score:.2f}"])
    return header, rows


def outage_rows_of(o: Outages) -> tuple[list[str], list[list[str]]]:
    """Header and rows of the score: one row per length."""
    header = ["without GNSS", "rms m", "95 % of the rms", "stated m", "NEES/dof", "median m", "95 % below m", "outages"]
    rows = []
    for k, seconds in enumerate(o.horizons):
        count = int(np.isfinite(o.error[:, k, 0]).sum())
        if not count:
            continue
        (middle, high), (a, b) = o.quantiles(k), o.interval(k)
        spread = f"{short(a)} to {short(b)}" if np.isfinite(a) else "too short to say"
        values = [short(o.rms(k)), spread, short(o.stated(k)), short(o.nees(k)), short(middle), short(high)]
        rows.append([f"{seconds:g} s", *values, str(count)])
    return header, rows


def compared_rows(found: Comparison) -> tuple[list[str], list[list[str]]]:
    """Header and rows of the solution against the designs of a scenario, at the same outages; ratios of the rms with 95 % intervals."""
    o = found.solved
    header = [
        "design",
        *(f"{what} {h:g} s" for what in ("rms m", "over solved's", "median m") for h in o.horizons),
        "NEES/dof at the last",
    ]
    rows = []
    for name, one in (("solved", o), *found.designs.items()):
        last = max((k for k in range(o.horizons.size) if np.isfinite(one.rms(k))), default=0)
        every = range(o.horizons.size)
        ratios = [(np.nan,) * 3 if one is o else one.ratio(o, k) for k in every]
        cells = [
            *(short(one.rms(k)) for k in every),
            *(f"{r:.2f} ({low:.2f} to {high:.2f})" if np.isfinite(r) else "" for r, low, high in ratios),
            *(short(one.quantiles(k)[0]) for k in every),
        ]
        rows.append([name, *cells, short(one.nees(last))])
    return header, rows


def calibration_lines(s: Solution) -> list[str]:
    """What was found of clock, lever arm, mounting and the fixes' noise, in words."""
    late, sigma = s.clock
    out = [_biases("gyroscope", s), _biases("accelerometer", s)]
    out += [f"clock: the stamps of the IMU are {late:+.4f} s late against the fixes (sigma {sigma:.4f} s)"]
    states = {n: (v, sd, b) for n, v, sd, b in s.estimated}
    arm = [states.get(f"lever_arm_{a}") for a in "xyz"]
    if all(a is not None for a in arm):
        at = [f"{g + a[0]:+.3f} (sigma {a[1]:.3f})" for g, a in zip(s.drive.lever_arm, arm, strict=True) if a]
        out.append(f"lever arm, IMU to antenna in the axes of the IMU: {', '.join(at)} m")
    else:
        out.append(f"lever arm as given: {', '.join(f'{v:g}' for v in s.drive.lever_arm)} m")
    if s.mounting is not None:
        angles = [
            f"{a:.2f} (sigma {b:.2f})" for a, b in zip(*np.rad2deg([s.mounting.rpy, s.mounting.sigma]), strict=True)
        ]
        out.append(
            f"mounting, IMU to vehicle, of a vehicle that moves forward: roll, pitch, yaw {', '.join(angles)} deg"
        )
    else:
        out.append(
            "mounting: the velocity keeps no direction in the IMU's axes (flight with wind, a boat) or is too slow; not estimated"
        )
    c = s.taken.candidate
    position, velocity = s.drive.scatter
    of = f"the {'assumed' if 'positions' in s.drive.assumed else 'stated'} standard deviations of the positions"
    out.append(
        f"the fixes scatter by {short(position)} times {of}"
        + (f", {short(velocity)} times those of the velocities" if s.drive.gnss.vel_std_ned is not None else "")
    )
    out.append(f"believed noise of the fixes: {short(c.position)} times {of}")
    if s.drive.gnss.vel_std_ned is not None:
        out[-1] += f", {short(c.velocity)} times those of the velocities"
    return out


def _biases(sensor: str, s: Solution) -> str:
    """Biases of the three axes at the end, whole, and what of them was taken off before the filter began."""
    own = [v for a, v in s.biases.items() if a.startswith(sensor[:4])]
    factor, unit = datasheet(1.0, "rad/s" if sensor == "gyroscope" else "m/s^2")
    text = ", ".join(f"{factor * b:.4g} (sigma {factor * sd:.2g})" for b, sd, _ in own)
    before = [factor * off for *_, off in own]
    taken = f", of which the start found {', '.join(f'{v:.4g}' for v in before)}" if any(before) else ""
    return f"{sensor} biases at the end, x, y, z: {text} {unit}{taken}"


def gap_rows_of(s: Solution) -> tuple[list[str], list[list[str]]]:
    """Header and rows of the gaps of the recording itself."""
    rows = [[f"{g.start / 60.0:.2f}", short(g.seconds), short(g.error), short(g.stated)] for g in s.gaps]
    return ["start min", "s without fixes", "off at the first fix m", "stated m"], rows


def consistency_words_of(s: Solution) -> list[str]:
    """NIS and whiteness in words."""
    first, *lags = s.verdicts
    out = [str(first)]
    bad = [v for v in lags if not v.passed]
    if lags:
        low, high = min(v.value for v in lags), max(v.value for v in lags)
        what = f"correlated at {len(bad)} of {len(lags)} lags" if bad else "white"
        out.append(
            f"innovations {what} (mean products at lags 1 to {len(lags)} {low:.2g} to {high:.2g}, bound {lags[0].high:.2g})"
        )
    return out


def _map(s: Solution) -> Chart:
    nav = s.smoothed.nav
    plan = earth.llh_to_ned(nav[:, :3], nav[0, :3])[:, [1, 0]]
    fixes = earth.llh_to_ned(s.drive.gnss.llh, nav[0, :3])[:, [1, 0]]
    step, few = max(1, len(plan) // MOST_EPOCHS), max(1, len(fixes) // MOST_EPOCHS)
    t = s.smoothed.t
    lines = [
        Line("fixes", fixes[::few, 1], GREY, points=True, width=1.5, x=fixes[::few, 0], t=s.drive.gnss.t[::few] / 60.0),
        Line("solution", plan[::step, 1], INK, x=plan[::step, 0], t=t[::step] / 60.0),
    ]
    labels = [(float(plan[0, 0]), float(plan[0, 1]), "start")]
    for start, seconds, error in worst_outages(s.taken.outages, 3):
        inside = (t >= start) & (t <= start + seconds)
        label = f"{short(error)} m off after {seconds:g} s"
        lines.append(Line(label, plan[inside, 1], RED, width=3.5, x=plan[inside, 0], t=t[inside] / 60.0))
        east, north = plan[inside][-1]
        labels.append((float(east), float(north), f"{short(error)} m"))
    return Chart(
        "Map",
        "The smoothed way, the fixes, and in red the outages that cost most. The cursor of the charts over time is shown here.",
        None,
        "east of the start (m)",
        [View("Way", "north of the start (m)", lines, labels=labels)],
        equal=True,
    )


def charts_over_time(s: Solution) -> list[Chart]:
    """What outages cost by their start, the motion, and the stated standard deviations."""
    t, nav, sigma = s.smoothed.t, s.smoothed.nav, s.smoothed.sigma
    at = np.arange(0, t.size, max(1, t.size // MOST_EPOCHS))
    minutes, deg = t[at] / 60.0, 180.0 / np.pi
    rpy = np.unwrap(rotation.rpy_from_quaternion(nav[at, 6:10]), axis=0) * deg

    def three(values: np.ndarray, names: Sequence[str]) -> list[Line]:
        return [Line(n, values[:, k], colour(k)) for k, n in enumerate(names)]

    ned = ("north", "east", "down")
    motion = [
        View("Velocity", "velocity (m/s)", three(nav[at, 3:6], ned)),
        View("Attitude of the IMU", "angle (deg)", three(rpy, ("roll", "pitch", "heading"))),
        View("Height", "height (m)", [Line("height", nav[at, 2], colour(0))]),
    ]
    spread = [
        View("Position", "sigma (m)", three(sigma[at, :3], ned), log_y=True),
        View("Velocity", "sigma (m/s)", three(sigma[at, 3:6], ned), log_y=True),
        View(
            "Attitude",
            "sigma (deg)",
            three(sigma[at, 6:9] * deg, ("about north", "about east", "about down")),
            log_y=True,
        ),
    ]
    o = s.taken.outages
    size = np.hypot(o.error[:, :, 0], o.error[:, :, 1])
    stated = np.sqrt(np.einsum("khii->kh", o.covariance))
    costs = [
        View(
            f"After {h:g} s",
            "horizontal error (m)",
            [Line("error", size[:, k], colour(0)), Line("stated sigma", stated[:, k], INK, dashed=True)],
            log_y=True,
        )
        for k, h in enumerate(o.horizons)
        if np.isfinite(size[:, k]).any()
    ]
    return [
        Chart("Outages", "The error after an outage that begins at the time on the axis, and what the filter states.", o.start / 60.0,
              "start of the outage (min)", costs),
        Chart("Motion", "The smoothed trajectory.", minutes, "time (min)", motion),
        Chart("Standard deviations", "What the smoother states.", minutes, "time (min)", spread),
    ]  # fmt: skip


def _unit_of(state: str) -> str:
    """SI unit of a state by its name; none where the name does not tell."""
    axis, _, part = state.partition(".")
    if part.startswith(("RW", "GM", "BI", "RC")):
        return "rad/s" if axis.startswith("gyro") else "m/s^2"
    if part.startswith("from_"):
        return "rad"
    return "m" if state.startswith("lever_arm") else "s" if state == "latency" else ""


def _states(s: Solution) -> Table:
    rows = []
    for name, *values, begun in s.estimated:
        factor, unit = datasheet(1.0, _unit_of(name))
        value, sigma, start = (factor * v for v in (*values, begun))
        learned = f"{1 - sigma / start:.0%}" if start > 0 else "-"
        rows.append([name, f"{value:.4g}", f"{sigma:.3g}", f"{start:.3g}", unit, learned])
    caption = "At the end of the recording. Learned: by how much the standard deviation shrank."
    return Table(["state", "estimate", "sigma", "sigma at the start", "unit", "learned"], rows, caption)


def render_solution(
    s: Solution, folder: Path, compared: Comparison | None = None, scenario: str = "", more: Sequence[Section] = ()
) -> Path:
    """Write ``index.html`` and its figures.

    Parameters
    ----------
    s : Solution
    folder : path
    compared : Comparison, optional
        With the designs of a scenario.
    scenario : str
        Its name.
    more : sequence of Section
        Of the same recording.

    Returns
    -------
    Path
        The page.
    """
    o = s.taken.outages
    where = (
        "Errors are against the fixes that each outage withheld, at the antenna, less their own scatter. Where the fixes come "
        "from a receiver that fuses an IMU itself, they are a dependent reference. Outages overlap: the interval is by a moving-block bootstrap. "
        "The design was chosen on the same recording, by the logarithmic score of outages five seconds apart."
    )
    sections = [
        Section(
            "Without GNSS",
            [
                Table(*outage_rows_of(o), "An outage begins at every second at which a fix was used."),
                *([Table(*gap_rows_of(s), "Times without fixes in the recording itself.")] if s.gaps else []),
                Text(where),
                charts_over_time(s)[0],
            ],
        ),
        Section("Map", [_map(s)]),
        Section(
            "Designs",
            [Table(*solve_rows(s.tried), "The best first; outages five seconds apart.", left=1, strong=frozenset({0}))],
        ),
    ]
    if compared is not None:
        sections.append(
            Section(
                f"Against {scenario}",
                [
                    Table(
                        *compared_rows(compared),
                        "The same outages; ratios of the rms with 95 % intervals.",
                        left=1,
                        strong=frozenset({0}),
                    )
                ],
            )
        )
    sections += [
        *more,
        Section("Calibration", [Items(calibration_lines(s)), _states(s)]),
        Section("Over time", charts_over_time(s)[1:]),
        Section("Does it know its error?", [Items(consistency_words_of(s))]),
        Section(
            "What was taken",
            [
                Items([str(line) for line in s.card.lines if line.level != "ok"]),
                Folded("Everything", [Items([*s.drive.remarks, *(str(line) for line in s.card.lines)])]),
            ],
        ),
    ]
    cards = [
        Card(
            f"{h:g} s without GNSS",
            _metres(o, k),
            "knows its error"
            if KNOWS[0] <= o.nees(k) <= KNOWS[1]
            else "optimistic"
            if o.nees(k) > 1
            else "pessimistic",
            "good" if KNOWS[0] <= o.nees(k) <= KNOWS[1] else "warn",
            [f"stated {short(o.stated(k))} m; half of the outages below {short(o.quantiles(k)[0])} m"],
        )
        for k, h in enumerate(o.horizons)
        if np.isfinite(o.rms(k))
    ]
    late, sigma = s.clock
    cards.append(Card("Clock", f"{late:+.3f} s", f"IMU late, sigma {sigma:.3f} s"))
    return Page(
        f"Solved: {Path(s.drive.source.split(',')[0]).name}",
        sections,
        kind="solve",
        source=s.drive.source,
        answer=solve_answer(s),
        lead=f"{s.drive.aligned.t:.0f} to {s.drive.imu.t[-1]:.0f} s, {len(s.drive.gnss)} fixes.",
        cards=cards,
    ).write(folder / "index.html", pictures=True)
