"""Time on the processor and memory of reading a long CSV log beside pandas, and long ROS bags, in the same run.

    python benchmarks/reading.py                              # 4 million rows of 7 columns, three bags of 3 h at 200 Hz: a few minutes, 3 GB of disk
    python benchmarks/reading.py --rows 4e5 --hours 0.3       # a tenth

Every file is read by a process of its own, which says its CPU seconds (imports apart) and its largest resident memory.
One core: run with OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from insemu.records import COLUMNS

BAGS = ("bag1", "mcap", "sqlite3")
#: Stamps of the bags begin here, ns since 1970.
BEGAN = 1_764_400_000_000_000_000


def write_csv(path: Path, rows: int, rate_hz: float = 200.0) -> None:
    """A log at rest: time, angular rate, specific force, every number with all its digits."""
    rng = np.random.default_rng(1)
    with path.open("w", encoding="ascii") as file:
        file.write("t [s]," + ",".join(f"{n} [{'rad/s' if n[0] == 'g' else 'm/s^2'}]" for n in COLUMNS) + "\n")
        for first in range(0, rows, 100_000):
            k = np.arange(first, min(first + 100_000, rows))
            noise = rng.standard_normal((k.size, 6)) * np.repeat([1e-3, 0.02], 3) - [0, 0, 0, 0, 0, 9.81]
            block = np.column_stack([k / rate_hz, noise])
            file.write("\n".join(",".join(map(repr, row)) for row in block.tolist()) + "\n")


def write_bag(path: Path, kind: str, hours: float, rate_hz: float = 200.0) -> None:
    """A topic of ``sensor_msgs/Imu`` with steps of whole ns, in a bag of ROS 1 or of ROS 2 (MCAP, sqlite3)."""
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if kind == "bag1" else Stores.ROS2_HUMBLE)
    types: Any = store.types
    time = types["builtin_interfaces/msg/Time"](sec=BEGAN // 10**9, nanosec=0)
    sequence = {"seq": 0} if kind == "bag1" else {}
    numbers = [1.5, 2.5, 3.5, 4.5, 5.5, 6.5]
    vectors = [types["geometry_msgs/msg/Vector3"](*numbers[k : k + 3]) for k in (0, 3)]
    message = types["sensor_msgs/msg/Imu"](
        types["std_msgs/msg/Header"](**sequence, stamp=time, frame_id="imu"),
        types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0), np.zeros(9), vectors[0], np.zeros(9), vectors[1], np.zeros(9),
    )  # fmt: skip
    serialize = store.serialize_ros1 if kind == "bag1" else store.serialize_cdr
    raw = bytes(serialize(message, "sensor_msgs/msg/Imu"))
    offsets = [raw.index(np.uint32(time.sec).tobytes()), *(raw.index(np.float64(v).tobytes()) for v in numbers)]
    layout = np.dtype(
        {"names": ["s", "ns", *COLUMNS], "formats": ["<u4"] * 2 + ["<f8"] * 6, "itemsize": len(raw),
         "offsets": [offsets[0], offsets[0] + 4, *offsets[1:]]}
    )  # fmt: skip
    if kind == "bag1":
        from rosbags.rosbag1 import Writer

        writer: Any = Writer(path)
    else:
        from rosbags.rosbag2 import StoragePlugin
        from rosbags.rosbag2 import Writer as Writer2

        writer = Writer2(path, version=9, storage_plugin=StoragePlugin[kind.upper()])
    rng = np.random.default_rng(1)
    count, step = round(hours * 3600.0 * rate_hz), round(1e9 / rate_hz)
    with writer:
        topic = writer.add_connection("/imu/data", "sensor_msgs/msg/Imu", typestore=store)
        for first in range(0, count, 20_000):
            stamps = BEGAN + step * np.arange(first, min(first + 20_000, count), dtype=np.int64)
            part = np.frombuffer(bytearray(raw * stamps.size), dtype=layout)
            part["s"], part["ns"] = stamps // 10**9, stamps % 10**9
            for k, name in enumerate(COLUMNS):
                part[name] = 0.01 * rng.standard_normal(stamps.size) - 9.81 * (k == 5)
            for stamp, row in zip(stamps.tolist(), part, strict=True):
                writer.write(topic, stamp, row.tobytes())


def read(what: str, path: str) -> str:
    """Read one file in this process; its CPU seconds, its memory and what was read."""
    import pandas as pd

    if what == "pandas":

        def job() -> str:
            return f"{len(pd.read_csv(path))} rows"
    elif what == "log":
        from insemu.formats import read_log

        def job() -> str:
            log = read_log(path)
            return f"{len(log)} rows at {log.rate_hz:.3f} Hz"
    else:
        import rosbags.highlevel
        import rosbags.typesys  # noqa: F401  imports do not count

        from insemu.formats import known_readers, open_files

        known_readers()

        def job() -> str:
            found = open_files(path)
            assert found.imu is not None
            return f"{len(found.imu)} rows at {1.0 / found.imu.dt:.3f} Hz"

    def seconds() -> float:
        used = resource.getrusage(resource.RUSAGE_SELF)
        return used.ru_utime + used.ru_stime

    start = seconds()
    said = job()
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    return f"{seconds() - start:8.2f} {peak:8.2f}   {said}"


def main() -> None:
    """Write the files, read each by a process of its own, print a row for each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", type=float, default=4e6)
    parser.add_argument("--hours", type=float, default=3.0)
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument("--read", nargs=2, metavar=("WHAT", "FILE"), help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.read:
        print(read(*asked.read))
        return
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "log.csv"
        write_csv(log, int(asked.rows))
        print(f"{'':28}{'CPU s':>8} {'GB':>8}   (imports apart; the largest resident memory of the process)")
        jobs = [("pandas.read_csv", "pandas", log), ("read_log of it", "log", log), ("open_files of it", "open", log)]
        for kind in BAGS:
            bag = Path(folder) / ("drive.bag" if kind == "bag1" else kind)
            if asked.hours > 0:
                write_bag(bag, kind, asked.hours)
                jobs.append((f"open_files of a bag, {kind}", "open", bag))
        for _ in range(asked.rounds):
            for name, what, path in jobs:
                command = [sys.executable, "-W", "ignore", __file__, "--read", what, str(path)]
                done = subprocess.run(command, check=True, capture_output=True, text=True)
                print(f"{name:28}{done.stdout}", end="", flush=True)


if __name__ == "__main__":
    main()
