"""The conda recipe asks for what the package asks for; consoles with a small character set get the answer."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parent.parent
#: Names that conda-forge has otherwise.
CONDA = {"matplotlib": "matplotlib-base"}


def _parts(text: str) -> tuple[str, str]:
    name, version = re.fullmatch(r"([A-Za-z0-9_-]+)(?:\[win32\])?\s*(.*)", text).groups()  # type: ignore[union-attr]
    return CONDA.get(name.lower(), name.lower()), version.strip()


def test_the_conda_recipe_has_the_dependencies_of_the_package() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    recipe = (ROOT / "conda" / "meta.yaml").read_text(encoding="utf-8")
    run = recipe.split("  run:\n")[1].split("test:")[0]
    asked = dict(_parts(line.strip("- \n")) for line in run.splitlines())
    assert asked.pop("pywin32") == "# [win]"  # conda has no extras: this is portalocker[win32]
    assert asked.pop("python") == project["requires-python"]
    assert asked == dict(map(_parts, project["dependencies"]))


def test_the_lock_file_has_the_versions_of_the_constraints_with_hashes() -> None:
    locked = re.split(r"\n(?! )", (ROOT / "requirements.lock").read_text(encoding="utf-8").strip())
    assert [entry.split(" ")[0] for entry in locked] == (ROOT / "constraints.txt").read_text(encoding="utf-8").split()
    for entry in locked:
        assert re.fullmatch(r"\S+( \\\n    --hash=sha256:[0-9a-f]{64})+", entry), entry


def test_workflows_call_the_scripts_of_the_project() -> None:
    jobs = yaml.safe_load((ROOT / ".github" / "workflows" / "ci.yml").read_text(encoding="utf-8"))["jobs"]
    runs = [step["run"] for job in jobs.values() for step in job["steps"] if "run" in step]
    assert "make test PYTHON=python" in runs and ".ci/run" in runs
    assert len(jobs["test"]["strategy"]["matrix"]["os"]) == 3


def test_a_console_of_windows_gets_the_answer() -> None:
    environment = os.environ | {"PYTHONIOENCODING": "cp1252", "PYTHONUTF8": "0"}
    done = subprocess.run(
        [sys.executable, "-m", "insemu", "sensor", "ADIS16470"], capture_output=True, env=environment, check=False
    )
    assert done.returncode == 0, done.stderr
    assert "deg/sqrt(h)" in done.stdout.decode("cp1252")


def _says_encoding(call: ast.Call) -> bool:
    mode = call.args[1].value if len(call.args) > 1 and isinstance(call.args[1], ast.Constant) else "r"
    if isinstance(call.func, ast.Attribute):  # path.open(mode), path.read_text()
        mode = (
            call.args[0].value
            if call.func.attr == "open" and call.args and isinstance(call.args[0], ast.Constant)
            else "r"
        )
    return "b" in str(mode) or any(k.arg in ("encoding", None) for k in call.keywords)


def test_every_text_is_read_and_written_in_a_stated_encoding() -> None:
    odd = []
    for path in sorted((ROOT / "insemu").rglob("*.py")):
        source = path.read_text(encoding="utf-8")
        if not re.search(r"(read_text|write_text|open)\(", source):
            continue
        for node in ast.walk(ast.parse(source)):
            if isinstance(node, ast.Call):
                name = getattr(node.func, "attr", getattr(node.func, "id", ""))
                text = name in ("read_text", "write_text") or (name == "open" and isinstance(node.func, ast.Name))
                if text and not _says_encoding(node):
                    odd.append(f"{path.relative_to(ROOT)}:{node.lineno}")
    assert odd == []
