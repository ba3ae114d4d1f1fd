"""Numbers that users rely on without writing them: defaults and limits of the scenario, typical sizes of the effects.

``python -m tests.test_tables`` writes ``tests/tables.yaml`` anew; a changed line there changes somebody's results and belongs into the changelog.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from insemu.effects import EFFECTS
from insemu.scenario.schema import Scenario

TABLES = Path(__file__).with_name("tables.yaml")
#: What the schema says of a key that changes what a scenario means.
_SAID = (
    "default",
    "exclusiveMinimum",
    "exclusiveMaximum",
    "minimum",
    "maximum",
    "minItems",
    "maxItems",
    "maxLength",
    "enum",
    "const",
)


def _limits(found: Any) -> Any:
    """The words of :data:`_SAID` of a piece of the schema, and of what it is made of."""
    if isinstance(found, list):
        return [part for part in map(_limits, found) if part]
    if not isinstance(found, dict):
        return None
    out = {word: found[word] for word in _SAID if word in found}
    out |= {
        word: _limits(found[word]) for word in ("anyOf", "items", "additionalProperties") if _limits(found.get(word))
    }
    return out


def tables() -> dict[str, Any]:
    """Everything, as plain data."""
    schema = Scenario.model_json_schema()
    sections = {"Scenario": schema, **schema["$defs"]}
    return {
        "scenario": {
            section: {key: _limits(value) for key, value in sections[section].get("properties", {}).items()}
            for section in sorted(sections)
        },
        "effects": {
            effect.id: {
                "stage": int(effect.stage),
                "sensors": list(effect.sensors),
                **{
                    p.name: {
                        "unit": p.unit, "size": p.size, "scale": [float(f"{v:.12g}") for v in p.scale], "default": p.default,
                        "positive": p.positive, "join": p.join, "nothing": p.nothing, "most": p.most,
                    }
                    for p in effect.parameters
                },
            }
            for effect in EFFECTS.values()
        },
    }  # fmt: skip


def _compared(found: Any, held: Any, where: str) -> list[str]:
    if isinstance(found, dict) and isinstance(held, dict):
        return [
            line
            for key in sorted({*found, *held})
            for line in _compared(found.get(key), held.get(key), f"{where}.{key}")
        ]
    return [] if found == held else [f"{where[1:]}: {found}, {TABLES.name} has {held}"]


def test_no_default_limit_or_typical_size_changes_unnoticed() -> None:
    assert not _compared(tables(), yaml.safe_load(TABLES.read_text(encoding="utf-8")), "")


if __name__ == "__main__":
    TABLES.write_text(yaml.safe_dump(tables(), sort_keys=False, width=150, default_flow_style=None), encoding="utf-8")
