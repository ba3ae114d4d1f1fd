"""Command lines: options left out, repeated, unknown or with values that do not belong there; files that are missing, broken or of another kind.

A command that reaches its work is taken as accepted and stopped there; one that is refused must leave every file as it was.
"""

from __future__ import annotations

import importlib
import io
import os
import random
import shutil
import sys
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout, suppress
from pathlib import Path
from typing import Any

import typer

from insemu import cli
from insemu.errors import InputError
from insemu.formats import write
from tests import file_samples
from tests.fuzz import files, scenarios

#: Where long work begins: a command that gets there was not refused.
_WORK = (
    "insemu.work.run_items", "insemu.fit.fit", "insemu.fit.estimator.fit", "insemu.fit.fit_mli_pieces", "insemu.fit.bootstrapped",
    "insemu.fit.selection.select", "insemu.gap.find_gap", "insemu.gap.find_static_gap", "insemu.evaluate.analyse_designs",
    "insemu.emulate.dead_reckon", "insemu.evaluate.run_experiment", "insemu.report.fit.render_fits",
    "insemu.report.characterise.render_characterisation", "insemu.report.experiment.render_experiment", "insemu.report.serve.server",
)  # fmt: skip
#: Samples of a flight that ``emulate`` still writes here: more is seconds of work on an accepted input.
_MOST_SAMPLES = 20_000
SCENARIO = """
title: small
seed: 1
realizations: 2
trajectory: {builtin: urban_drive_1, rate: 20 Hz, duration: 60 s}
truth:
  gyro: WN(N=0.01 deg/s/sqrt(Hz)) + GM(sigma=0.01 deg/s, Tc=100 s)
  accel: WN(N=0.15 mg/sqrt(Hz))
gnss: {rate: 1 Hz, position_sigma: 2 cm, outages: [{start: 30 s, duration: 10 s}]}
designs:
  a: {gyro: {truth: true}, accel: {truth: true}}
  b: {gyro: WN(N=0.01 deg/s/sqrt(Hz)), accel: WN(N=0.15 mg/sqrt(Hz))}
variants: {late: {gnss: {outages: [{start: 40 s, duration: 10 s}]}}}
"""
_FILES = (
    "s.yaml", "log.csv", "rec.npz", "models.yaml", "track.gpx", "base.json", "mutated.yaml", "mutated.csv", "mutated.npz",
)  # fmt: skip
_ODD_FILES = (
    "missing",
    "folder",
    "",
    ".",
    "..",
    "empty",
    "binary",
    "x" * 300,
    "a\nb",
    "log.csv/x",
    "/dev/null",
    "/dev/null/x",
    "-",
    "table3_synthetic.yaml",
)
_OUT = (
    "out/a.npz", "out/a.yaml", "out/a", "out/a.tum", "out/a.kml", "out/a.csv", "out/a.html", "out/a.json", "out/a.xyz", "out/deep/er/a.npz",
    "empty/x", "", "folder",
)  # fmt: skip
_TEXTS = (
    "100 Hz", "0 Hz", "-1 Hz", "nan", "inf", "1e999 Hz", "10 s", "-1 s", "1e308 h", "1 kg", "2*GM() + WN()", "WN()", "GM(", "1e9*WN()", "AR(3)",
    "gx,gy", "gyro_x", "nope", "haar", "d8", "la8", "d9999", "gmwm", "mli", "burg", "slopes", "source", "axis", "kalibr", "gazebo", "15AV", "a,b",
    "a", "b", "late", "typical", "worst", "both", "static", "dynamic", "drive", "car", "normal", "uniform", "scale_factor", "lever_arm", "1,3", "0",
    "5", "10:20", "20:10", "a:b", "2024-01-01T00:00:00", "2024-13-45", "gyro=omega_*[deg/s]", "time=t[ns], gyro=g*", "[bold]", "\u202e", "\u00e9",
    "'", "$(x)", "--", "auto", "bootstrap", "ADIS16470", "ARW 0.34 deg/sqrt(h), in-run bias stability 8 deg/h", "record", "check", "trial",
)  # fmt: skip
_NUMBERS = ("0", "1", "2", "3", "-1", "1e9", "10", "99999999999999999999", "nan", "0.5", "1e-300", "inf", "abc", "")


class _Accepted(BaseException):
    """The command reached its work."""


def _stop_at_work() -> None:
    """Let every function of ``_WORK`` end the command, under whatever name a module has it, and ``emulate`` where its flight is long."""

    def stop(*args: Any, **options: Any) -> None:
        raise _Accepted

    for path in _WORK:
        module, _, name = path.rpartition(".")
        original = getattr(importlib.import_module(module), name)
        for loaded in [m for n, m in sys.modules.items() if n.startswith("insemu")]:
            for key in [k for k, v in vars(loaded).items() if v is original]:
                setattr(loaded, key, stop)
    from insemu.evaluate import emulated

    made = emulated.ideal_imu

    def short(path: Any, rate_hz: float, *, span: tuple[float, float] | None = None, **options: Any) -> Any:
        first, last = span or (path.start, path.end)
        return stop() if (last - first) * rate_hz > _MOST_SAMPLES else made(path, rate_hz, span=span, **options)

    emulated.ideal_imu = short  # type: ignore[assignment]


def _make(folder: Path) -> None:
    """The files that command lines name."""
    folder.mkdir()
    (folder / "s.yaml").write_text(SCENARIO)
    drive = file_samples.drive(files.SECONDS)
    write(folder / "rec.npz", drive)
    rows = "\n".join(f"{k / 100},{(k * 7919) % 13 - 6},{(k * 104729) % 17 - 8}" for k in range(300))
    (folder / "log.csv").write_text(f"t [s],gx [deg/s],gy [deg/s]\n{rows}\n")
    (folder / "models.yaml").write_text("gyro_x: {model: [{process: WN, N: 1e-4}], unit: rad/s}\n")
    (folder / "base.json").write_text("{}")
    points = "".join(
        f'<trkpt lat="{47 + k * 1e-4}" lon="8"><time>2024-01-01T00:00:{k:02d}Z</time></trkpt>' for k in range(40)
    )
    (folder / "track.gpx").write_text(
        f'<gpx xmlns="http://www.topografix.com/GPX/1/1"><trk><trkseg>{points}</trkseg></trk></gpx>'
    )
    (folder / "folder").mkdir()
    (folder / "empty").touch()
    (folder / "binary").write_bytes(bytes(range(256)) * 8)


def _value(rng: random.Random, parameter: Any) -> str:
    name = str(parameter.name)
    if rng.random() < 0.1:
        return rng.choice((*_TEXTS, *_NUMBERS, *_ODD_FILES))
    if name in ("out", "page", "figure") or (name, parameter.metavar) == ("log", "FILE"):
        return rng.choice(_OUT)
    if parameter.metavar in ("FILE", "FOLDER", "LOG", "LOG...", "MODEL", "RECORDING", "REFERENCE", "SCENARIO", "UNIT"):
        return rng.choice(_ODD_FILES) if rng.random() < 0.2 else rng.choice(_FILES)
    if parameter.type_descriptor.annotation in (int, float, int | None, float | None):
        return rng.choice(_NUMBERS) if rng.random() < 0.5 else str(rng.randint(1, 5))
    return rng.choice(_TEXTS)


def _line(rng: random.Random, commands: dict[str, Any]) -> list[str]:
    name = rng.choice((*commands, *commands, "", "nope", "--version", "-h"))
    line = [name]
    if name not in commands:
        return [*line, *rng.sample(_TEXTS, rng.randrange(2))]
    for parameter in commands[name].params:
        if not parameter.opts[0].startswith("-"):
            if rng.random() < 0.95:
                line.append(_value(rng, parameter))
        elif parameter.name != "help" and rng.random() < (0.9 if parameter.required else 0.2):
            for _ in range(1 if rng.random() < 0.9 else 2):
                line.append(rng.choice(parameter.opts))
                if not getattr(parameter, "is_flag", False):
                    line += [_value(rng, parameter) for _ in range(max(1, parameter.nargs))]
    if rng.random() < 0.05:
        line.insert(rng.randrange(len(line)), rng.choice(("--nope", "-", "--", "-x", "--output", "extra")))
    if rng.random() < 0.05:
        line.pop(rng.randrange(len(line)))
    return line


def _state(folder: Path) -> dict[str, tuple[int, int]]:
    return {
        str(p.relative_to(folder)): (0, 0) if p.is_dir() else (p.stat().st_size, p.stat().st_mtime_ns)
        for p in folder.rglob("*")
    }


def prepare(what: str, folder: Path) -> Callable[[random.Random], None]:
    """A function that tries one command line in a folder of its own."""
    pristine, here = folder / "pristine", folder / "here"
    _make(pristine)
    group = typer.main.get_command(cli.app)
    commands = dict(group.commands)  # type: ignore[attr-defined]
    os.chdir(pristine)
    quiet = io.StringIO()
    for line in (
        "emulate s.yaml --output ../warm.npz",
        "characterise log.csv --json",
        "characterise rec.npz --json --rate 50Hz",
        "open rec.npz",
    ):
        with suppress(SystemExit), redirect_stdout(quiet), redirect_stderr(quiet):
            cli.main(line.split())
    (folder / "warm.npz").unlink()
    _stop_at_work()
    known: dict[str, tuple[int, int]] = {}

    def fresh() -> None:
        os.chdir(folder)
        shutil.rmtree(here, ignore_errors=True)
        shutil.copytree(pristine, here)
        os.chdir(here)

    def one(rng: random.Random) -> None:
        nonlocal known
        if not known:
            fresh()
            known = _state(here)
        line = _line(rng, commands)
        for name in {word for word in line if word.startswith("mutated.")}:
            if name == "mutated.yaml":
                content = scenarios.mutated(rng).encode("utf-8", "surrogatepass")
            else:
                source = pristine / ("log.csv" if name == "mutated.csv" else "rec.npz")
                content = files.any_mutated(source.read_bytes(), source.name, rng)
            (here / name).write_bytes(content)
            known[name] = _state(here)[name]
        code: Any = "accepted"
        try:
            cli.main(line)
        except SystemExit as ended:
            code = ended.code
        except _Accepted:
            pass
        except Exception as error:
            known = {}
            error.add_note(f"of {line}")
            raise
        now = _state(here)
        changed = sorted(k for k in now.keys() | known.keys() if now.get(k) != known.get(k))
        if changed:
            known = {}
        assert code in (0, 1, 2, None, "accepted"), f"exit code {code} of {line}"
        if code == 2:
            assert not changed, f"a refused command wrote {changed}: {line}"
            raise InputError("refused")
        given = {*line, *(Path(word).parts[0] for word in line if Path(word).parts), "results", "out", "scenario.yaml"}
        here_too = any(word in (".", "./") for word in line)  # a folder like any other
        outside = (
            []
            if here_too
            else [k for k in changed if Path(k).parts[0] not in given and k.removesuffix(".map.yaml") not in given]
        )
        assert not outside, f"{outside} written by {line}"
        beside = sorted(p.name for p in folder.iterdir() if p.name not in ("pristine", "here", "wrong.jsonl"))
        assert not beside, f"{beside} written outside by {line}"

    return one
