"""The worlds in which filters are judged: scenarios over what comes with the package, one table (``worlds.yaml``)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np

from insemu import yamlfile
from insemu.errors import InputError, nearest
from insemu.evaluate import Experiment
from insemu.scenario import Scenario, validated

TABLE = Path(__file__).with_name("worlds.yaml")


@dataclass(frozen=True)
class World:
    """One row of the table.

    Parameters
    ----------
    name, says : str
        Name, and what it is in words.
    keys : mapping
        Of a scenario, without designs.
    tuning : mapping
        Factors on what filters are given there; not empty: the filter is given something wrong on purpose.
    """

    name: str
    says: str
    keys: Mapping[str, Any]
    tuning: Mapping[str, float]

    @property
    def wrong(self) -> bool:
        """Whether filters are given a wrong model on purpose."""
        return bool(self.tuning)

    def experiment(self, filter: str, settings: Mapping[str, Any], seed: int, **changes: Any) -> Experiment:
        """One filter in this world.

        Parameters
        ----------
        filter, settings
            As of a design.
        seed : int
            Of the referee; each world draws from one of its own.
        **changes
            Further keys of the scenario.
        """
        own = int(np.random.SeedSequence([seed, crc32(self.name.encode())]).generate_state(1)[0])
        belief = {"gyro": {"truth": True}, "accel": {"truth": True}, "options": {"tuning": self.tuning}}
        designs = {"designs": {"filter": {"filter": filter, "settings": dict(settings), **belief}}}
        data = yamlfile.merged(self.keys, {"title": self.name, "seed": own, **designs, **changes})
        return Experiment(validated(Scenario, yamlfile.Document(f"{TABLE.name}, {self.name}", data, {})))


@cache
def _table() -> Mapping[str, Any]:
    return dict(yamlfile.read(TABLE).data)


def worlds(names: Sequence[str] = ()) -> list[World]:
    """Worlds of the table, all unless some are named.

    Raises
    ------
    InputError
        A world that the table does not have.
    """
    table, common = _table()["worlds"], _table()["common"]
    for name in names:
        if name not in table:
            raise InputError(f"no world '{name}'" + nearest(name, table), where="--worlds")
    out = []
    for name in names or table:
        own = {k: v for k, v in table[name].items() if k not in ("says", "tuning")}
        out.append(World(name, table[name]["says"], yamlfile.merged(common, own), table[name].get("tuning", {})))
    return out


def starts() -> dict[str, World]:
    """Worlds whose filters start with large errors of attitude, by the standard deviation of tilt and heading."""
    given = _table()["convergence"]
    out = {}
    for sigma in given["sigmas"]:
        keys = yamlfile.merged(_table()["common"], given["scenario"])
        keys = yamlfile.merged(keys, {"initial": {"tilt_sigma": sigma, "heading_sigma": sigma}})
        out[sigma] = World(f"start {sigma}", f"tilt and heading off by {sigma}", keys, {})
    return out
