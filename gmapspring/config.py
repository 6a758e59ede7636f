"""Configuration files: YAML read into strict models, every mistake reported at once with its dotted path."""

import difflib
import json
import pathlib
import re
import types
from collections.abc import Collection, Iterable, Iterator, Mapping
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin

import yaml
from pydantic import AfterValidator, BaseModel, ConfigDict, ValidationError
from pydantic_core import ErrorDetails

from gmapspring.errors import ConfigError


class Config(BaseModel):
    """Base of all configuration models: frozen, nothing unknown, nothing converted, nothing infinite."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False, use_attribute_docstrings=True)


AnyConfig = TypeVar("AnyConfig", bound=Config)


def load_config(path: str | pathlib.Path, model: type[AnyConfig]) -> AnyConfig:
    """Return a configuration file as a checked model.

    Raises:
        ConfigError: the file is missing or not YAML, or it has mistakes; all of them are listed.
    """
    path = pathlib.Path(path)
    return check_config(read_yaml(path), model, source=str(path), folder=path.parent)


def check_config(
    data: Any, model: type[AnyConfig], *, source: str = "configuration", folder: str | pathlib.Path = "."
) -> AnyConfig:
    """Return plain data (as YAML gives it) as a checked model.

    Args:
        data: a mapping of plain values.
        model: what to make of it.
        source: what to call the data in messages.
        folder: where relative paths in it start; validators find it as `info.context["folder"]`.

    Raises:
        ConfigError: the data has mistakes; all of them are listed.
    """
    if not isinstance(data, Mapping):
        raise ConfigError(f"{source} holds {_shown(data)} where keys and values are wanted; write `key: value` lines")
    try:
        # By way of JSON a list may become a tuple, while text still never becomes a number.
        return model.model_validate_json(json.dumps(dict(data), default=str), context={"folder": pathlib.Path(folder)})
    except ValidationError as error:
        raise ConfigError(_report(source, error.errors(), model)) from None


def closest(word: str, known: Iterable[str]) -> str:
    """Return a hint for a misspelt word: the known word that it resembles, or else all of them."""
    words = sorted(known)
    lowered = {candidate.lower(): candidate for candidate in words}
    match = difflib.get_close_matches(word.lower(), lowered, n=1)
    if match:
        return f"did you mean {lowered[match[0]]!r}?"
    return f"known are {', '.join(words)}" if words else "nothing is known here"


def known_name(kind: str, name: str, known: Collection[str]) -> str:
    """Return a name that is known, or raise `ConfigError` with the one that it resembles."""
    if name not in known:
        raise ConfigError(f"there is no {kind} {name!r}; {closest(name, known)}")
    return name


def names_of(kind: str, known: Collection[str]) -> AfterValidator:
    """Return what lets a field of a configuration take known names alone; what is known may still grow."""
    return AfterValidator(lambda name: known_name(kind, name, known))


# Reading YAML -----------------------------------------------------------------------------------------------------


class _Loader(yaml.SafeLoader):
    """Read YAML with two of its traps closed: 5e3 is a number, and a key given twice is a mistake."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """Return a mapping, or raise at the second of two equal keys."""
        seen: set[Any] = set()
        for key_node, _ in node.value:
            key = (key_node.tag, key_node.value) if isinstance(key_node, yaml.ScalarNode) else id(key_node)
            if key in seen and key_node.tag != "tag:yaml.org,2002:merge":
                raise yaml.constructor.ConstructorError(
                    None, None, f"the key {key_node.value!r} is given twice", key_node.start_mark
                )
            seen.add(key)
        return super().construct_mapping(node, deep)


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"^[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$"), list("-+.0123456789")
)


def read_yaml(path: str | pathlib.Path) -> Any:
    """Return the plain data of a YAML file, or raise `ConfigError` with the line of the mistake."""
    path = pathlib.Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"cannot read {path}: {getattr(error, 'strerror', None) or error}") from None
    try:
        return yaml.load(text, Loader=_Loader)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f", line {mark.line + 1}" if mark else ""
        raise ConfigError(f"{path}{where}: {getattr(error, 'problem', None) or error}") from None


# Reporting mistakes -----------------------------------------------------------------------------------------------


def _report(source: str, errors: list[ErrorDetails], model: type[BaseModel]) -> str:
    """Return one message for all mistakes."""
    lines: list[str] = []
    explained: set[str] = set()
    # Unknown keys come first: a misspelt key explains why the right one is missing.
    for error in sorted(errors, key=lambda error: error["type"] != "extra_forbidden"):
        path, fields = _locate(error["loc"], model)
        if error["type"] == "missing" and path in explained:
            continue
        message = _message(error, fields)
        if error["type"] == "extra_forbidden" and (match := re.search(r"did you mean '(.*)'", message)):
            explained.add(".".join([*path.split(".")[:-1], match[1]]))
        lines.append(f"  {path}: {message}" if path else f"  {message}")
    count = "1 mistake" if len(lines) == 1 else f"{len(lines)} mistakes"
    return "\n".join([f"{source} has {count}:", *sorted(lines)])


def _message(error: ErrorDetails, fields: Iterable[str]) -> str:
    """Return what is wrong and the way out, given the keys that are known beside it."""
    context = error.get("ctx", {})
    match error["type"]:
        case "extra_forbidden":
            return f"unknown key; {closest(str(error['loc'][-1]), fields)}"
        case "missing":
            return "missing"
        case "union_tag_not_found":
            return "the key 'kind' is missing"
        case "union_tag_invalid" | "literal_error":
            expected = context.get("expected_tags") or context["expected"]
            choices = re.findall("'([^']*)'", expected)
            wrong = str(context.get("tag", error["input"]))
            return f"{wrong!r} is not one of {expected}; {closest(wrong, choices)}"
        case "value_error":
            return str(context["error"])
    text = error["msg"]
    return f"{text[0].lower()}{text[1:]} (got {_shown(error['input'])})"


def _shown(value: Any) -> str:
    """Return a value as it reads in a message."""
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _locate(location: tuple[int | str, ...], model: type[BaseModel]) -> tuple[str, list[str]]:
    """Return the dotted path of a mistake, and the keys that are known where its last step is taken."""
    path: list[str] = []
    fields: list[str] = []
    annotations: list[Any] = [model]
    for step in location:
        models = [item for item in annotations if isinstance(item, type) and issubclass(item, BaseModel)]
        tagged = [item for item in models if step in _tags(item)]
        if tagged and len(models) > 1:
            # A choice between kinds puts the kind into the location; the file has no such key.
            annotations = tagged
            continue
        if step == "[key]":
            continue
        path.append(str(step))
        fields = [field.alias or name for item in models for name, field in item.model_fields.items()]
        annotations = [inner for item in annotations for inner in _step(item, step)]
    return ".".join(path), fields


def _tags(model: type[BaseModel]) -> tuple[Any, ...]:
    """Return the kinds that a model answers to."""
    kind = model.model_fields.get("kind")
    return get_args(kind.annotation) if kind and get_origin(kind.annotation) is Literal else ()


def _step(annotation: Any, step: int | str) -> Iterator[Any]:
    """Yield the types that lie one step inside a type: a model's field, or an item."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        if step in annotation.model_fields:
            yield from _flatten(annotation.model_fields[str(step)].annotation)
    elif arguments := get_args(annotation):
        is_fixed = get_origin(annotation) is tuple and isinstance(step, int) and step < len(arguments)
        yield from _flatten(arguments[int(step) if is_fixed else -1])


def _flatten(annotation: Any) -> Iterator[Any]:
    """Yield the members of unions, bare of annotations."""
    if get_origin(annotation) is Annotated:
        yield from _flatten(get_args(annotation)[0])
    elif get_origin(annotation) in (Union, types.UnionType):
        for member in get_args(annotation):
            yield from _flatten(member)
    else:
        yield annotation
