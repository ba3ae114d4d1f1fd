"""Pages of the reference that are made from the code: commands, scenario keys, effects, processes, Python names, conventions."""

from __future__ import annotations

import importlib
import inspect
from pathlib import Path
from typing import Any

import insemu

#: Rooms whose doors are documented name by name.
ROOMS = (
    "noise",
    "variance",
    "fit",
    "records",
    "formats",
    "sensors",
    "effects",
    "emulate",
    "filters",
    "scenario",
    "evaluate",
    "gap",
    "units",
    "errors",
)


def _cell(text: object) -> str:
    return " ".join(str(text).split()).replace("|", "\\|")


def commands() -> list[str]:
    """Every command with its arguments and options."""
    import typer.main

    from insemu.cli import app

    group = typer.main.get_command(app)
    lines = [
        "# Commands",
        "",
        "Exit codes: 0 done, 1 a check failed, 2 bad input, 130 interrupted. Every command takes `--help`.",
        "",
    ]
    for name, command in group.commands.items():  # type: ignore[attr-defined]
        lines += [
            f"## insemu {name}",
            "",
            inspect.cleandoc(command.help or ""),
            "",
            "| name | default | meaning |",
            "| --- | --- | --- |",
        ]
        for p in command.params:
            flags = (
                ", ".join(f"`{o}`" for o in (*p.opts, *p.secondary_opts))
                if p.param_type_name == "option"
                else f"`{p.name.upper()}`"
            )
            if p.name == "help":
                continue
            default = "" if p.default in (None, False, "", ()) or callable(p.default) else f"`{p.default}`"
            lines.append(f"| {flags} | {_cell(default)} | {_cell(getattr(p, 'help', '') or '')} |")
        lines.append("")
    return lines


def _type(p: dict[str, Any]) -> str:
    """Type of a key in words, with links to the sections that it refers to."""
    if "$ref" in p:
        name = p["$ref"].rsplit("/", 1)[-1]
        return f"[{name}](#{name.lower()})"
    if "const" in p:
        return f"`{p['const']}`"
    if "enum" in p:
        return " or ".join(f"`{v}`" for v in p["enum"])
    for key in ("anyOf", "oneOf", "allOf"):
        if key in p:
            return " or ".join(dict.fromkeys(_type(q) for q in p[key]))
    if p.get("type") == "array":
        return f"list of {_type(p['items'])}" if p.get("items") else "list"
    if p.get("type") == "object":
        inner = p.get("additionalProperties")
        return f"mapping of {_type(inner)}" if isinstance(inner, dict) and inner else "mapping"
    kinds = p.get("type", "value")
    words = {"string": "text", "null": "nothing", "boolean": "true or false"}
    return " or ".join(words.get(k, k) for k in ([kinds] if isinstance(kinds, str) else kinds))


def _plain(default: Any) -> bool:
    """Whether a default is worth showing: sections and empty values are not."""
    return default not in (None, [], "") and not isinstance(default, dict)


def scenario() -> list[str]:
    """Every key of a scenario file."""
    from insemu.scenario import schema

    whole = schema()
    lines = [
        "# Scenario keys",
        "",
        "Quantities are numbers with a unit, such as `20 ms` or `0.3 deg/sqrt(h)`. `insemu schema` prints the JSON schema for editors.",
        "",
    ]
    sections = {"A scenario": whole, **dict(sorted(whole.get("$defs", {}).items()))}
    for name, section in sections.items():
        if not section.get("properties"):
            continue
        lines += [
            f"## {name}",
            "",
            inspect.cleandoc(section.get("description", "") if name != "A scenario" else ""),
            "",
        ]
        lines += ["| key | type | default | meaning |", "| --- | --- | --- | --- |"]
        required = section.get("required", ())
        for key, p in section["properties"].items():
            default = "required" if key in required else f"`{p['default']}`" if _plain(p.get("default")) else ""
            lines.append(f"| `{key}` | {_cell(_type(p))} | {_cell(default)} | {_cell(p.get('description', ''))} |")
        lines.append("")
    return lines


def effects() -> list[str]:
    """The table of effects."""
    from insemu.effects import EFFECTS

    lines = [
        "# Effects",
        "",
        "What can be wrong with a sensor, a clock, a receiver or the model. `{s}` stands for the unit of the sensor's signal.",
        "",
    ]
    for effect in EFFECTS.values() if isinstance(EFFECTS, dict) else EFFECTS:
        lines += [
            f"## {effect.id}",
            "",
            f"{effect.name[0].upper()}{effect.name[1:]} ({effect.family}; {', '.join(effect.sensors)}).",
            "",
        ]
        lines += [f"`{effect.formula}`", "", f"Shown by: {effect.excitation}. In a filter: {effect.in_filter}.", ""]
        if effect.parameters:
            lines += ["| parameter | unit | numbers | default | meaning |", "| --- | --- | --- | --- | --- |"]
            for p in effect.parameters:
                default = "required" if p.default is None else f"{p.default:g}"
                lines.append(f"| `{p.name}` | {_cell(p.unit)} | {p.size} | {default} | {_cell(p.meaning)} |")
        lines.append("")
    return lines


def processes() -> list[str]:
    """The noise processes."""
    from insemu.noise import PROCESSES

    lines = [
        "# Noise processes",
        "",
        "A model is a sum: `2*GM() + WN(N=0.1 deg/sqrt(h))`. Values that are not given are fitted.",
        "",
    ]
    for name, cls in PROCESSES.items():
        lines += [f"## {name}", "", *_autodoc(cls)]
    return lines


def _autodoc(value: Any) -> list[str]:
    """What the docstring of a class or function says."""
    kind = "autoclass" if inspect.isclass(value) else "autofunction"
    members = [] if issubclass(type(value), type) and issubclass(value, Exception) else ["   :no-index:"]
    return ["```{eval-rst}", f".. {kind}:: {value.__module__}.{value.__qualname__}", *members, "```", ""]


def room(name: str) -> list[str]:
    """The names that a room offers."""
    module = importlib.import_module(f"insemu.{name}")
    lines = [f"# insemu.{name}", "", inspect.cleandoc(module.__doc__ or ""), ""]
    own = [n for n, v in vars(module).items() if getattr(v, "__module__", "") == module.__name__]
    for offered in sorted(n for n in getattr(module, "__all__", own) if not n.startswith("_")):
        value = getattr(module, offered)
        if inspect.isclass(value) or inspect.isfunction(value):
            lines += [f"## {offered}", "", *_autodoc(value)]
    return lines


def python() -> list[str]:
    """The rooms of the package, each with the names that it offers."""
    lines = [
        "# Python",
        "",
        "The names that each room offers. The map of the rooms is in [the architecture](../architecture.md).",
        "",
    ]
    return [*lines, "```{toctree}", *(f"python_{name}" for name in ROOMS), "```"]


def conventions() -> list[str]:
    """Units, frames and signs: the docstring of the package."""
    return ["# Conventions", "", "```text", inspect.cleandoc(insemu.__doc__ or ""), "```"]


def write_reference(folder: Path) -> None:
    """Write every page that is made from the code; pages that did not change are left alone, so that the site is built faster."""
    folder.mkdir(exist_ok=True)
    pages = {maker.__name__: maker() for maker in (commands, scenario, effects, processes, python, conventions)}
    for name, lines in {**pages, **{f"python_{name}": room(name) for name in ROOMS}}.items():
        text = "\n".join(lines) + "\n"
        page = folder / f"{name}.md"
        if not page.exists() or page.read_text(encoding="utf-8") != text:
            page.write_text(text, encoding="utf-8")
