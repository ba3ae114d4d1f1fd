"""Where a result comes from: code, packages, machine, inputs and seeds; the same as an RO-Crate; and whether a second run agrees with the first."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import re
import subprocess
from collections.abc import Mapping
from functools import cache
from importlib import metadata
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

import insemu
from insemu.scenario import code_version

if TYPE_CHECKING:
    import xarray as xr


#: The file that RO-Crate prescribes.
CRATE = "ro-crate-metadata.json"
_CONTEXT = "https://w3id.org/ro/crate/1.1"


def sha256(path: Path) -> str:
    """Hash of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def git_revision() -> str | None:
    """Revision of the checkout that the package runs from, or None."""
    root = Path(insemu.__file__).resolve().parents[1]
    try:
        found = subprocess.run(
            ["git", "-C", str(root), "describe", "--always", "--dirty"],
            capture_output=True,
            text=True,
            timeout=10,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return found.stdout.strip() or None if found.returncode == 0 else None


@cache
def locked() -> Mapping[str, str]:
    """Version of every installed package that insemu needs, directly or through another; looked up once."""
    out: dict[str, str] = {}
    todo = ["insemu"]
    while todo:
        if (key := re.sub(r"[-_.]+", "-", todo.pop()).lower()) in out:
            continue
        try:
            found = metadata.distribution(key).metadata  # parsed at every look
        except metadata.PackageNotFoundError:  # a marker of another system or Python
            continue
        out[key] = found["Version"]
        needs = found.get_all("Requires-Dist") or ()
        todo += [m[0] for r in needs if "extra ==" not in r and (m := re.match(r"[\w.-]+", r))]
    out.pop("insemu", None)
    return MappingProxyType(dict(sorted(out.items())))


def surroundings(inputs: Mapping[str, Path]) -> dict[str, Any]:
    """What a result depends on together with the scenario.

    Parameters
    ----------
    inputs : mapping of str to path
        Files that the scenario names, as it names them.
    """
    return {
        "insemu": insemu.__version__,
        "source_sha256": code_version(),
        "git": git_revision(),
        "python": platform.python_version(),
        "packages": dict(locked()),
        "machine": {"system": platform.platform(), "processor": platform.machine(), "cores": os.cpu_count()},
        "inputs": {name: sha256(path) for name, path in sorted(inputs.items()) if path.is_file()},
    }


def crate(title: str, manifest: Mapping[str, Any], files: Mapping[str, str]) -> str:
    """The folder of a result as an RO-Crate (version 1.1).

    Parameters
    ----------
    title : str
    manifest : mapping
        With what :func:`surroundings` gives, and the seed.
    files : mapping of str to str
        Path in the folder to its sha256.

    Source
    ------
    Soiland-Reyes et al. (2022).
    """
    kinds = {
        ".json": "application/json",
        ".csv": "text/csv",
        ".nc": "application/x-netcdf",
        ".html": "text/html",
        ".yaml": "application/yaml",
    }
    parts = [
        {
            "@id": name,
            "@type": "File",
            "encodingFormat": kinds.get(Path(name).suffix, "image/" + Path(name).suffix[1:]),
            "sha256": digest,
        }
        for name, digest in sorted(files.items())
    ]
    inputs = [
        {"@id": f"#input-{k}", "@type": "File", "name": n, "sha256": h}
        for k, (n, h) in enumerate(manifest["inputs"].items())
    ]
    software = {
        "@id": "#insemu",
        "@type": "SoftwareApplication",
        "name": "insemu",
        "softwareVersion": manifest["insemu"],
        "identifier": f"sha256:{manifest['source_sha256']}",
        "softwareRequirements": [
            f"python=={manifest['python']}",
            *(f"{n}=={v}" for n, v in manifest["packages"].items()),
        ],
    }
    made = {
        "@id": "#run",
        "@type": "CreateAction",
        "name": f"insemu run, seed {manifest['seed']}, digest {manifest['digest']}",
        "instrument": {"@id": "#insemu"},
        "object": [{"@id": "resolved.yaml"}, *({"@id": i["@id"]} for i in inputs)],
        "result": [{"@id": p["@id"]} for p in parts],
        "description": f"on {manifest['machine']['system']}, {manifest['machine']['processor']}, {manifest['machine']['cores']} cores",
    }
    root = {
        "@id": "./",
        "@type": "Dataset",
        "name": title,
        "hasPart": [{"@id": p["@id"]} for p in parts],
        "mentions": {"@id": "#run"},
    }
    head = {"@id": CRATE, "@type": "CreativeWork", "conformsTo": {"@id": _CONTEXT}, "about": {"@id": "./"}}
    return json.dumps(
        {"@context": f"{_CONTEXT}/context", "@graph": [head, root, software, made, *inputs, *parts]}, indent=1
    )


def changed(held: Mapping[str, Any], now: Mapping[str, Any], at: str = "") -> list[str]:
    """What of the surroundings is another than when a result was made, in words; what the result does not say is not compared.

    Parameters
    ----------
    held, now : mapping
        As :func:`surroundings` gives it.
    at : str
        What the keys belong to, for the words.
    """
    out = []
    for key in sorted(held.keys() | now.keys()):
        one, other = held.get(key), now.get(key)
        if isinstance(one, Mapping) and isinstance(other, Mapping):
            out += changed(one, other, f"{at}{key} ")
        elif one != other and one is not None:
            out.append(f"{at}{key}: {str(one)[:40]} then, {'not there' if other is None else str(other)[:40]} now")
    return out


def differences(held: xr.Dataset, again: xr.Dataset) -> list[str]:
    """What two results disagree in, variable by variable; empty where every number is the same to the last bit.

    Parameters
    ----------
    held, again : Dataset
        As :meth:`~insemu.evaluate.results.Results.to_dataset` gives it.
    """
    out = []
    for name in sorted({*map(str, held.variables), *map(str, again.variables)}):
        if name not in held.variables or name not in again.variables:
            out.append(f"{name}: only in the {'held' if name in held.variables else 'new'} result")
            continue
        one, other = held[name].to_numpy(), again[name].to_numpy()
        if one.shape != other.shape:
            out.append(f"{name}: shape {one.shape} then, {other.shape} now")
        elif one.dtype.kind not in "fiub":
            if (one.astype(str) != other.astype(str)).any():
                out.append(f"{name}: other labels")
        elif not np.array_equal(one, other, equal_nan=one.dtype.kind == "f"):
            one, other = one.astype(float), other.astype(float)
            unequal = ~((one == other) | (np.isnan(one) & np.isnan(other)))
            size = np.nanmax(np.abs(one)) if np.isfinite(one).any() else 0.0
            most = np.nanmax(np.abs(one - other)[unequal], initial=0.0)
            share = f", {most / size:.2g} of its largest value" if size > 0 else ""
            out.append(f"{name}: {int(unequal.sum())} of {one.size} numbers differ, by at most {most:.3g}{share}")
    return out
