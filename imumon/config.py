"""YAML files read strictly: unknown keys refused, every error with file, line and what was expected.

Each document is held to the limits below, whatever it is: a device, a pipeline, a map, a model, a session.
"""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args

import yaml
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from .errors import ImumonError, bad_config
from .files import read_text

DEEPEST = 50
"""Lists and mappings within each other; what imumon writes has ten at most."""
LARGEST_NUMBER = 2.0**63
"""No quantity is larger: times are int64, and squares of what is smaller are far from the end of float64."""

OPTIONS = {"imumon-bias-model": "model", "imumon-device": "device", "imumon-pipeline": "pipeline"}
"""Which option takes which files, by their `format` without its version."""

Location = tuple[str | int, ...]


class _Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]  # ten times as fast
    """PyYAML's safe loader, but 1e-6 is a number, as in YAML 1.2; no key twice."""

    source: str

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """Refuse a key that is there twice, of which YAML loaders take the last."""
        keys = set[str]()
        for key, _ in node.value:
            if str(key.value) in keys:
                raise _at(key, self.source, f"key {key.value!r} is there twice")
            keys.add(str(key.value))
        mapping: dict[Any, Any] = super().construct_mapping(node, deep)
        return mapping

    def construct_number(self, node: yaml.ScalarNode) -> int | float:
        """Refuse numbers that are none."""
        shown = _short(node.value, 40)
        if re.fullmatch(r"[-+]?(\d+:.*|0\d+)", node.value):  # YAML 1.1 reads 1:30 as 90 and 010 as 8
            raise _at(node, self.source, f"{shown} is not a plain number: quote it where it is a text")
        try:
            is_whole = node.tag.endswith("int")
            number: int | float = (self.construct_yaml_int if is_whole else self.construct_yaml_float)(node)
        except (ArithmeticError, IndexError, TypeError, ValueError) as error:  # "1:59:59", "0x", "!!int"
            raise _at(node, self.source, f"{shown} is not a number that can be read") from error
        if not -LARGEST_NUMBER < number < LARGEST_NUMBER:  # nor NaN
            raise _at(
                node, self.source, f"{shown} is not a reasonable number: expected a finite one within ±2^63"
            )
        return number


for _kind in ("int", "float"):
    _Loader.add_constructor(f"tag:yaml.org,2002:{_kind}", _Loader.construct_number)


class _Dumper(yaml.SafeDumper):
    """PyYAML's safe dumper, but what it writes is what `parse_yaml` reads."""


for _side in (_Loader, _Dumper):
    _side.add_implicit_resolver(
        "tag:yaml.org,2002:float",
        re.compile(r"[-+]?(\d+|\d*\.\d+|\d+\.)[eE][-+]?\d+$"),
        list("-+.0123456789"),
    )


def _represent_text(dumper: yaml.SafeDumper, text: str) -> yaml.ScalarNode:
    """Write texts of several lines as they are, and quote line breaks that PyYAML would read folded."""
    odd = any(character in text for character in "\x85\u2028\u2029")
    style = '"' if odd else "|" if "\n" in text else None
    return dumper.represent_scalar("tag:yaml.org,2002:str", text, style=style)


_Dumper.add_representer(str, _represent_text)


class StrictModel(BaseModel):
    """Base of everything that is read from YAML: unknown keys refused, immutable, no silent conversions."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


Retired = Annotated[None, BeforeValidator(lambda _: None), Field(exclude=True)]
"""A key of earlier versions, learned or constant now: any value is read and dropped, none is written."""


def retired(given: StrictModel) -> list[str]:
    """Return the keys that were given and are not used any more."""
    fields = type(given).model_fields
    return [name for name in fields if fields[name].exclude and name in given.model_fields_set]


Model = TypeVar("Model", bound=BaseModel)


def load_yaml(path: Path, model: type[Model]) -> Model:
    """Read a YAML file into a pydantic model.

    Raises BAD_CONFIG, naming file and line, what was found and what was expected.
    """
    return parse_yaml(read_text(path), model, str(path))


def parse_yaml(text: str, model: type[Model], source: str) -> Model:
    """Parse YAML text into a pydantic model; `source` names it in errors.

    Raises BAD_CONFIG, naming source and line, what was found and what was expected.
    """
    try:
        _refuse_deep(text, source)
        loader = _Loader(text)
        loader.source = source
        root = loader.get_single_node()
        data = None if root is None else loader.construct_document(root)
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else 1
        problem = error.problem or "not YAML"
        tab = any("\t" in row for row in text.splitlines()[line - 1 : line])
        raise bad_config(
            f"{source}:{line}: not valid YAML: {problem}",
            "there is a tab in this line: YAML is indented with spaces" if tab else "",
        ) from error
    except (yaml.YAMLError, ValueError, AttributeError, IndexError, TypeError, ArithmeticError) as error:
        # All but the first come from values such as a date with a month 13.
        raise bad_config(f"{source}: not valid YAML: {error}") from error
    if not isinstance(data, dict):
        kind = "an empty file" if data is None else f"a {type(data).__name__}"
        raise bad_config(f"{source}:1: expected a mapping of keys, got {kind}")
    try:
        return model.model_validate(data)
    except ValidationError as error:
        # Of a file of another kind the rest is noise.
        errors = [one for one in error.errors() if one["loc"] == ("format",)] or error.errors()
        lines = [_describe(item, root, source) for item in errors]
        places = dict.fromkeys(item["loc"][:-1] for item in errors if item["type"] == "extra_forbidden")
        hints = [_possible_keys(model, root, place) for place in places]
        raise bad_config("\n".join(lines), "\n".join(hints)) from error


def wrong_arguments(error: ValidationError) -> str:
    """Return which arguments of a call are wrong, and why, in one line."""
    found = {str(one["loc"][0]): f"{one['input']!r:.60}: {one['msg']}" for one in reversed(error.errors())}
    return "; ".join(f"{name}={wrong}" for name, wrong in found.items())


def dump_yaml(data: Mapping[str, Any], *, flow: bool | None = False) -> str:
    """Return YAML text from which `parse_yaml` reads the same, keys in their order.

    With `flow` lists are in one line; None: those without another list in them.
    """
    return str(
        yaml.dump(
            dict(data),
            Dumper=_Dumper,
            sort_keys=False,
            allow_unicode=True,
            width=110,
            default_flow_style=flow,
        )
    )


def _describe(item: Any, root: yaml.Node, source: str) -> str:
    location: Location = item["loc"]
    line, path = _locate(root, location)
    where = f"{source}:{line}: {path}: " if path else f"{source}:{line}: "
    message = str(item["msg"]).removeprefix("Value error, ")
    kind = str(item["input"]).rpartition("/")[0] if location == ("format",) else ""
    if kind not in message and (option := OPTIONS.get(kind)):
        return f"{source}:{line}: this is a {option} file, which --{option} takes"
    texts = {"extra_forbidden": "unknown key", "missing": "this key is required", "value_error": message}
    if item["type"] in texts:
        return where + texts[item["type"]]
    if item["type"] == "list_type" and isinstance(item["input"], str | int | float):
        return f"{where}expected a list: [{_short(str(item['input']), 60)}]"
    return f"{where}{message}, got {_short(repr(item['input']), 60)}"


def _possible_keys(model: type[BaseModel], root: yaml.Node, place: Location) -> str:
    """Return which keys the mapping at this place may have."""
    models = [model]
    for step in place:
        fields = [one.model_fields[step] for one in models if step in one.model_fields]
        models = [inner for field in fields for inner in _models_of(field.annotation)] or models
    path = _locate(root, place)[1]
    keys = dict.fromkeys(key for one in models for key in one.model_fields)
    return f"keys that there are{f' in {path}' if path else ''}: {', '.join(keys)}"


def _models_of(annotation: Any) -> list[type[BaseModel]]:
    """Return the models in a type, as in a union or as the values of a mapping."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for part in get_args(annotation) for model in _models_of(part)]


def _short(text: str, most: int) -> str:
    return text if len(text) <= most else f"{text[: most - 3]}..."


def _locate(root: yaml.Node, location: Location) -> tuple[int, str]:
    """Follow a pydantic location as far as the document goes; return line and printable path.

    Locations contain tags of unions that the document does not have; they are passed over.  The last step may
    be a key that is missing, which is shown although it cannot be followed.
    """
    node, line, path = root, root.start_mark.line + 1, ""
    for index, step in enumerate(location):
        last = index == len(location) - 1
        if isinstance(node, yaml.MappingNode):
            found = next(((k, v) for k, v in node.value if k.value == str(step)), None)
            if found is not None:
                node, line = found[1], found[0].start_mark.line + 1
            if found is not None or (last and step not in _UNION_TAGS):
                path += f".{step}" if path else str(step)
        elif isinstance(node, yaml.SequenceNode) and isinstance(step, int) and step < len(node.value):
            node = node.value[step]
            line = node.start_mark.line + 1
            path += f"[{step}]"
    return line, path


_UNION_TAGS = {"str", "int", "float", "bool", "function-after", "function-before", "[key]"}


def _refuse_deep(text: str, source: str) -> None:
    """Refuse what is nested too deeply or has aliases, before the parser builds it.

    libyaml would crash, and aliases can stand for more than fits in the memory.
    """
    depth = 0
    for event in yaml.parse(text, _Loader):
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > DEEPEST:
            raise _at(event, source, f"nested more than {DEEPEST} deep, which no file of imumon is")
        if isinstance(event, yaml.AliasEvent):
            raise _at(event, source, f"*{event.anchor} is an alias, which is not read: repeat what it means")


def _at(node: Any, source: str, seen: str) -> ImumonError:
    return bad_config(f"{source}:{node.start_mark.line + 1}: {seen}")
