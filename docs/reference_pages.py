"""Pages of the reference that are made from the code: commands, scenario keys, effects, processes, Python names, conventions."""

from __future__ import annotations

import ast
import importlib
import inspect
import re
from pathlib import Path
from typing import Any

import yaml

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
    "solve",
    "transfer",
    "array",
    "require",
    "referee",
    "drives",
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
    if "x-unit" in p:
        return f"quantity in `{p['x-unit']}`"
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


def _resolved(p: dict[str, Any], whole: dict[str, Any]) -> list[tuple[str, dict[str, Any]]]:
    """The sections that a key may hold: name (of a reference) and schema."""
    if "$ref" in p:
        name = p["$ref"].rsplit("/", 1)[-1]
        return [(name, whole["$defs"][name])]
    found = [("", p)] if "properties" in p or "items" in p or "additionalProperties" in p else []
    return found + [x for key in ("anyOf", "oneOf", "allOf") for q in p.get(key, ()) for x in _resolved(q, whole)]


def _uses(
    data: Any, name: str, section: dict[str, Any], whole: dict[str, Any], found: dict[tuple[str, str], Any]
) -> None:
    """Collect the shortest use of every key of a section, and of those below, in the data of a file."""
    if isinstance(data, list):
        for item in data:
            for inner, below in _resolved(section.get("items", {}), whole):
                _uses(item, inner, below, whole, found)
    elif isinstance(data, dict):
        known = section.get("properties", {})
        for key, value in data.items():
            below = known.get(key) or section.get("additionalProperties")
            if key in known:
                held = found.get((name, key))
                found[name, key] = value if held is None or len(str(value)) < len(str(held)) else held
            for inner, next_section in _resolved(below, whole) if isinstance(below, dict) else ():
                fits = (
                    not isinstance(value, dict)
                    or not next_section.get("properties")
                    or set(value) <= set(next_section["properties"])
                )
                if fits:
                    _uses(value, inner, next_section, whole, found)


def examples(whole: dict[str, Any]) -> dict[tuple[str, str], Any]:
    """An example of every scenario key: the shortest use in the scenarios and tutorials, all of which are run by tests; else the schema's."""
    found: dict[tuple[str, str], Any] = {}
    root = Path(__file__).resolve().parent.parent
    folders = ("scenarios", "docs/scenario_examples")
    texts = [p.read_text(encoding="utf-8") for folder in folders for p in sorted((root / folder).glob("*.yaml"))]
    for page in sorted((root / "docs").glob("*/*.md")):
        texts += re.findall(
            r"^```\{code-block\} yaml\n:caption: .*?\n\n?(.*?)^```", page.read_text(encoding="utf-8"), re.S | re.M
        )
    for text in texts:
        data = yaml.safe_load(text)
        if isinstance(data, dict):
            _uses(data, "A scenario", whole, whole, found)
            for changes in (data.get("variants") or {}).values():
                _uses(changes, "A scenario", whole, whole, found)
    for name, section in sections(whole).items():
        for key, p in section["properties"].items():
            if (name, key) not in found and p.get("examples"):
                found[name, key] = p["examples"][0]
    return found


def sections(whole: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """The sections of a scenario that have keys."""
    every = {"A scenario": whole, **dict(sorted(whole.get("$defs", {}).items()))}
    return {name: section for name, section in every.items() if section.get("properties")}


def _plain(default: Any) -> bool:
    """Whether a default is worth showing: sections and empty values are not."""
    return default not in (None, [], "") and not isinstance(default, dict)


def _example(value: Any) -> str:
    """A value as it stands in a file, in one line of moderate length."""
    text = (
        yaml.safe_dump(value, default_flow_style=True, sort_keys=False, allow_unicode=True, width=10_000)
        .replace("\n...", "")
        .strip()
    )
    return "" if value is None else f"`{text if len(text) <= 90 else text[:87] + '...'}`"


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
    shown = examples(whole)
    for name, section in sections(whole).items():
        lines += [
            f"## {name}",
            "",
            inspect.cleandoc(section.get("description", "") if name != "A scenario" else ""),
            "",
        ]
        lines += ["| key | type | default | example | meaning |", "| --- | --- | --- | --- | --- |"]
        required = section.get("required", ())
        for key, p in section["properties"].items():
            default = "required" if key in required else f"`{p['default']}`" if _plain(p.get("default")) else ""
            example = _example(shown.get((name, key)))
            lines.append(
                f"| `{key}` | {_cell(_type(p))} | {_cell(default)} | {_cell(example)} | {_cell(p.get('description', ''))} |"
            )
        lines.append("")
    return lines


def standards() -> dict[str, str]:
    """Term and clause of every effect that the page of standards lists."""
    page = (Path(__file__).parent / "standards.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(\w+)` \| (.+?) \| (.+?) \|$", page, re.M)
    return {name: f"{term} ({clause})" for name, term, clause in rows}


def effects() -> list[str]:
    """The list of effects: one table of all, then each by itself."""
    from insemu.effects import EFFECTS

    lines = [
        "# Effects",
        "",
        "Errors of sensors, clocks, receivers, aids and the model. `{s}` is the unit of the sensor's signal.",
        "",
        "| effect | sensor | formula |",
        "| --- | --- | --- |",
        *(f"| [`{e.id}`](#{e.id}) | {', '.join(e.sensors)} | {_cell(e.formula)} |" for e in EFFECTS.values()),
        "",
    ]
    clauses = standards()
    for effect in EFFECTS.values():
        lines += [
            f"## {effect.id}",
            "",
            f"{effect.name[0].upper()}{effect.name[1:]} ({effect.family}; {', '.join(effect.sensors)}).",
            "",
        ]
        lines += [f"`{effect.formula}`", "", f"Shown by: {effect.excitation}. In a filter: {effect.in_filter}.", ""]
        lines += [f"[Standard](../standards.md): {clauses[effect.id]}.", ""] if effect.id in clauses else []
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


def top() -> list[str]:
    """The names at the top."""
    lines = [
        "# import insemu as ins",
        "",
        inspect.cleandoc(importlib.import_module("insemu.api").__doc__ or ""),
        "",
        "Names that stand elsewhere, too: "
        + ", ".join(
            f"`ins.{n}` ([insemu.{r.split('.')[0]}](python_{r.split('.')[0]}.md))"
            for n, r in sorted(insemu._TOP.items())
            if r != "api"
        )
        + ".",
        "",
    ]
    api = importlib.import_module("insemu.api")
    for name in sorted(n for n, r in insemu._TOP.items() if r == "api"):
        lines += [f"## ins.{name}", "", *_autodoc(getattr(api, name))]
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


def _template(node: ast.expr) -> str:
    """Text of a message with its variable parts as ``...``."""
    if isinstance(node, ast.Constant):
        return str(node.value)
    if isinstance(node, ast.JoinedStr):
        return "".join(_template(part) for part in node.values)
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        return _template(node.left) + _template(node.right)
    return "..."


def messages() -> list[str]:
    """Every message of bad input, room by room."""
    root = Path(insemu.__file__).parent
    found: dict[str, set[str]] = {}
    for path in sorted(root.rglob("*.py")):
        room = path.relative_to(root).parts[0].removesuffix(".py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            named = (
                isinstance(node, ast.Call)
                and isinstance(node.func, ast.Name)
                and node.func.id in ("InputError", "NotStationary")
            )
            if named and node.args:
                text = re.sub(r"(\.\.\.)+", "...", _template(node.args[0])).strip()
                found.setdefault(room, set()).update({text} - {"..."})
    lines = [
        "# Messages",
        "",
        "What insemu says of bad input, `...` standing for names and values. The usual ones with what to do: [errors](../explained/errors.md).",
        "",
    ]
    for room, texts in found.items():
        lines += [f"## {room}", "", *(f"- {_code(text)}" for text in sorted(texts)), ""]
    return lines


def _code(text: str) -> str:
    """Text as it stands, whatever marks it holds."""
    text = " ".join(text.split())
    return f"`` {text} ``" if "`" in text else f"`{text}`"


def conventions() -> list[str]:
    """Units, frames and signs: the docstring of the package."""
    return ["# Conventions", "", "```text", inspect.cleandoc(insemu.__doc__ or ""), "```"]


def evidence() -> list[str]:
    """What the figures of the pages rest on, from ``docs/claims.yaml`` and from the last run of its commands."""
    from tests.claims import claims, commands, digest, jobs, runs, said, seed

    covered, _ = claims()
    kept = runs()
    dates = sorted(last["date"] for last in kept.values())
    lines = [
        "# Evidence",
        "",
        "What the figures of README and these pages rest on: another program or a published table (external); a formula, or the exact "
        "covariance of the linear error equations, in which nothing is drawn (closed form); real data; or insemu's own draws (own simulation). "
        "Inputs, limits and definitions are settings, which claim nothing. `python -m tests.claims` counts them; `--run cheap` runs the quick "
        "commands again, as CI does, `--run all` all of them, as a nightly job does; both fail where a figure is not printed any more.",
        "",
        *(f"- {line}" for line in said(covered)),
        "",
        f"Commands run last between {dates[0]} and {dates[-1]}." if dates else "No command was run yet.",
        "",
        "| figures | evidence | tolerance | seed | command or test | run last |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    rows: dict[tuple[str, ...], int] = {}
    found = jobs(covered)
    for claim in covered:
        if claim.evidence in ("setting", "none"):
            continue
        entry = claim.entry
        makes = [" && ".join(commands(entry))] + [f"check: {c}" for c in commands(entry, "check")]
        shown = "; ".join(_code(m) for m in makes if m) or _code(str(entry.get("test")))
        last = [
            "" if m not in kept else f"{kept[m]['date']}, {'agreed' if kept[m]['agreed'] else 'moved'}"
            + ("" if kept[m]["digest"] == digest(found[m]) else " (figures changed since)")
            for m in makes if m
        ]  # fmt: skip
        within = f"{100 * float(entry['within']):g} %" if "within" in entry else "digits shown"
        place = f"{claim.figure.page}, {_cell(claim.figure.head)}"
        row = (place, claim.evidence, within, _cell(seed(entry) or "none"), shown, "; ".join(w for w in last if w))
        rows[row] = rows.get(row, 0) + 1
    lines += [f"| {row[0]}: {n} | {' | '.join(row[1:])} |" for row, n in rows.items()]
    return lines


def limits() -> list[str]:
    """Limits of size, from the constants that the code checks."""
    from insemu import yamlfile
    from insemu.emulate import commands as motion
    from insemu.emulate import gnss, table
    from insemu.evaluate import ahead, emulated
    from insemu.noise import grammar
    from insemu.scenario import fields
    from insemu.scenario.schema import MAX_DURATION, MAX_RATE, MAX_REALIZATIONS

    slow, fast = ahead.EPOCHS_PER_SECOND
    rows = [
        ("bytes of a scenario or belief file", yamlfile.MAX_BYTES, "yamlfile.MAX_BYTES"),
        ("levels of nesting in it", yamlfile.MAX_DEPTH, "yamlfile.MAX_DEPTH"),
        ("values in it, aliases counted each time", yamlfile.MAX_VALUES, "yamlfile.MAX_VALUES"),
        ("largest whole number in it", yamlfile.MAX_INTEGER, "yamlfile.MAX_INTEGER"),
        ("characters of a name of a design or a variant", fields.MAX_NAME, "scenario.fields.MAX_NAME"),
        ("processes of an axis, effects of a scenario", fields.MAX_ITEMS, "scenario.fields.MAX_ITEMS"),
        ("processes of a model that is written as text", grammar.MOST_PROCESSES, "noise.grammar.MOST_PROCESSES"),
        ("characters of that text", grammar.LONGEST_TEXT, "noise.grammar.LONGEST_TEXT"),
        ("rate of an IMU, Hz", MAX_RATE, "scenario.schema.MAX_RATE"),
        ("length of an emulated or simulated record, s", MAX_DURATION, "scenario.schema.MAX_DURATION"),
        ("realizations", MAX_REALIZATIONS, "scenario.schema.MAX_REALIZATIONS"),
        ("samples of a flight that is held as a whole", emulated.MAX_SAMPLES, "evaluate.emulated.MAX_SAMPLES"),
        ("samples of an emulated recording, nodes of a path", table.MOST_NODES, "emulate.table.MOST_NODES"),
        ("outages drawn at random", gnss.MOST_OUTAGES, "emulate.gnss.MOST_OUTAGES"),
        ("height that a motion command may ask for, m", motion.HIGHEST, "emulate.commands.HIGHEST"),
        ("speed that a motion command may ask for, m/s", motion.FASTEST, "emulate.commands.FASTEST"),
    ]
    return [
        "# Sizes",
        "",
        "What is checked before work begins; more is refused with the place, what was found and what was expected. Made from the constants of "
        "the code.",
        "",
        "| limit | at most | constant |",
        "| --- | --- | --- |",
        *(f"| {what} | {value:,.0f} | `insemu.{name}` |" for what, value, name in rows),
        "",
        f"`run` and `compare` print time and memory beforehand: from {slow:,.0f} to {fast:,.0f} filter epochs per second and core "
        "with eight realizations side by side, "
        f"{emulated.BYTES_PER_SAMPLE} bytes per sample of a flight for the reference and for each realization that is flown at a time. "
        "What wants more memory than the system says is free is refused. "
        f"An emulated recording takes {table.SAMPLE_BYTES} bytes per sample, a path {table.KNOT_BYTES} per knot; "
        "more than the machine has is refused.",
    ]


def write_reference(folder: Path) -> None:
    """Write every page that is made from the code; pages that did not change are left alone, so that the site is built faster."""
    folder.mkdir(exist_ok=True)
    pages = {
        maker.__name__: maker()
        for maker in (commands, scenario, effects, processes, top, python, conventions, messages, evidence, limits)
    }
    for name, lines in {**pages, **{f"python_{name}": room(name) for name in ROOMS}}.items():
        text = "\n".join(lines) + "\n"
        page = folder / f"{name}.md"
        if not page.exists() or page.read_text(encoding="utf-8") != text:
            page.write_text(text, encoding="utf-8")
