"""Write ``requirements.lock``: the versions of ``constraints.txt`` with the hashes that the Python Package Index states.

Files for CPython 3.11 to 3.13 on any system, and sources; ``pip install --require-hashes -r requirements.lock`` takes no others.
"""

import json
import re
import sys
import urllib.request
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

WANTED = re.compile(r"-(cp31[123]-(cp31[123]|abi3)|cp3\d*-abi3|py3|py2\.py3)\b.*\.whl$|\.tar\.gz$")


def hashes(line: str) -> str:
    """A version with its files' hashes."""
    name, version = line.split("==")
    key = re.sub(r"[-_.]+", "-", name).lower()
    accept = {"Accept": "application/vnd.pypi.simple.v1+json"}
    with urllib.request.urlopen(
        urllib.request.Request(f"https://pypi.org/simple/{key}/", headers=accept), timeout=60
    ) as answer:
        files = json.load(answer)["files"]
    of_version = re.compile(
        re.escape(key).replace("\\-", "[-_.]+") + "-" + re.escape(version) + r"(-|\.tar)", re.IGNORECASE
    )
    found = sorted(
        f["hashes"]["sha256"] for f in files if of_version.match(f["filename"]) and WANTED.search(f["filename"])
    )
    if not found:
        sys.exit(f"{line}: no file for CPython 3.11 to 3.13 is on the index")
    return " \\\n".join([line, *(f"    --hash=sha256:{h}" for h in found)])


root = Path(__file__).resolve().parents[1]
with ThreadPoolExecutor(8) as pool:
    lines = [line for line in (root / "constraints.txt").read_text(encoding="utf-8").split("\n") if line]
    text = "\n".join(pool.map(hashes, lines)) + "\n"
(root / "requirements.lock").write_text(text, encoding="utf-8")
