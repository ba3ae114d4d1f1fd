"""A small share of the fuzzing (``python -m tests.fuzz`` runs as many as are wanted), and inputs that once went wrong."""

from __future__ import annotations

import faulthandler
import gzip
import inspect
import os
import random
import signal
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from typer.main import get_command
from typer.testing import CliRunner

from insemu.cli import app, main
from insemu.errors import InputError, shown
from insemu.formats import open_files, read, read_log
from insemu.scenario import load
from tests.fuzz import TARGETS, Batch, Outcome, Target, run_batch
from tests.fuzz.commands import SCENARIO


def _run(name: str, count: int, seed: int) -> Outcome:
    outcome = run_batch(Batch(name, seed, 0, count))
    assert not outcome.wrong
    return outcome


@pytest.mark.parametrize("name", TARGETS)
def test_a_small_share_is_taken_or_refused_in_words(name: str) -> None:
    assert _run(name, 100 if TARGETS[name].share == "models" else 6, 7).count


@pytest.mark.slow(reason="hundreds of broken inputs")
@pytest.mark.parametrize("name", TARGETS)
def test_many_are_taken_or_refused_in_words(name: str) -> None:
    assert 0 < _run(name, 1000, 11).refused < 1000  # neither is everything broken, nor nothing


def test_what_goes_wrong_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """An input that raises, hangs, fills the memory or kills the process costs that input only."""

    def prepare(what: str, folder: Path) -> Callable[[random.Random], None]:
        tried = iter(range(9))

        def one(rng: random.Random) -> None:
            k = next(tried)
            if what == "raise" and k == 1:
                raise KeyError("x")
            if what == "hang" and k == 1:
                while True:
                    pass
            if what == "die" and k == 1:
                faulthandler.disable()  # the test means to die
                os.kill(os.getpid(), signal.SIGSEGV)
            raise InputError("refused")

        return one

    monkeypatch.setattr("tests.fuzz.models.prepare", prepare)
    monkeypatch.setattr("tests.fuzz.watch.SLOWEST", 0.2)
    for what, said in (("raise", "KeyError"), ("hang", "takes more than"), ("die", "signal 11")):
        monkeypatch.setitem(TARGETS, what, Target(what, "models", what, "models"))
        outcome = run_batch(Batch(what, 1, 0, 4))
        # a process that ended begins again with the next input, whose second is the third
        assert outcome.wrong[0][0] == 1 and said in outcome.wrong[0][1]
        assert outcome.count == 4


@pytest.mark.parametrize("grows", [True, False])
def test_memory_is_counted_from_the_warm_process_on(monkeypatch: pytest.MonkeyPatch, grows: bool) -> None:
    """What a process of many tests holds is no input's."""

    def prepare(what: str, folder: Path) -> Callable[[random.Random], None]:
        kept = []

        def one(rng: random.Random) -> None:
            # above 32 MiB the allocator asks the system anew: smaller arrays may lie in what an earlier test gave back
            kept.append(np.ones(5_000_000 if grows else 1))
            raise InputError("refused")

        return one

    monkeypatch.setattr("tests.fuzz.models.prepare", prepare)
    monkeypatch.setattr("tests.fuzz.watch.LARGEST", 64 << 20)
    monkeypatch.setitem(TARGETS, "grow", Target("grow", "models", "grow", "models"))
    held = np.ones(16_000_000)
    outcome = run_batch(Batch("grow", 1, 0, 16))
    assert held.nbytes > 64 << 20 and outcome.count == 16
    assert [(k, "memory above 64 MB" in said) for k, said in outcome.wrong] == ([(15, True)] if grows else [])


@pytest.mark.slow(reason="whole commands, whose parts have quick tests")
def test_commands_may_be_named_by_a_path_without_a_name() -> None:
    for path in (".", "", ".."):
        with pytest.raises(InputError):
            read(path)


def _broken(folder: Path) -> dict[str, bytes]:
    plain = b"t [s],gx [deg/s]\n" + b"".join(b"%d.0,1.5\n" % k for k in range(200))
    packed = gzip.compress(plain)
    np.save(folder / "x.npy", np.ones(100))
    npy = (folder / "x.npy").read_bytes()
    np.savez_compressed(folder / "x.npz", data=np.ones((100, 2)), fs=100.0)
    npz = (folder / "x.npz").read_bytes()
    return {
        "cut.csv.gz": packed[:-20], "flipped.csv.gz": packed[:30] + b"\xff\xff" + packed[32:], "empty.csv.gz": b"",
        "latin.csv": plain.replace(b"deg", b"\xb0\x00"), "cut.npy": npy[:60], "header.npy": npy.replace(b"(100,)", b"(((10,"),
        "huge.npy": npy.replace(b"(100,)", b"(9**99)").replace(b"(9**99)", b"(10**9)"), "cut.npz": npz[: len(npz) // 2],
        "method.npz": npz.replace(b"\x08\x00", b"\x63\x00"), "text.npz": b"PK\x03\x04" + b"x" * 50, "binary.csv": bytes(range(256)) * 8,
        "x.bag": b"#ROSBAG V2.0\n" + bytes(200), "x.mcap": b"\x89MCAP0\r\n" + bytes(100), "x.ulg": b"ULog\x01\x12\x35\x01" + bytes(5),
        "x.mat": b"MATLAB 5.0 MAT-file" + bytes(200), "x.h5": b"\x89HDF\r\n\x1a\n" + bytes(100), "x.gpx": b"<gpx><trkpt lat='x' lon='1'/></gpx>",
        "x.kml": b"<kml><coord>1</coord></kml>", "x.geojson": b'{"coordinates": ' + b"[" * 5000, "x.zip": b"PK\x03\x04",
        "x.ubx": b"\xb5\x62" * 50, "x.nmea": b"$GPGGA,,,,,,,,\n" * 9, "x.parquet": b"PAR1" + bytes(20), "nothing.txt": b"",
        "x.pos": b"% latitude(deg)\n1 2\n",
    }  # fmt: skip


def test_broken_containers_are_input_errors(tmp_path: Path) -> None:
    for name, content in _broken(tmp_path).items():
        path = tmp_path / f"broken_{name}"
        path.write_bytes(content)
        for door in (open_files, read, lambda p: read_log(p, rate_hz=100.0)):
            with pytest.raises(InputError, match=name.split(".")[0]):
                door(path)


def test_an_archive_writes_nothing_outside(tmp_path: Path) -> None:
    path = tmp_path / "in" / "phone.zip"
    path.parent.mkdir()
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("../../climbed.csv", "a")
        archive.writestr("Gyroscope.csv", '"Time (s)","x (rad/s)"\n')
    with pytest.raises(InputError):
        open_files(path)
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["in", "phone.zip"]


@pytest.mark.parametrize(
    "line",
    [["emulate", "s.yaml", "--output", ""], ["serve", ""], ["export", "", "-o", "a.tum"], ["fit", "", "-m", "WN()"]],
)
def test_an_empty_text_names_no_file_and_no_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, line: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "s.yaml").write_text(SCENARIO)
    ran = CliRunner().invoke(app, line)
    assert isinstance(ran.exception, InputError) and "found an empty text" in str(ran.exception)
    assert [p.name for p in tmp_path.iterdir()] == ["s.yaml"]


def test_a_refused_file_leaves_no_folder_behind(tmp_path: Path) -> None:
    (tmp_path / "track.gpx").write_text(
        '<gpx xmlns="http://www.topografix.com/GPX/1/1"><trk><trkseg>'
        + "".join(
            f'<trkpt lat="{47 + k * 1e-4}" lon="8"><time>2024-01-01T00:00:{k:02d}Z</time></trkpt>' for k in range(40)
        )
        + "</trkseg></trk></gpx>"
    )
    ran = CliRunner().invoke(
        app, ["export", str(tmp_path / "track.gpx"), "-o", str(tmp_path / "deep" / "er" / "a.tum")]
    )
    assert isinstance(ran.exception, InputError) and "has no attitude" in str(ran.exception)
    assert [p.name for p in tmp_path.iterdir()] == ["track.gpx"]


def test_a_value_in_a_message_is_no_longer_than_a_line(tmp_path: Path) -> None:
    path = tmp_path / "s.yaml"
    path.write_text(SCENARIO.replace("start: 30 s", "start: {" + ", ".join(f"key{k}: text" for k in range(900)) + "}"))
    with pytest.raises(InputError, match="dict of 900") as refused:
        load(path)
    assert len(str(refused.value)) < 300
    for value in ("x" * 999, 10**5000, [10**5000], {k: k for k in range(99)}):
        assert len(shown(value)) <= 80


@pytest.mark.parametrize("options", [["--bootstrap", "10"], ["--bootstrap", "50", "--method", "mli"]])
def test_a_bootstrap_that_cannot_be_is_refused_before_the_fit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: list[str]
) -> None:
    def fitted(*arguments: object) -> None:
        raise AssertionError("the fit began")

    np.savez(
        tmp_path / "log.npz",
        data=np.random.default_rng(1).standard_normal((400, 1)) * 1e-3,
        fs=100.0,
        columns=["gx"],
        units=["rad/s"],
    )
    monkeypatch.setattr("insemu.cli.logs.read_static", fitted)
    ran = CliRunner().invoke(app, ["fit", str(tmp_path / "log.npz"), "-m", "WN()", *options])
    assert isinstance(ran.exception, InputError), ran.output


#: Whole numbers that are no counts, or whose limit the library tells.
_NO_COUNTS = ("seed", "latin of sweep")


def test_every_count_has_a_limit() -> None:
    counts = {}
    for command, found in get_command(app).commands.items():  # type: ignore[attr-defined]
        for name, parameter in inspect.signature(inspect.unwrap(found.callback)).parameters.items():
            if str(parameter.annotation) in ("int", "<class 'int'>", "int | None") and not {
                name,
                f"{name} of {command}",
            } & set(_NO_COUNTS):
                counts[f"{command}: {name}"] = parameter.default.max
    assert len(counts) > 15
    assert not [name for name, limit in counts.items() if limit is None]


@pytest.mark.parametrize(
    "words",
    [
        ["run", "S", "--linear", str(10**20)],
        ["sweep", "S", "--over", "outage=[5 s, 10 s]", "--latin", str(10**20)],
        ["emulate", "S", "--output", "a.txt"],
        ["open", "S", "--output", "a.xyz"],
        ["compare", "S", "a", "--base", "b"],
    ],
)
def test_what_cannot_be_is_refused_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str]
) -> None:
    def begun(*arguments: object, **options: object) -> None:
        raise AssertionError("the work began")

    for place in ("insemu.evaluate.Experiment", "insemu.evaluate.EmulatedWorld", "insemu.intake.take"):
        monkeypatch.setattr(place, begun)
    (tmp_path / "s.yaml").write_text(SCENARIO)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as stop:
        main([w.replace("S", "s.yaml") if w == "S" else w for w in words])
    assert stop.value.code == 2
    assert os.listdir() == ["s.yaml"]
