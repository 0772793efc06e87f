"""Pages of the reference that are made from the code: commands, settings, exit codes, library.

As a program it writes the table of names at the end of docs/library.md anew.
"""

import inspect
import re
import textwrap
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import click
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

import imumon

WIDTH = 80
"""Columns of a help text."""
NAMES = Path(__file__).resolve().parents[2] / "docs" / "library.md"
"""Page that ends with the table of names."""


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
    """Return the keys of every file that a user writes, with type, default and meaning."""
    from imumon.protocols.fixed import FixedDevice, SeveralDevice
    from imumon.protocols.text import TextDevice
    from imumon.recordings.map import TableMap
    from imumon.run.setup import Setup
    from imumon.simulation.unit.scenario import Scenario

    files: list[tuple[str, str, type[BaseModel]]] = [
        ("Pipeline file", "pipeline-files.md", Setup),
        ("Device file, packets of a fixed length", "device-files.md", FixedDevice),
        ("Device file, several packets", "device-files.md", SeveralDevice),
        ("Device file, lines of text", "device-files.md", TextDevice),
        ("Map of a table", "import-map.md", TableMap),
        ("Scenario", "simulation.md", Scenario),
    ]
    parts = [
        "# Settings\n\nThe keys of the YAML files that a user writes. A key without a default is required.\n"
    ]
    shown: set[type[BaseModel]] = set()
    for title, page, model in files:
        parts.append(f"## {title}\n\nExplained in [{page}](../{page}).\n")
        parts += _tables(model, "", shown)
    return "\n".join(parts)


def _tables(model: type[BaseModel], path: str, shown: set[type[BaseModel]]) -> Iterator[str]:
    """Yield a table of a model's keys, then those of the models within it that were not shown yet."""
    shown.add(model)
    about = _parameters(model.__doc__ or "")
    heading = f"**`{path}`**\n\n" if path else ""
    yield heading + "| key | type | default | meaning |\n|---|---|---|---|"
    inner: list[tuple[str, type[BaseModel]]] = []
    for name, field in model.model_fields.items():
        if field.exclude:
            continue
        meaning = about.get(name) or field.description or ""
        yield f"| `{name}` | {_type(field)} | {_default(field)} | {_cell(meaning)} |"
        inner += [(f"{path}.{name}".lstrip("."), one) for one in _models(field.annotation)]
    yield ""
    for where, one in inner:
        if one not in shown:
            yield from _tables(one, where, shown)


def _models(annotation: Any) -> list[type[BaseModel]]:
    """Return the models of files that stand in an annotation."""
    if inspect.isclass(annotation) and issubclass(annotation, BaseModel):
        is_own_file = "format" in annotation.model_fields
        return [annotation] if annotation.model_fields and not is_own_file else []
    return [one for part in get_args(annotation) for one in _models(part)]


def _type(field: FieldInfo) -> str:
    limits = [_limit(one) for one in field.metadata]
    return _cell(" ".join([_type_name(field.annotation), *filter(None, limits)]))


def _type_name(annotation: Any) -> str:
    origin, args = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return " ".join([_type_name(args[0]), *filter(None, map(_limit, args[1:]))])
    if origin is Literal:
        return " or ".join(f"`{value}`" for value in args)
    if origin in (Union, types.UnionType):
        return " or ".join(dict.fromkeys(_type_name(one) for one in args if one is not type(None)))
    if origin in (list, tuple):
        return f"list of {_type_name(args[0])}" if args else "list"
    if origin is dict:
        return f"mapping of {_type_name(args[1])}"
    names = {float: "number", int: "integer", str: "text", bool: "true or false"}
    if annotation in names:
        return names[annotation]
    return "mapping" if inspect.isclass(annotation) and issubclass(annotation, BaseModel) else "value"


def _limit(limit: object) -> str:
    """Return a limit of a number in words; empty for other metadata."""
    words = {"gt": "above", "ge": "from", "lt": "below", "le": "to"}
    found = [f"{word} {getattr(limit, name):g}" for name, word in words.items() if hasattr(limit, name)]
    return " ".join(found)


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    value = field.get_default(call_default_factory=True, validated_data={})
    if value is None or value is PydanticUndefined or value in ([], {}, ()):
        return "none"
    return "see below" if isinstance(value, BaseModel) else f"`{value}`"


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
    return re.sub(r"``(.*?)``", r"`\1`", text).replace("|", "\\|").replace("\n", " ")


def exit_codes() -> str:
    """Return the exit codes of commands, and the reasons that lead to them."""
    from imumon import errors

    codes = {name: getattr(errors, name) for name in dir(errors) if name.startswith("EXIT_")}
    meanings = _constants(inspect.getsource(errors))
    parts = ["# Exit codes\n\n| code | meaning |\n|---:|---|"]
    parts += [
        f"| {code} | {_cell(meanings[name])} |"
        for name, code in sorted(codes.items(), key=lambda one: one[1])
    ]
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


def page_of_names() -> str:
    """Return the page of the library with its table of names as it should be."""
    head = "|---|---|\n"
    rows = []
    for name in imumon.__all__:
        offered = getattr(imumon, name)
        parameters = ", ".join(inspect.signature(offered).parameters) if inspect.isfunction(offered) else None
        if not isinstance(offered, str):
            called = name if parameters is None else f"{name}({parameters})"
            about = _cell((inspect.getdoc(offered) or "").partition("\n\n")[0])
            rows.append(f"| `imumon.{called}` | {about} |\n")
    return NAMES.read_text(encoding="utf-8").rpartition(head)[0] + head + "".join(rows)


def _members(offered: type) -> Iterator[tuple[str, Any]]:
    """Yield the public methods and properties that a class defines itself, with a docstring."""
    for name, value in vars(offered).items():
        if (
            not name.startswith("_")
            and inspect.getdoc(value)
            and (callable(value) or isinstance(value, property))
        ):
            yield name, value


def _described(name: str, offered: Any, heading: str) -> str:
    """Return a heading, the signature, the text of the docstring, and a table of its parameters."""
    doc = inspect.getdoc(offered) or ""
    parts = [f"{heading} {name}\n"]
    if callable(offered) and not inspect.isclass(offered):
        signature = (
            str(inspect.signature(offered)).replace("'", "").replace("(self, ", "(").replace("(self)", "()")
        )
        parts.append(_fenced(textwrap.fill(f"{name}{signature}", WIDTH, subsequent_indent="    ")))
    text = doc.partition("Parameters\n----------\n")[0].rstrip()
    parts.append(re.sub(r"``(.*?)``", r"`\1`", text) + "\n")
    parameters = _parameters(doc)
    if parameters:
        rows = [f"| `{one}` | {_cell(meaning)} |" for one, meaning in parameters.items()]
        parts.append("\n".join(["| parameter | meaning |", "|---|---|", *rows, ""]))
    return "\n".join(parts)


def _fenced(text: str) -> str:
    return f"```text\n{text.rstrip()}\n```\n"


if __name__ == "__main__":
    NAMES.write_text(page_of_names(), encoding="utf-8")
