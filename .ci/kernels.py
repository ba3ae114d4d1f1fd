"""Compile the kernels that travel in a wheel: runs of the commands people begin with, and what they compiled copied to a folder.

python .ci/kernels.py FOLDER [PROCESSOR ...]      this machine's baseline unless processors are named (x86-64-v3, generic)

What the checkout has compiled before is not compiled again, and with KERNELS=kept in the environment nothing is run: after `make test` all is
there. `hatch_build.py` puts the folder into the wheel.
"""

from __future__ import annotations

import json
import os
import pickle
import resource
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

#: Commands by what they are to write or read in a folder of their own; each compiles what the ones before it did not.
PROGRAMS = """
run table3_synthetic --realizations 2 --workers 1 --no-pictures --output table3
run outages_smoothed --realizations 2 --workers 1 --no-pictures --output smoothed
emulate gap_static_hidden --output static.npz
emulate gap_drive_hidden --output drive.npz
open static.npz
characterise static.npz --output characterised
fit static.npz --model WN()+RW()
fit static.npz --model 2*GM()+WN()+QN()+RW() --columns gyro_x --page fit.html
fit static.npz --model WN()+GM() --columns gyro_z --robust
fit static.npz --model WN()+AR1() --columns accel_x --method mli
select static.npz --general GM()+WN()+RW() --columns gyro_y
watch static.npz --model WN()+GM() --columns gyro_x
dead-reckon drive.npz
solve drive.npz --output solved
init --like gap_static_nominal
init --like gap_drive_nominal
gap gap_static_nominal.yaml static.npz --output gap_static
gap gap_drive_nominal.yaml drive.npz --output gap_drive
compare table3_synthetic --analytic
run table3_synthetic --linear 100
require "planimetric < 30 m after 20 s" --output required
designs
"""


def run(command: str, folder: Path, processor: str) -> None:
    """A command of the program in a folder, with kernels for a processor; what it says where it fails."""
    environment = os.environ | {"NUMBA_CPU_NAME": processor, "NUMBA_CPU_FEATURES": "", "OPENBLAS_NUM_THREADS": "1"}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    said = subprocess.run(
        [sys.executable, "-m", "insemu", *shlex.split(command)],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
    )
    now = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = now.ru_utime + now.ru_stime - before.ru_utime - before.ru_stime
    print(f"kernels for {processor}: insemu {command}: {seconds:.1f} CPU s", flush=True)
    if said.returncode:
        sys.exit(f"{said.stdout[-2000:]}\n{said.stderr[-2000:]}")


def gather(into: Path, processors: list[str]) -> int:
    """Copy what is valid now for these processors from the folder of compiled kernels; how many."""
    from numba.core.caching import IndexDataCacheFile

    from insemu.compiled import MADE, made_for, own_folder

    made = made_for()
    into.mkdir(parents=True, exist_ok=True)
    count = 0
    for index in sorted(own_folder().glob("insemu.*.nbi")):
        with index.open("rb") as file:
            version = pickle.load(file)
            rest = file.read()
        if version != made["numba"]:
            continue
        stamp, overloads = pickle.loads(rest)
        if not stamp.startswith(made["sources"]):
            continue
        kept = {key: name for key, name in overloads.items() if key[1][1] in processors}
        if not kept:
            continue
        out = IndexDataCacheFile(str(into), index.stem, stamp)
        out._save_index(kept)
        for name in kept.values():
            (into / name).write_bytes((index.parent / name).read_bytes())
        count += len(kept)
    (into / MADE).write_text(json.dumps(made | {"processors": processors}, indent=1), encoding="utf-8")
    return count


def main(into: Path, processors: list[str]) -> None:
    """Run the programs for every processor, and gather."""
    from insemu.compiled import baseline

    processors = processors or [baseline()]
    for processor in processors if os.environ.get("KERNELS") != "kept" else ():
        with tempfile.TemporaryDirectory() as folder:
            for command in PROGRAMS.strip().splitlines():
                run(command, Path(folder), processor)
    print(f"kernels: {gather(into, processors)} in {into}")


if __name__ == "__main__":
    main(Path(sys.argv[1]).resolve(), sys.argv[2:])
