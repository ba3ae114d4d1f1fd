"""A small share of the fuzzing of every reader (tests/fuzz_files.py runs as many as are wanted), and inputs that once went wrong."""

from __future__ import annotations

import gzip
import zipfile
from pathlib import Path

import numpy as np
import pytest

from insemu.errors import InputError
from insemu.formats import open_files, read, read_log
from tests.file_samples import KINDS
from tests.fuzz_files import fuzz


@pytest.mark.parametrize("kind", KINDS)
def test_mutated_files_are_read_or_refused(kind: str) -> None:
    assert not fuzz(kind, 4, 7)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_many_mutated_files_are_read_or_refused(kind: str) -> None:
    assert not fuzz(kind, 300, 11)


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
