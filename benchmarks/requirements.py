"""Answers of ``insemu require`` against full Monte Carlo, what they cost, and outage figures that makers and papers print.

Run: .venv/bin/python -m benchmarks.requirements [--triples N] [--realizations N] [--times] [--printed]
Each row prints what was asked for, whether it is met, and the numbers behind it.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from insemu import yamlfile
from insemu.compiled import own_folder
from insemu.require import DOUBTFUL, Question, Sensor, completed, flights, quantile, require, scenario_of, wish_of
from insemu.scenario import Scenario, validated
from insemu.sensors import card, names, of_text

TRACKS = ("urban_drive_1", "urban_motorway", "helicopter_mapping", "lemniscate", "turbulent_uav")
SECONDS = (10, 20, 30, 60)
#: Metres agree within this share; a limit is drawn within this factor of what is predicted.
WITHIN, FACTOR = 0.15, 3.0
#: Part of each track that is flown, s.
LONGEST = 300.0
#: Printed outage figures, and units that are drawn of each type.
PRINTED, UNITS = Path(__file__).parents[1] / "docs" / "printed_outages.yaml", 40


def row(what: str, met: bool, said: str) -> None:
    print(f"{'met ' if met else 'OPEN'} {what}: {said}", flush=True)


def triples(count: int, realizations: int, only: set[int]) -> None:
    """Random cards, tracks and outages: the 95 % error of the linear answer beside that of flights of the full filter."""
    rng = np.random.default_rng(66)
    sensors = completed([Sensor.of_card(card(name)) for name in names()])
    near = same = trusted = done = 0
    for k in range(count):
        sensor, track, seconds = (
            sensors[rng.integers(len(sensors))],
            TRACKS[rng.integers(len(TRACKS))],
            SECONDS[rng.integers(len(SECONDS))],
        )
        limit = float(np.exp(rng.uniform(-1.0, 1.0) * np.log(FACTOR)))
        if only and k + 1 not in only:
            continue
        path = Path(tempfile.gettempdir()) / "triple.yaml"
        wish = replace(wish_of(track), longest=LONGEST)
        question = Question([f"planimetric < 1 m after {seconds} s"], wish, path)
        _, covariance, attitude = question.errors([sensor])
        C, doubtful = covariance[0, 0], attitude[0] > DOUBTFUL
        flown = np.linalg.norm(flights(question, sensor, realizations, k + 1)[..., :2], axis=-1)
        starts = question.track.t[question.track.starts(seconds)]
        scenario = validated(Scenario, yamlfile.parse(scenario_of(question, sensor), str(path)))
        at = [int(np.argmin(np.abs(starts - outage.start_s))) for outage in scenario.gnss.outages]
        linear, full = float(question.requirements[0].error(C[at])), float(np.quantile(flown, 0.95))
        rms = float(np.sqrt(np.trace(C[at][:, :2, :2], axis1=1, axis2=2).mean())) / float(np.sqrt((flown**2).mean()))
        good, alike = abs(linear / full - 1.0) <= WITHIN, (full <= linear * limit) == (limit >= 1.0)
        done += 1
        trusted += not doubtful
        near += good and not doubtful
        same += alike or doubtful  # whose verdict is that of flights
        said = [w for w, on in (("doubtful", doubtful), ("OUTSIDE", not good), ("OTHER CHOICE", not alike)) if on]
        print(
            f"  {k + 1:2} {sensor.name:14} {track:18} {seconds:3} s: 95 % {linear:8.3g} m, flights {full:8.3g} ({linear / full:.2f}); "
            f"rms ({rms:.2f}) {', '.join(said)}",
            flush=True,
        )
    said = f"{near} of {trusted}; the other {done - trusted} of {done} are called doubtful and flown"
    row(f"metres within {WITHIN:.0%} of {realizations} flights", near >= 0.95 * trusted, said)
    said = f"{same} of {done}, limits within a factor of {FACTOR:g} of what is predicted"
    row("the same choice", same >= 0.95 * done, said)


def printed() -> None:
    """Outage figures of makers and papers beside what the units' own figures predict, with what 95 % of units and outages keep."""
    rng = np.random.default_rng(66)
    entries = yamlfile.read(PRINTED).data
    sensors = completed([Sensor.of_card(card(name)) for name in names()])
    near = inside = count = 0
    for entry in entries:
        known = next((s for s in sensors if s.name == entry.get("card")), None)
        sensor = known or Sensor.of_card(of_text(entry["figures"]))
        spread = np.exp(sensor.spread * rng.standard_normal((UNITS, len(sensor.spread))))
        units = [sensor, *(replace(sensor, values=sensor.values * factor) for factor in spread)]
        for outage in entry["outages"]:
            wish = replace(wish_of(outage["track"], fixes=entry["fixes"]), longest=2 * LONGEST)
            question = Question(
                [f"planimetric < 1 km after {outage['seconds']} s"], wish, Path(tempfile.gettempdir()) / "printed.yaml"
            )
            C = question.errors(units)[1][:, 0, :, :2, :2]
            values = np.maximum(np.linalg.eigvalsh(C), 0.0)
            if outage["of"] == "one":
                found = [quantile(values[None, 0, :, 1], values[None, 0, :, 0], 0.5)[0]]
                whole = values.reshape(1, -1, 2)
                found += [quantile(whole[..., 1], whole[..., 0], share)[0] for share in (0.025, 0.975)]
            else:
                # the mean of the length is that of the rms times a factor between sqrt(2/pi) and sqrt(pi)/2: the middle of both
                each = np.sqrt(values.sum(axis=2).mean(axis=1)) * (1.0 if outage["of"] == "rms" else 0.84)
                found = [each[0], *np.quantile(each, (0.025, 0.975))]
            ratio, held = found[0] / outage["metres"], found[1] <= outage["metres"] <= found[2]
            count, near, inside = count + 1, near + (1 / 1.5 <= ratio <= 1.5), inside + held
            print(
                f"  {entry['unit']:22} {outage['seconds']:4} s {outage['of']:5} printed {outage['metres']:6.4g} m, predicted {found[0]:6.3g} "
                f"({found[1]:.3g} to {found[2]:.3g}){'' if held else '  OUTSIDE'}"
            )
    row(
        "30 printed figures of 8 units",
        count >= 30,
        f"{count} of {len({e['unit'].split(' (')[0] for e in entries})} units",
    )
    row("within a factor of 1.5 in 80 %", near >= 0.8 * count, f"{near} of {count}")
    row("intervals hold in 90 %", inside >= 0.9 * count, f"{inside} of {count}")


def times() -> None:
    """CPU seconds of a query in this process, kernels compiled: on a new track, on one seen before, and of one point more."""
    asked, path = ["planimetric < 10 m at 95 % after 30 s"], Path(tempfile.gettempdir()) / "time.yaml"
    require(asked, wish_of("lemniscate"), path)
    shutil.rmtree(own_folder() / "require")
    spent = []
    for _ in range(2):
        begun = time.process_time()
        require(asked, wish_of("urban_motorway"), path)
        spent.append(time.process_time() - begun)
    row("a query on a new track", spent[0] <= 5.0, f"{spent[0]:.2f} CPU s")
    row("on one seen before", spent[1] <= 1.0, f"{spent[1]:.2f} CPU s")
    question = Question(asked, wish_of("urban_motorway"), path)
    sensor = Sensor.of_card(card("STIM300"))
    begun = time.process_time()
    question.errors([replace(sensor, values=sensor.values * (1.0 + 0.01 * k)) for k in range(16)])
    point = (time.process_time() - begun) / 16
    row("a point more", point <= 0.3, f"{point:.3f} CPU s")


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--triples", type=int, default=0)
    parser.add_argument("--realizations", type=int, default=100)
    parser.add_argument("--only", type=int, nargs="*", default=[], help="numbers of the triples that are flown")
    parser.add_argument("--printed", action="store_true")
    parser.add_argument("--times", action="store_true")
    given = parser.parse_args()
    if given.triples:
        triples(given.triples, given.realizations, set(given.only))
    if given.printed:
        printed()
    if given.times:
        times()


if __name__ == "__main__":
    main()
