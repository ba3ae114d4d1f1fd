"""Options and arguments of the commands: one spelling, one unit and one meaning each, in one table.

What a command is about is an argument; ``--output`` (``-o``) is what it makes, ``--page`` its HTML page. Quantities are text with their unit.
A command says ``option("--skip", "0 s")``, with words of its own only where the table's do not tell what it does with it.
``tests/test_options.py`` holds every command to the table.
"""

from __future__ import annotations

import os
from typing import Any

import typer

#: Largest counts that an option takes: what is above is a slip of the keyboard, and would end in a lack of memory. Threads or processes; the
#: largest machines have some hundreds of cores.
WORKERS = 1024
#: Flights, recordings, simulated signals or trials; as of a scenario.
DRAWS = 100_000
#: Linear realizations, whose cost is about a hundredth of a flight's.
LINEAR = 1_000_000

#: Argument -> what it means unless a command says more.
ARGUMENTS: dict[str, str] = {
    "RECORDING": "A drive or flight: any file or folder that insemu open reads.",
    "LOG": "Log at rest: .npz, .csv or .npy (columns with units), or what else insemu open reads.",
    "LOG...": "Logs at rest.",
    "SCENARIO": "Scenario file (YAML).",
    "EMULATED": "The emulated one (insemu emulate), or another.",
    "MODEL": "What is believed: a scenario, a belief file or a noise-model file (YAML).",
    "FOLDER": "Folder of results.",
    "FILE": "File.",
    "REFERENCE": "Recording of the better IMU on the same mount.",
    "UNIT": "Recording of the IMU whose errors are wanted.",
    "REQUIREMENT...": "Such as 'planimetric < 1 m at 95 % after 30 s' (planimetric, height, velocity, heading); all have to hold.",
    "ACTION": "What to do.",
    "[FILTER...]": "Names of families or adapters, FILE.py:CLASS, MODULE:CLASS, or folders of another program's estimates.",
    "[FILE]": "File to write.",
    "[NAME]": "Name.",
    "[NAME|FILE|TEXT]": "Name, file or text.",
}

#: Option -> (what follows it, what it means unless a command says more). Nothing follows a switch.
OPTIONS: dict[str, tuple[str, str]] = {
    # what comes in, beside the arguments
    "--gnss": ("FILE", "File with the fixes, where it is a separate one."),
    "--truth": ("FILE", "File with the reference, where it is a separate one."),
    "--map": ("MAP", "Columns and settings, as of `insemu open`."),
    "--gnss-map": ("MAP", "The same for the file of --gnss."),
    "--truth-map": ("MAP", "The same for the file of --truth."),
    "--rate": ("'100 Hz'", "Sampling rate of a log that does not say it."),
    "--trajectory-rate": ("'10 Hz'", "Rate of the trajectory that is written; default 1 Hz."),
    "--span": ("FIRST LAST", "A part of it: first and last time."),
    "--name": ("NAME", "Name in the file; default that of the recording."),
    "--skip": ("'40 min'", "Leave out the start of the record, such as the warm-up."),
    "--columns": ("NAMES", "Only these columns, separated by commas (gx or gyro_x); may be repeated."),
    "--scenario": ("SCENARIO", "Scenario file."),
    "--variant": ("NAME", "Variant of the scenario."),
    "--model": ("STRUCTURE", 'Structure of every axis, such as "2*GM() + WN()"; values that are given are held.'),
    "--models": ("FILE", "Noise models of the axes: the file of `insemu fit -o` or `insemu sensor -o`."),
    "--sensor": ("NAME|FILE", "Sensor card: a name (insemu sensor) or the file of a card."),
    "--designs": ("NAMES", "Designs separated by commas, the scenario's or those of insemu designs."),
    "--worlds": ("NAMES", "Only these worlds, separated by commas."),
    "--known": ("FILE", "What else is known of the drive; its effects are removed first."),
    "--before": ("MODEL", "The nominal model, checked in the same way."),
    "--against": ("SCENARIO", "Score the designs of this scenario by the same outages."),
    "--require": (
        "REQUIREMENT",
        "Such as '95 % < 2 m after 30 s'; may be repeated. Exit code 1 where one is broken.",
    ),
    "--baseline": ("FILE", "Baseline file (JSON), written by record."),
    "--beside": ("FILE", "JSON of other sensors' wavelet variances, drawn behind ours."),
    "--same-as": ("LOG", "Another log: test axis by axis whether both have one noise model (wavelet variances)."),
    "--held-out": ("LOG", "Another log of the same sensor, which the choice predicts; may be repeated."),
    "--track": ("FILE", "Own motion: a track (recording, GPX, CSV) or waypoints (CSV, GeoJSON)."),
    "--fixes": (
        "'1 m, 5 cm/s'",
        "Standard deviations of the fixes: horizontal position, velocity; down twice as much.",
    ),
    "--aids": (
        "NAME=SIGMA,...",
        "Aids as alternatives: 'odometer=0.05 m/s, heading=0.5 deg, barometer=1 m, standstill'.",
    ),
    "--have": ("NAME|FILE", "The sensor card that one has, to be flown whatever it reaches."),
    "--transfer": ("FILE", "Factors between bench and vehicle, put on all cards: what insemu transfer --json printed."),
    "--vehicle": ("NAME", "Kind of vehicle, such as car, multirotor or boat: how it moves and leans."),
    "--like": ("NAME", "Copy this scenario that comes with insemu, with the files that it needs."),
    # what goes out
    "--output": ("PATH", "File or folder to write."),
    "--page": ("FILE", "Write a page with figures (HTML)."),
    "--sensor-output": ("FILE", "Also write the noise of the sensor that was removed (noise models)."),
    "--figure": ("FILE", "Draw it to this file (PNG, PDF or SVG)."),
    "--log": ("FILE", "Write the signals as a log at rest (.npz or .csv), for insemu fit."),
    "--next": ("FILE", "Design the next experiment and write its scenario (YAML) and waypoints."),
    "--json": ("", "Print JSON on standard output instead of text."),
    "--pictures": ("", "Write the page's charts as PNG and SVG, too."),
    "--overlay": ("", "Also draw the axes of a sensor in one panel."),
    "--overwrite": ("", "Replace results of the same scenario with more realizations."),
    "--force": ("", "Replace files that exist."),
    "--save-map": ("", "Write the map next to the file; every command uses it."),
    "--list": ("", "List the scenarios that come with insemu with their questions."),
    "--formats": ("", "List the kinds of file that are read, and end."),
    "--to": ("NAME", "Program or kind of file that is written for."),
    "--reference": ("", "Of recordings: the reference instead of the fixes."),
    "--origin": ("DATE", "Date of time 0 (2024-05-01T12:00:00Z), where stamps are no dates."),
    "--outage": ("START:END", "Seconds coloured as an outage; may be repeated."),
    "--realization": ("N", "Which realization, from 0."),
    "--detail": ("", "Print candidates and parameters of every axis, too."),
    "--rows": ("N", "Candidates to list per axis (--detail)."),
    "--port": ("N", "Port on this computer; 0 takes any that is free."),
    "--browser": ("", "Open the list in a browser."),
    # how much, and with what
    "--realizations": ("N", "Number of realizations; default the scenario's."),
    "--recordings": ("N", "Number of recordings."),
    "--trials": ("N", "Trials of each case (trial)."),
    "--seed": ("N", "Seed of all random draws; default the scenario's."),
    "--workers": ("N", "Work items at a time; default the number of cores."),
    "--cluster": ("WHERE", "Work on a Dask cluster: local, or tcp://HOST:PORT."),
    "--shard": ("K/N", "Fly only a part, such as 3/40, and keep it in the folder; insemu merge makes the results."),
    "--until": ("GOAL", "Fly on until 'planimetric_end ratio DESIGN/DESIGN within 5 %' or '... mean DESIGN ...'."),
    "--linear": ("N", "Fly nothing: so many realizations to first order."),
    "--control": ("N", "Help means and quantiles with so many linear realizations, for example 10000."),
    "--variants": ("", "Also run the scenario's variants."),
    "--over": ("KEY=[VALUE, ...],...", "Keys and what they take: sensor=[ADIS16470, BMI088],outage=[30 s, 60 s]."),
    "--latin": ("N", "So many points of a Latin hypercube instead of all combinations."),
    "--base": ("NAME", "Design that the others are measured against; default the first."),
    "--analytic": ("", "Covariance analysis and error budgets instead of flying (a truth of noise models)."),
    "--by": ("NAME", "Parts of the budget: source, axis or process."),
    "--ideal": ("", "Perfect sensors: no errors on the IMU or the fixes."),
    "--gravity": ("NAME", "Gravity model: normal or free_air_first_order."),
    "--lever-arm": ("'X Y Z m'", "IMU to antenna in the axes of the recording; estimated where it is not given."),
    "--max-offset": ("'10 s'", "Largest time offset that is searched for."),
    "--log-length": ("'1 h'", "Length of a log at rest."),
    "--drive-length": ("'10 min'", "Length of a drive or flight."),
    "--false-alarm": ("P", "Probability of an alarm without a cause."),
    # noise models
    "--method": ("NAME", "Estimator."),
    "--robust": ("", "Use the wavelet variance that outliers cannot move."),
    "--pooled": ("", "One model per sensor triad from the mean of its curves (gmwm)."),
    "--wavelet": ("NAME", "Filter of the wavelet variance, such as d8 or la8."),
    "--weighting": ("NAME", "Of gmwm: intervals, asymptotic or bootstrap; auto: see docs/fitting.md."),
    "--start": ("MODEL", "Model with values to start from (gmwm, em, mli)."),
    "--tau-from": ("'0.1 s'", "Shortest scale to use (gmwm)."),
    "--tau-to": ("'100 s'", "Longest scale to use (gmwm); all where it is not given."),
    "--denoise": ("RULE:OCTAVES", "Of burg and autocorrelation: rule and octaves that are de-noised first."),
    "--pattern": ("NAME", "Of mli: uniform or log."),
    "--bootstrap": ("N", "Intervals and criterion from so many simulated signals; 0: closed form."),
    "--covariate": ("NAME", "What levels follow: temperature, speed, rate, force, vibration or a column."),
    "--segments": ("N", "Segments that the log or drive is cut into."),
    "--regressors": (
        "NAMES",
        'What the signal follows: "temperature, lag(temperature, 300 s), time^2", columns, "rate * temperature".',
    ),
    "--general": ("STRUCTURE", "Everything nested in this model is tried."),
    "--candidate": ("STRUCTURE", "Rank these models instead; may be repeated."),
    "--case": ("NAME", "Figures of a card: typical or worst."),
    "--worst-factor": ("X", "Worst case of a figure without a printed limit, times the typical figure."),
    "--band": ("'1 s' '1000 s'", "Averaging times over which a filter's states stand for flicker."),
    "--plus": ("MODELS", "What every IMU has in addition to its fit."),
    "--take": ("NAME", "Weights that are written: metres, scale-wise, inverse or equal."),
    "--window": ("'60 s'", "Length of a window."),
    "--learn": ("N", "Windows before the first comparison."),
    "--every": ("N", "Windows from one fit to the next."),
    # the gap
    "--without": ("EFFECT", "Effect to take out of the catalogue; may be repeated."),
    "--apply": ("NUMBERS", "Findings that go into refined.yaml, such as '1,3'; default: all of them."),
    "--hold-out": ("", "Score on data that was not used for naming (twice the work)."),
    "--search": ("", "Also look for what the model lacks, as 'insemu gap' does."),
    "--kind": ("NAME", "dynamic (drives and flights), static (logs at rest) or both in turns."),
    "--effect": ("EFFECT", "Effect to hide ('none' too); may be repeated. Default: every one."),
    "--hidden": ("N", "Effects hidden at once; 0: nothing is missing."),
    "--outside": ("", "Hide something that no catalogue holds instead."),
    "--why": ("", "Look for the reasons (the gap workflow, a few minutes)."),
    "--calibrate": ("", "Tune scale factors and misalignments of the IMU together with the noise."),
}
SHORT = {"--output": "-o", "--model": "-m", "--columns": "-c", "--general": "-g"}


def cores(given: int | None) -> int:
    """Work items at a time: all cores where no number is given."""
    return given or os.cpu_count() or 1


_LIMITS: dict[str, dict[str, Any]] = {
    "--workers": {"min": 1, "max": WORKERS, "callback": cores},
    "--seed": {"min": 0},
    "--realizations": {"min": 2, "max": DRAWS},
    "--realization": {"min": 0, "max": DRAWS},
    "--linear": {"min": 0, "max": LINEAR},
}


def option(name: str, default: Any, words: str = "", **limits: Any) -> Any:
    """An option of the table, for the signature of a command.

    Parameters
    ----------
    name : str
        As in the table.
    default
        ``...`` where it has to be given. A switch that is on has a ``--no-`` form.
    words : str
        What the command does with it, where that is more than the table says.
    **limits
        ``min`` and ``max`` of a number.
    """
    follows, usual = OPTIONS[name]
    spelled = [f"{name}/--no-{name[2:]}" if default is True else name, *([SHORT[name]] if name in SHORT else [])]
    return typer.Option(
        default, *spelled, metavar=follows or None, help=words or usual, **(_LIMITS.get(name, {}) | limits)
    )


def argument(name: str, words: str = "", default: Any = ...) -> Any:
    """An argument of the table, for the signature of a command.

    Parameters
    ----------
    name : str
        As in the table.
    words : str
        What it is here, where that is more than the table says.
    default
        Of one that may be left out.
    """
    return typer.Argument(default, metavar=name, help=words or ARGUMENTS[name])
