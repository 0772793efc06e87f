"""Pages of the reference that are made from the code: commands, settings, exit codes, library."""

import functools
import inspect
import re
import textwrap
import types
from collections.abc import Callable, Iterator
from pathlib import Path
from pkgutil import resolve_name
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import click
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

import imumon

WIDTH = 80
"""Columns of a help text."""
DOCS = Path(__file__).resolve().parents[2] / "docs"
CODE = re.compile(r"`([^`]+)`")
LINK = re.compile(r"\[[^]]+\]\([^)]+#[^)]+\)")
"""What is code in a text; a link to a heading."""


def pages() -> dict[str, str]:
    """Return the text of each page by its path below docs."""
    return {
        "reference/commands.md": commands(),
        "reference/settings.md": settings(),
        "reference/exit-codes.md": exit_codes(),
        "reference/library.md": library(),
    }


def commands() -> str:
    """Return the help of every command, under the headings of ``imumon --help``."""
    from imumon import cli
    from imumon.wing import GROUPS

    every = cli.commands()
    parts = ["# Commands\n\nWhat `imumon COMMAND --help` prints, under the headings of `imumon --help`.\n"]
    root = click.Context(cli.cli, info_name="imumon")
    for group in GROUPS:
        parts.append(f"## {group}\n")
        for name in [name for name, one in every.items() if one.group == group]:
            found = cli.cli.get_command(root, name)
            assert found is not None
            parts.append(f"### {name}\n")
            parts += [_fenced(text) for text in _helps(found, root, name)]
    return "\n".join(parts)


def _helps(command: click.Command, parent: click.Context, name: str) -> Iterator[str]:
    """Yield the help of a command, and of those within it."""
    context = click.Context(
        command, info_name=name, parent=parent, max_content_width=WIDTH, terminal_width=WIDTH
    )
    yield command.get_help(context)
    if isinstance(command, click.Group):
        for inner in command.list_commands(context):
            found = command.get_command(context, inner)
            assert found is not None
            yield from _helps(found, context, inner)


def settings() -> str:
    """Return the keys of every file that a user writes, with type, unit, default and meaning."""
    files = [
        ("Pipeline file", "pipeline-files.md", "imumon.run.setup:Setup"),
        ("Device file, packets of a fixed length", "device-files.md", "imumon.protocols.fixed:FixedDevice"),
        ("Device file, several packets", "device-files.md", "imumon.protocols.fixed:SeveralDevice"),
        ("Device file, lines of text", "device-files.md", "imumon.protocols.text:TextDevice"),
        ("Map of a table", "import-map.md", "imumon.recordings.map:TableMap"),
        ("Scenario", "simulation.md", "imumon.simulation.unit.scenario:Scenario"),
        ("Unit file", "simulation.md", "imumon.simulation.unit.scenario:Unit"),
        ("Rack of units", "rack.md", "imumon.fleet.rack.description:RackFile"),
    ]
    parts = ["# Settings\n\nKeys of the YAML files that a user writes; one without a default is required.\n"]
    shown: set[type[BaseModel]] = set()
    for title, page, model in files:
        parts.append(f"## {title}\n\nExplained in [{page}](../{page}).\n")
        parts += _tables(resolve_name(model), "", shown, _meanings(page))
    return "\n".join(parts)


def _tables(
    model: type[BaseModel], path: str, shown: set[type[BaseModel]], meaning_of: Callable[[str], str]
) -> Iterator[str]:
    """Yield a table of a model's keys, then those of the models within it that were not shown yet."""
    about = _parameters(model.__doc__ or "")
    yield "| key | type | unit | default | meaning |\n|---|---|---|---|---|"
    places: dict[type[BaseModel], list[str]] = {}
    for name, field in _fields(model):
        place = f"{path}.{name}".lstrip(".")
        meaning = _cell(about.get(name) or meaning_of(place))
        yield f"| `{name}` | {_type(field)} | {_unit(name)} | {_default(field)} | {meaning} |"
        for inner in _models(field.annotation):
            places.setdefault(inner, []).append(f"`{place}`")
    yield ""
    for inner, names in places.items():
        if inner not in shown:
            shown.add(inner)
            title = ", ".join(names + [f"`kind: {kind}`" for kind in _kinds(inner)])
            about_it = _cell((inner.__doc__ or "").partition("\n\n")[0])
            yield f"### {title} {{: #{inner.__module__}.{inner.__name__} }}\n\n{about_it}\n"
            yield from _tables(inner, names[0].strip("`"), shown, meaning_of)


def _fields(model: type[BaseModel]) -> list[tuple[str, FieldInfo]]:
    """Return the keys of a model that still mean something."""
    return [(name, field) for name, field in model.model_fields.items() if not field.exclude]


def _models(annotation: Any) -> list[type[BaseModel]]:
    """Return the models with keys that stand in an annotation, but not those of files of their own."""
    if inspect.isclass(annotation) and issubclass(annotation, BaseModel):
        is_own_file = "imumon-" in str(annotation.model_fields.get("format"))
        return [annotation] if _fields(annotation) and not is_own_file else []
    return [one for part in get_args(annotation) for one in _models(part)]


def _kinds(model: type[BaseModel]) -> tuple[str, ...]:
    """Return the kinds that a model is for."""
    return get_args(getattr(model.model_fields.get("kind"), "annotation", None))


UNIT = re.compile(r"_((rad|degc|deg|hours|hz|ppm|ug|mg|m|g|s)((_per|_sqrt|_per_sqrt)_(s[23]?|h|min))*)$")
"""The unit at the end of the name of a key."""
SIGNS = {"_per_": "/", "_sqrt": "/sqrt", "sqrt_": "√", "degc": "°C", "deg": "°", "hours": "h"}
SIGNS |= {"hz": "Hz", "ug": "µg", "s2": "s²", "s3": "s³"}


def _unit(key: str) -> str:
    found = UNIT.search(key)
    return functools.reduce(lambda text, sign: text.replace(*sign), SIGNS.items(), found[1] if found else "")


def _meanings(page: str) -> Callable[[str], str]:
    """Return what gives the meaning of a key by its path.

    A page explains keys in tables with the head "key", or "key of `PATH`" for those within another.  A key
    without a row is explained where a key that it is in names it, or behind the last link to a heading there.
    """
    text = re.sub(r"\]\((?!http|#)", "](../", (DOCS / page).read_text(encoding="utf-8"))
    texts = dict(_rows(text.replace("](#", f"](../{page}#")))

    def meaning_of(path: str) -> str:
        names = path.split(".")
        above = [texts.get(".".join(names[:at]), "") for at in range(len(names) - 1, 0, -1)]
        naming = [one for one in above if names[-1] in re.findall(r"\w+", " ".join(CODE.findall(one)))]
        links = [f"see {link}" for one in above for link in LINK.findall(one)[-1:]]
        return next(filter(None, [texts.get(path), *naming, *links]), "")

    return meaning_of


def _rows(text: str) -> Iterator[tuple[str, str]]:
    """Yield path and meaning of each key in tables of keys."""
    for head, rows in re.findall(r"^\| (key\b.*) \|\n\|[-|]+\|\n((?:\|.*\n?)+)", text, re.MULTILINE):
        titles = head.split(" | ")
        within = [f"{name}." for name in CODE.findall(titles[0])] or [""]
        for row in rows.splitlines():
            cells = dict(zip(titles, re.split(r"(?<!\\) \| ", row.strip("| ")), strict=False))
            meaning = "; see ".join(cells[title] for title in ("meaning", "described in") if title in cells)
            yield from ((f"{one}{key}", meaning) for one in within for key in CODE.findall(cells[titles[0]]))


def _type(field: FieldInfo) -> str:
    return _cell(" ".join([_type_name(field.annotation), *filter(None, map(_limit, field.metadata))]))


def _type_name(annotation: Any) -> str:
    origin, args = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return " ".join([_type_name(args[0]), *filter(None, map(_limit, args[1:]))])
    if origin is Literal:
        return " or ".join(f"`{value if str(value).strip() else repr(value)}`" for value in args)
    if origin in (Union, types.UnionType):
        return " or ".join(dict.fromkeys(_type_name(one) for one in args if one is not type(None)))
    if origin in (list, tuple):
        return f"list of {_type_name(args[0])}" if args else "list"
    if origin is dict:
        return f"mapping of {_type_name(args[1])}"
    names = {float: "number", int: "integer", str: "text", bool: "true or false"}
    if annotation in names:
        return names[annotation]
    for model in _models(annotation):
        return f"[{' or '.join(_kinds(model)) or 'mapping'}](#{model.__module__}.{model.__name__})"
    return "mapping" if inspect.isclass(annotation) and issubclass(annotation, BaseModel) else "value"


def _limit(limit: object) -> str:
    """Return a limit of a number in words; empty for other metadata."""
    words = {"gt": "above", "ge": "from", "lt": "below", "le": "to"}
    return " ".join(f"{words[name]} {getattr(limit, name):g}" for name in words if hasattr(limit, name))


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    value = field.get_default(call_default_factory=True, validated_data={})
    if value is PydanticUndefined or value in (None, "", [], {}, (), [None] * 3):
        return "none"
    if isinstance(value, BaseModel):
        return "see there"
    return f"`{str(value).lower() if isinstance(value, bool) else value}`"


def _parameters(docstring: str) -> dict[str, str]:
    """Return what the section Parameters of a docstring states of each name."""
    _, _, section = inspect.cleandoc(docstring).partition("Parameters\n----------\n")
    found: dict[str, str] = {}
    names: list[str] = []
    for line in section.splitlines():
        if line and not line.startswith(" "):
            names = [name.strip() for name in line.partition(" : ")[0].split(",")]
        else:
            for name in names:
                found[name] = f"{found.get(name, '')} {line.strip()}".strip()
    return found


def _cell(text: str) -> str:
    return re.sub(r"(?<![\\`])\|", r"\|", re.sub(r"``(.*?)``", r"`\1`", text)).replace("\n", " ")


def exit_codes() -> str:
    """Return the exit codes of commands, and the reasons that lead to them."""
    from imumon import errors

    codes = {name: getattr(errors, name) for name in dir(errors) if name.startswith("EXIT_")}
    meanings = _constants(inspect.getsource(errors))
    parts = ["# Exit codes\n\n| code | meaning |\n|---:|---|"]
    by_code = sorted(codes, key=codes.__getitem__)
    parts += [f"| {codes[name]} | {_cell(meanings[name])} |" for name in by_code]
    parts.append(
        "\nAn error is one message on standard error: what was found, and what to do. In Python it is an "
        "`imumon.ImumonError` with a `reason`:\n\n| reason | code | when |\n|---|---:|---|"
    )
    members = _constants(inspect.getsource(errors.Reason))
    parts += [f"| `{one.name}` | {one.exit_code} | {_cell(members[one.name])} |" for one in errors.Reason]
    return "\n".join(parts)


def _constants(source: str) -> dict[str, str]:
    """Return the text behind each assignment of a name in capitals."""
    found = re.findall(r'^ *([A-Z_]+) = [^\n]*\n\s*"""([^"]*)"""', source, re.MULTILINE)
    return {name: " ".join(text.split()) for name, text in found}


SECTIONS = {
    "Read recordings": ["read", "read_blocks", "Samples"],
    "Read a port": ["open", "Live"],
    "Settings and models": ["Setup", "load_setup", "load_model"],
    "Stages of your own": ["Estimator", "Pipeline", "SampleBlock", "Column"],
    "Errors": ["ImumonError", "Reason"],
}
"""What ``import imumon`` offers, by what it is for."""


def library() -> str:
    """Return signature and docstring of what ``import imumon`` offers."""
    parts = ["# What `import imumon` offers\n\nHow to use it is in [library](../library.md).\n"]
    for title, names in SECTIONS.items():
        parts.append(f"## {title}\n")
        for name in names:
            offered = getattr(imumon, name)
            parts.append(_described(name, offered, "###"))
            if inspect.isclass(offered):
                parts += [_described(f"{name}.{one}", value, "####") for one, value in _members(offered)]
    parts += ["## Conventions\n", _fenced(inspect.cleandoc(imumon.__doc__ or ""))]
    return "\n".join(parts)


def _members(offered: type) -> Iterator[tuple[str, Any]]:
    """Yield the public methods and properties that a class defines itself, with a docstring."""
    for name, value in vars(offered).items():
        is_public = inspect.getdoc(value) and not name.startswith("_")
        if is_public and (callable(value) or isinstance(value, property)):
            yield name, value


def _described(name: str, offered: Any, heading: str) -> str:
    """Return a heading, the signature, the text of the docstring, and a table of its parameters."""
    doc = inspect.getdoc(offered) or ""
    parts = [f"{heading} {name}\n"]
    if callable(offered) and not inspect.isclass(offered):
        parts.append(_fenced(textwrap.fill(f"{name}{_signature(offered)}", WIDTH, subsequent_indent="    ")))
    text = doc.partition("Parameters\n----------\n")[0].rstrip()
    parts.append(re.sub(r"``(.*?)``", r"`\1`", text) + "\n")
    parameters = _parameters(doc)
    if parameters:
        rows = [f"| `{one}` | {_cell(meaning)} |" for one, meaning in parameters.items()]
        parts.append("\n".join(["| parameter | meaning |", "|---|---|", *rows, ""]))
    return "\n".join(parts)


BESIDE = re.compile(r"\b(?:\w+\.)+(?=[A-Za-z])|self: None(?:, )?|(?<=None)Type|\[tuple.*?dtype.*?\]\]")
"""What a signature is shown without: modules, self, what arrays are of."""


def _signature(offered: Callable[..., Any]) -> str:
    """Return the signature as a caller needs it: types without limits."""
    hints, signature = get_type_hints(offered), inspect.signature(offered)
    parameters = [one.replace(annotation=hints.get(name)) for name, one in signature.parameters.items()]
    text = str(signature.replace(parameters=parameters, return_annotation=hints["return"]))
    return re.sub(r"Optional\[(\w+)\]", r"\1 | None", BESIDE.sub("", text))


def _fenced(text: str) -> str:
    return f"```text\n{text.rstrip()}\n```\n"
