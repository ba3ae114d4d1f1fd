"""What grows with the length of a flight, the number of outages and the length of a log: CPU seconds, largest memory, weight of the page.

Run: .venv/bin/python benchmarks/growth.py [PART ...]; parts: flight, outages, logs; default all. A row is a command in a process of its own, which
prints what is behind it; `flight` takes some minutes. Flights that are short enough to be held are flown in stretches, too, as the others.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import yaml

#: A flight of one design with random outages, as long as asked for.
FLIGHT: dict[str, Any] = {
    "title": "a long flight",
    "seed": 5,
    "realizations": 1,
    "trajectory": {"builtin": "helicopter_mapping", "rate": "400 Hz"},
    "truth": {
        "gyro": "WN(N=0.1 deg/s/sqrt(Hz)) + GM(sigma=30 deg/h, Tc=100 s)",
        "accel": "WN(N=90 ug/sqrt(Hz)) + GM(sigma=1 mg, Tc=200 s)",
    },
    "gnss": {
        "position_sigma": "1 m",
        "velocity_sigma": "5 cm/s",
        "random_outages": {"per_hour": 4, "mean": "40 s"},
    },
    "designs": {"right": {"gyro": {"truth": True}, "accel": {"truth": True}}},
}
HOURS = (1, 4, 8, 24)
#: Outages of a flight of 30 s each, one every minute and a half, and the designs that fly it.
OUTAGES = (20, 100, 400, 1000)
SAMPLES = (25_000_000, 50_000_000, 100_000_000)
RUN = (
    "from insemu.evaluate import emulated, stretched; emulated.MAX_SAMPLES = stretched.MAX_SAMPLES = {most}; "
    "from insemu.cli import main; main()"
)


def measured(folder: Path, *arguments: str, most: int = 10_000_000) -> tuple[float, float]:
    """CPU seconds and largest memory in MB of an insemu command; of flights longer than ``most`` samples in stretches."""
    command = [sys.executable, "-c", RUN.format(most=most), *arguments]
    with subprocess.Popen(command, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as process:
        said = process.stderr.read() if process.stderr else ""
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"insemu {' '.join(arguments)} failed: {said[-800:]}")
    return used.ru_utime + used.ru_stime, used.ru_maxrss / 1024


def flight(folder: Path) -> None:
    for hours in HOURS:
        scenario = FLIGHT | {"trajectory": FLIGHT["trajectory"] | {"duration": f"{hours} h"}}
        (folder / "flight.yaml").write_text(yaml.safe_dump(scenario), encoding="utf-8")
        arguments = (
            "run",
            "flight.yaml",
            "--workers",
            "1",
            "--no-pictures",
            "--overwrite",
            "--output",
            f"flight_{hours}",
        )
        seconds, memory = measured(folder, *arguments, most=1000)
        print(
            f"flight of {hours} h at 400 Hz, {hours * 3600 * 400 / 1e6:.2f} M epochs: {seconds:.0f} CPU s, {memory:.0f} MB",
            flush=True,
        )


def outages(folder: Path) -> None:
    for count in OUTAGES:
        scenario = FLIGHT | {
            "realizations": 2,
            "trajectory": FLIGHT["trajectory"] | {"rate": "10 Hz", "duration": f"{90 * count + 60} s"},
            "gnss": FLIGHT["gnss"] | {"outages": [{"start": 60 + 90 * k, "duration": 30} for k in range(count)]},
            "designs": FLIGHT["designs"]
            | {
                "white": {"gyro": "WN(N=0.1 deg/s/sqrt(Hz))", "accel": {"truth": True}},
                "wide": {"gyro": "WN(N=0.3 deg/s/sqrt(Hz))", "accel": {"truth": True}},
            },
        }
        del scenario["gnss"]["random_outages"]
        (folder / "outages.yaml").write_text(yaml.safe_dump(scenario), encoding="utf-8")
        arguments = (
            "run",
            "outages.yaml",
            "--workers",
            "1",
            "--no-pictures",
            "--overwrite",
            "--output",
            f"outages_{count}",
        )
        seconds, memory = measured(folder, *arguments)
        weight = (folder / f"outages_{count}" / "index.html").stat().st_size / 1e6
        print(f"{count} outages, 3 designs: page of {weight:.2f} MB, {seconds:.0f} CPU s, {memory:.0f} MB", flush=True)


def logs(folder: Path) -> None:
    rng = np.random.default_rng(1)
    for samples, axes in [*((n, 1) for n in SAMPLES), (SAMPLES[1], 6)]:
        file = folder / f"log_{samples}_{axes}.npy"
        shape = (samples,) if axes == 1 else (samples, axes)
        with file.open("wb") as handle:  # not mapped: a process that is started counts what its parent held
            np.lib.format.write_array_header_1_0(handle, {"descr": "<f8", "fortran_order": False, "shape": shape})
            for first in range(0, samples, 1 << 20):
                handle.write((1e-3 * rng.standard_normal((min(1 << 20, samples - first), *shape[1:]))).tobytes())
        for arguments in (
            ("characterise", file.name, "--rate", "100 Hz", "--output", "characterised"),
            ("fit", file.name, "--rate", "100 Hz", "--model", "WN() + RW()", "--workers", "1"),
        ):
            seconds, memory = measured(folder, *arguments)
            print(
                f"{arguments[0]}, {axes} x {samples / 1e6:g} M samples: {seconds:.1f} CPU s, {memory:.0f} MB",
                flush=True,
            )
        file.unlink()


PARTS = {"flight": flight, "outages": outages, "logs": logs}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parts", nargs="*", choices=[*PARTS, []], help="default: all")
    asked = parser.parse_args().parts or list(PARTS)
    with tempfile.TemporaryDirectory() as folder:
        for part in asked:
            PARTS[part](Path(folder))


if __name__ == "__main__":
    main()
