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


def main() -> int:
    """Print what the command says of each drive."""
    wrong = 0
    with tempfile.TemporaryDirectory() as folder:
        cases: dict[str, str] = {
            "rtkexp_drive": belief("The key `vehicle` says"),
            "ublox_mixed_nominal": "",
            "thor75_uav_flight": belief("than both intervals leave open.\n"),
        }
        for name, text in cases.items():
            file = Path(folder) / f"{name}.yaml"
            file.write_text(text, encoding="utf-8")
            said = str(file) if text else str(ROOT / "scenarios" / "real_drive_ublox.yaml")
            measured = str(root() / "real" / f"{name}.npz")
            words = ["gap", said, "--measured", measured, "--out", str(Path(folder) / name)]
            wrong += subprocess.run([sys.executable, "-m", "insemu", *words], check=False).returncode != 0
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
