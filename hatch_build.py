"""Puts compiled kernels into the wheel: those of the folder INSEMU_KERNELS, which `make wheel` fills (.ci/kernels.py).

Without it the wheel is for any platform and compiles what it needs where it runs.
"""

from __future__ import annotations

import json
import os
import sys
import sysconfig
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class Kernels(BuildHookInterface):
    """Kernels are valid for one Python, one numba and one kind of processor, and the wheel says so."""

    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Add the folder, the tag of the platform, and the version of numba."""
        folder = os.environ.get("INSEMU_KERNELS")
        if not folder:
            return
        made = json.loads((Path(folder) / "made.json").read_text(encoding="utf-8"))
        python = "cp{}{}".format(*sys.version_info[:2])
        if made["Python"] != "{}.{}".format(*sys.version_info[:2]):
            raise ValueError(f"the kernels in {folder} are for Python {made['Python']}, this is {sys.version}")
        platform = sysconfig.get_platform().replace("-", "_").replace(".", "_")
        build_data["force_include"][folder] = "insemu/kernels"
        build_data["pure_python"] = False
        build_data["tag"] = f"{python}-{python}-{platform}"
        build_data["dependencies"].append(f"numba=={made['numba']}")
