"""Faults of a protocol or test sheet in plain language, from all checks."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, TypeAlias

from pydantic import ValidationError
from pydantic_core import ErrorDetails, InitErrorDetails, PydanticCustomError

from labpipe.errors import At, Fault, KeyPath, nearest

Values: TypeAlias = Mapping[str, object]
_TYPE = "labpipe"
_EXPECTED = {
    "model_type": "a block of keys with values",
    "model_attributes_type": "a block of keys with values",
    "dict_type": "a block of keys with values",
    "list_type": "a list",
    "tuple_type": "a list",
    "string_type": "text",
    "too_short": "at least one entry",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
}


def block_in(data: object, *path: str) -> Values:
    """Return the block under a path; empty if there is none."""
    for key in path:
        data = data.get(key) if isinstance(data, Mapping) else None
    return data if isinstance(data, Mapping) else {}


def list_in(data: object, *path: str) -> Sequence[Any]:
    """Return the list under a path; empty if there is none."""
    *blocks, key = path
    items = block_in(data, *blocks).get(key)
    return items if isinstance(items, list) else ()


def same_names(blocks: Sequence[object], key: str, what: str) -> Iterator[Fault]:
    """Find blocks of a list that are called as an earlier one.

    Parameters
    ----------
    blocks : as written
    key : of the list
    what : they are, such as ``boundary``
    """
    first: dict[object, int] = {}
    for number, block in enumerate(blocks):
        name = block_in(block).get("name")
        if name in first:
            found = f"{name!r}, as {what} {first[name] + 1}"
            path = (key, number, "name")
            yield Fault(path, "a name of its own", found, "Call it something else.")
        elif isinstance(name, str):
            first[name] = number


def one_of(word: str, valid: Iterable[str]) -> str:
    """List valid words, nearest first.

    Parameters
    ----------
    word : the invalid one
    valid : the valid ones
    """
    valid_words = sorted(set(valid))
    listed = nearest(word, valid_words, limit=6)
    more = ", ..." if len(valid_words) > len(listed) else ""
    return f"{', '.join(repr(valid_word) for valid_word in listed)}{more}"


def did_you_mean(word: str, valid: Iterable[str]) -> str:
    """Suggest the most similar valid word; empty if there is none."""
    best = nearest(word, sorted(set(valid)), limit=1)
    return f"Did you mean {best[0]!r}?" if best else ""


def not_among(
    path: KeyPath,
    word: object,
    valid: Iterable[str],
    what: str = "one of",
    *,
    remedy: str = "",
    at: At = "value",
) -> Fault:
    """Make the fault of a word that is none of the valid ones.

    Parameters
    ----------
    path : way to the word
    word : the invalid one
    valid : the valid ones
    what : they are, such as ``one of the channels``
    remedy : what to do if none of them is similar
    at : whether the word is a key
    """
    words = sorted(set(valid))
    expected = f"{what} {one_of(str(word), words)}"
    return Fault(path, expected, shown(word), did_you_mean(str(word), words) or remedy, at)


def shown(value: object) -> str:
    """Name a value of a YAML file in a message."""
    if value is None:
        return "nothing"
    if isinstance(value, Mapping):
        return "a block of keys" if value else "an empty block"
    if isinstance(value, Sequence) and not isinstance(value, str):
        return "a list" if value else "an empty list"
    text, max_shown = str(value), 200
    return repr(text if len(text) <= max_shown else f"{text[:max_shown]}...")


def error_of(*, expected: str, found: object, remedy: str = "") -> PydanticCustomError:
    """Make the error that a validator of the schema raises.

    Parameters
    ----------
    expected : valid values
    found : the actual value
    remedy : what to do; may be empty
    """
    return _error(Fault((), expected, shown(found), remedy))


def raised(faults: Iterable[Fault], data: object) -> ValidationError:
    """Make one validation error of several faults.

    Parameters
    ----------
    faults : with paths relative to the validated block
    data : what was validated
    """
    lines = [InitErrorDetails(type=_error(fault), loc=fault.path, input=data) for fault in faults]
    return ValidationError.from_exception_data("labpipe", lines)


def faults_of(error: ValidationError, *, data: object, keys: Iterable[str]) -> list[Fault]:
    """Convert the errors of one block; those of inner blocks are faults already.

    Parameters
    ----------
    error : what pydantic found
    data : the block as it was validated
    keys : the valid keys of the block
    """
    valid_keys = list(keys)
    return [_fault_of(line, data, valid_keys) for line in error.errors(include_url=False)]


def _error(fault: Fault) -> PydanticCustomError:
    context = {
        "expected": fault.expected,
        "found": fault.found,
        "remedy": fault.remedy,
        "at": fault.at,
        "missing": fault.missing,
    }
    return PydanticCustomError(_TYPE, "expected {expected}, found {found}. {remedy}", context)


def _fault_of(line: ErrorDetails, data: object, keys: list[str]) -> Fault:
    path = _path_in(data, line["loc"])
    context = line.get("ctx", {})
    if line["type"] == "labpipe":
        parts = (context[part] for part in ("expected", "found", "remedy", "at", "missing"))
        return Fault(path, *parts)
    if line["type"] in ("missing", "union_tag_not_found"):
        key = _quoted(context["discriminator"])[0] if context else str(line["loc"][-1])
        remedy = f"Add the key {key!r}."
        return Fault(path, f"the key {key!r}", "no such key", remedy, missing=key)
    match line["type"]:
        case "extra_forbidden":
            return not_among(path, path[-1], keys, "one of the keys", at="key")
        case "union_tag_invalid":
            tag = _quoted(context["discriminator"])[0]
            return not_among((*path, tag), context["tag"], _quoted(context["expected_tags"]))
        case "literal_error":
            valid_words = _quoted(context["expected"])
            at: At = "key" if line["loc"][-1] == "[key]" else "value"
            return not_among(path, line["input"], valid_words, at=at)
        case other:
            expected = _EXPECTED.get(other, line["msg"])
            remedy = "Fill it in." if line["input"] is None else ""
            return Fault(path, expected, shown(line["input"]), remedy)


def _quoted(text: str) -> list[str]:
    return re.findall(r"'([^']*)'", text)


def _path_in(data: object, location: tuple[int | str, ...]) -> KeyPath:
    """Strip parts of a pydantic location that are not in the YAML: union tags, missing keys."""
    path: list[str | int] = []
    node: Any = data
    for part in location:
        if _holds(node, part):
            node = node[part]
            path.append(part)
    return tuple(path)


def _holds(node: object, part: int | str) -> bool:
    if isinstance(node, Mapping):
        return part in node
    return isinstance(node, list) and isinstance(part, int) and part < len(node)
