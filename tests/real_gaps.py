"""``insemu gap`` on the three real drives with the beliefs that docs/gap.md shows, as a user copies them: ``python -m tests.real_gaps``."""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
from pathlib import Path

from tests.claims import ROOT
from tests.shared_data import root


def belief(after: str) -> str:
    """The belief file that the page shows below a line."""
    page = (ROOT / "docs" / "gap.md").read_text(encoding="utf-8")
    block = re.search(r"(?:^    .*\n)+", page[page.index(after) :], re.M)
    assert block is not None, after
    return "\n".join(line[4:] for line in block[0].splitlines()) + "\n"


def cases(folder: Path) -> dict[str, Path]:
    """What is believed of each drive: the file, made in ``folder`` where the page shows it."""
    car = belief("The key `vehicle` says")
    shown = {
        "rtkexp_drive": car,
        "rtkexp_drive, positions alone": car + "gnss: {velocity_sigma: null}\n",
        "thor75_uav_flight": belief("The belief about the third:\n"),
    }
    for name, text in shown.items():
        (folder / f"{name}.yaml").write_text(text, encoding="utf-8")
    return {name: folder / f"{name}.yaml" for name in shown} | {
        "ublox_mixed_nominal": ROOT / "scenarios" / "real_drive_ublox.yaml",
    }


def main() -> int:
    """Print what the command says of each drive."""
    wrong = 0
    with tempfile.TemporaryDirectory() as folder:
        for name, said in cases(Path(folder)).items():
            print(f"-- {name}", flush=True)
            measured = str(root() / "real" / f"{name.partition(',')[0]}.npz")
            words = ["gap", str(said), "--measured", measured, "--out", str(Path(folder) / name)]
            wrong += subprocess.run([sys.executable, "-m", "insemu", *words], check=False).returncode != 0
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
