"""``insemu gap`` on five real recordings with the beliefs that the pages show, as a user copies them: ``python -m tests.real_gaps``.

Then a scenario of one of them is refined, flown beside its own designs through its outages and through one at every second, and looked at again.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tempfile
from pathlib import Path

from insemu.units import datasheet
from tests.claims import ROOT
from tests.shared_data import root


def belief(name: str, after: str) -> str:
    """The belief file that a page shows below a line."""
    page = (ROOT / "docs" / name).read_text(encoding="utf-8")
    block = re.search(r"(?:^    .*\n)+", page[page.index(after) :], re.M)
    assert block is not None, after
    return "\n".join(line[4:] for line in block[0].splitlines()) + "\n"


def cases(folder: Path) -> dict[str, Path]:
    """What is believed of each recording: the file, made in ``folder`` where a page shows it."""
    car, own = belief("gap.md", "The key `vehicle` states"), "real_recordings.md"
    at_rest = belief(own, "## ADIS16405 at rest")
    shown = {
        "rtkexp_drive": car,
        "rtkexp_drive, positions alone": car + "gnss: {velocity_sigma: null}\n",
        "thor75_uav_flight": belief(own, "## Fixed-wing UAV"),
        "adis16405_static_run1": at_rest,
        "ch104_static": at_rest,
    }
    for name, text in shown.items():
        (folder / f"{name}.yaml").write_text(text, encoding="utf-8")
    return {name: folder / f"{name}.yaml" for name in shown} | {
        "ublox_mixed_nominal": ROOT / "scenarios" / "real_drive_ublox.yaml",
    }


def insemu(*words: str) -> bool:
    """Whether a command fails; it prints to the same terminal."""
    return subprocess.run([sys.executable, "-m", "insemu", *words], check=False).returncode != 0


def jumps(answer: Path) -> list[str]:
    """Steps of a bias that an answer names, in units of datasheets: they may stand behind those that the terminal shows."""
    steps = json.loads(answer.read_text(encoding="utf-8"))["steps"] if answer.exists() else []
    out = []
    for step in (s for s in steps if s["effect"] == "bias_step"):
        size, start = step["parameters"]
        factor, unit = datasheet(1.0, size["unit"])
        where = f"{step['sensor']} {', '.join(step['axes'])}"
        out.append(f"bias step of {where}: {factor * size['value']:.3g} {unit} at {start['value']:.4g} s")
    return out


def main() -> int:
    """Print what the command says of each recording."""
    wrong = 0
    with tempfile.TemporaryDirectory() as folder:
        for name, said in cases(Path(folder)).items():
            print(f"-- {name}", flush=True)
            measured = str(root() / "real" / f"{name.partition(',')[0]}.npz")
            words = ["gap", str(said), measured, "--output", str(Path(folder) / name)]
            wrong += insemu(*words)
            for line in jumps(Path(folder) / name / "gap.json"):
                print(line, flush=True)
        print("-- scenarios/real_drive_rtk.yaml", flush=True)
        drive, out = str(root() / "real" / "rtkexp_drive.npz"), Path(folder) / "tuned"
        wrong += insemu("gap", str(ROOT / "scenarios" / "real_drive_rtk.yaml"), drive, "--output", str(out))
        refined = str(out / "refined.yaml")
        wrong += insemu("run", refined, "--no-pictures", "--output", str(out / "run"))
        wrong += insemu("solve", drive, "--against", refined, "--output", str(out / "solved"))
        wrong += insemu("gap", refined, drive, "--output", str(out / "again"))
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
