"""Vehicles learned from recordings against the recordings: ``python -m benchmarks.vehicles``.

Of each real recording with motion the first half teaches a vehicle, which drives along the fixes of the second half with the fitted sensor and is
then held against that half: the area under the curve of ``insemu compare-drives`` and bands within 2 dB. The first half itself is the yardstick,
``vehicle: car`` without a motion of its own (as the kind glides) the other end. Then the first car's vehicle drives the other
car's road.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from insemu.drives import (
    LearnedVehicle,
    Windows,
    compare_drives,
    learn_vehicle,
    signals_of,
    top_of,
    track_for,
    windows_of,
    within,
)
from insemu.emulate import Moving, MovingVehicle, corrupt, fixes_at, ideal_imu, preset_file, read_vehicle, smooth_track
from insemu.filters import with_standard_deviations
from insemu.formats import read_recording
from insemu.noise import NoiseModel
from insemu.records import ImuRecord, Recording
from tests.shared_data import root

KINDS = {"rtkexp_drive": "car", "ublox_mixed_nominal": "car", "thor75_uav_flight": "fixed_wing"}
#: Realizations of the emulated drive.
SEEDS = 3


def driven(
    vehicle: MovingVehicle | str,
    along: Recording,
    sensor: Mapping[str, NoiseModel],
    seed: int,
    jerk: float | None = None,
) -> Recording:
    """A vehicle along the fixes of a recording, with its sampling rate and fixes of its standard deviations."""
    assert along.gnss is not None
    fixes = with_standard_deviations(along.gnss)[0]
    kind, jerk = (vehicle, jerk) if isinstance(vehicle, str) else (vehicle.kind, vehicle.jerk)
    path = smooth_track(track_for(fixes), kind, jerk=jerk, max_gap_s=np.inf).path
    if not isinstance(vehicle, str):
        path = Moving(vehicle, seed).on(path)
    start, end = max(path.start, along.imu.t[0]), min(path.end, along.imu.t[-1])
    ideal = ideal_imu(path, 1.0 / along.imu.dt, mode="continuous", kind="sample", span=(start, end))
    rng = np.random.default_rng(seed)
    imu = corrupt(ideal.imu, sensor, rng).imu
    assert fixes.pos_std_ned is not None
    made = fixes_at(ideal.reference, fixes.t, fixes.pos_std_ned, fixes.vel_std_ned, (0.0, 0.0, 0.0), rng=rng)
    return Recording(imu, made, ideal.reference, f"emulated along {along.source}")


def halves(name: str) -> tuple[Recording, Recording]:
    """First and second half of a real recording, in the axes of the vehicle as the whole tells them."""
    r = read_recording(root() / "real" / f"{name}.npz")
    assert r.gnss is not None
    s = signals_of(r)
    r = replace(r, imu=ImuRecord(s.t, s.x[:, :3], s.x[:, 3:]))
    start, end = max(r.imu.t[0], r.gnss.t[0]), min(r.imu.t[-1], r.gnss.t[-1])
    middle = 0.5 * (start + end)
    return within(r, (start, middle)), within(r, (middle, end))


def line(words: str, recorded: Windows, others: list[Windows]) -> None:
    """One comparison, over realizations."""
    found = [compare_drives(recorded, other) for other in others]
    powers, everything = (np.mean([getattr(c, k).value for c in found]) for k in ("powers", "everything"))
    bands = [abs(b.db) for c in found for b in c.bands]
    alike = sum(c.alike for c in found) / max(len(bands), 1)
    print(
        f"{words:50s} powers {powers:.2f}  everything {everything:.2f}  bands within 2 dB {alike:4.0%}, median {np.median(bands):.1f} dB "
        f"({len(found[0].bands)}); {found[0].telling[0].words}",
        flush=True,
    )


def main() -> int:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--only", default="", help="name of one recording")
    parser.add_argument("--seeds", type=int, default=SEEDS)
    given = parser.parse_args()
    learned: dict[str, LearnedVehicle] = {}
    for name, kind in KINDS.items():
        if given.only and name != given.only:
            continue
        first, second = halves(name)
        top = top_of(first)
        a, b = windows_of(first, top_hz=top), windows_of(second, top_hz=top)
        print(f"-- {name}", flush=True)
        line("first half itself", b, [a])
        found = learned[name] = learn_vehicle(first, kind=kind, name=name)
        drives = [
            (f"vehicle: {kind}, gliding", kind, second, b),
            (f"preset {kind}", read_vehicle(preset_file(kind)), second, b),
            ("learned, along the second half", found.vehicle, second, b),
            ("learned, along the first half, against that", found.vehicle, first, a),
        ]
        others = [x for x in learned if x != name and KINDS[x] == kind]
        drives += [(f"learned from {x}", learned[x].vehicle, second, b) for x in others]
        for words, vehicle, along, against in drives:
            emulated = [driven(vehicle, along, found.sensor, k) for k in range(given.seeds)]
            line(words, against, [windows_of(r, top_hz=top) for r in emulated])
    return 0


if __name__ == "__main__":
    sys.exit(main())
