"""What of the reference pages derives from the code: JSON Schemas, and tables between markers.

``python -m labpipe.protocol.reference FOLDER`` writes them (``make reference``). With the schema
named in its first line, an editor completes keys and marks faults while one types. A table of a
page is between ``<!-- table: NAME -->`` and ``<!-- end of table -->``; the prose around it is
written by hand.
"""

from __future__ import annotations

import json
import re
import sys
import tomllib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any, get_args, get_type_hints

from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import core_schema

from labpipe.messages import list_rooms, read_templates
from labpipe.protocol.grammar import Block, build_block
from labpipe.protocol.harness_file import HarnessFile
from labpipe.protocol.plans import CampaignPlan
from labpipe.protocol.schema import Protocol
from labpipe.protocol.sheet_grammar import TestSheet
from labpipe.protocol.source import DIMENSION_KINDS, PLAUSIBLE_RANGES
from labpipe.records.declarations import Limits, Needs, list_references
from labpipe.records.quality import Severity
from labpipe.results import KINDS
from labpipe.results.kinds import Kind

SCHEMAS: dict[str, type[Block]] = {
    "protocol.schema.json": Protocol,
    "test-sheet.schema.json": TestSheet,
    "campaign.schema.json": CampaignPlan,
    "harness.schema.json": HarnessFile,
}
ORIGINS = {
    "readers": "readers",
    "statistics": "groups",
    "mechanics.wire": "wires",
    "mechanics.rod": "wires",
    "mechanics.studies": "calibration",
}
"""Who makes the notes of a room, if their template has no ``origin``; else ``processing``."""
PAGES = ("protocol.md", "quality-notes.md", "results.md")
"""Pages that hold tables which derive from the code."""


class _Schemas(GenerateJsonSchema):
    """Takes unquoted numbers for texts, and anything where labpipe itself reads the text."""

    def str_schema(self, schema: core_schema.StringSchema) -> JsonSchemaValue:
        """Accept what other YAML readers make of text such as 1."""
        return super().str_schema(schema) | {"type": ["string", "number"]}

    def function_plain_schema(self, schema: object) -> JsonSchemaValue:  # noqa: ARG002
        """Accept anything."""
        return {}


def json_schema(model: type[Block]) -> str:
    """Write the JSON Schema of a block as text.

    Parameters
    ----------
    model : `Protocol`, `TestSheet`, `CampaignPlan` or `HarnessFile`
    """
    dialect = {"$schema": "https://json-schema.org/draft/2020-12/schema"}
    schema = model.model_json_schema(by_alias=True, schema_generator=_Schemas)
    return json.dumps(dialect | schema, indent=2) + "\n"


@dataclass(frozen=True, slots=True)
class NoteKind:
    """What quality notes of one code mean.

    Parameters
    ----------
    origin : who makes them: ``readers``, ``processing``, ``groups``, ``wires`` ...
    code : of the notes
    severities : that they can have; several where that depends on the recording
    meaning : in one phrase
    doubts : what they make doubtful; empty for nothing
    """

    origin: str
    code: str
    severities: tuple[Severity, ...]
    meaning: str
    doubts: str = ""


def list_note_kinds() -> tuple[NoteKind, ...]:
    """Read every kind of quality note: from ``quality_notes.toml`` and the rooms' templates.

    Returns
    -------
    By origin and code; a code that two origins use comes once for each.
    """
    text = (files("labpipe.records") / "quality_notes.toml").read_text(encoding="utf-8")
    kinds = [
        (origin, code, template)
        for origin, notes in tomllib.loads(text).items()
        for code, template in notes.items()
    ] + [
        (template.get("origin", ORIGINS.get(room, "processing")), code, template)
        for room in list_rooms()
        for code, template in read_templates(room).items()
        if "meaning" in template
    ]
    return tuple(
        NoteKind(origin, code, _severities(entry), entry["meaning"], entry.get("doubts", ""))
        for origin, code, entry in sorted(kinds, key=lambda kind: kind[:2])
    )


def _severities(entry: dict[str, str | list[str]]) -> tuple[Severity, ...]:
    severity = entry["severity"]
    names = severity.split(" or ") if isinstance(severity, str) else severity
    return tuple(map(Severity, names))


def tables() -> dict[str, str]:
    """Write every derived table in Markdown, by name: one for each origin of notes, and others."""
    notes = list_note_kinds()
    origins = dict.fromkeys(note.origin for note in notes)
    written = {
        origin: table_of_notes([note for note in notes if note.origin == origin])
        for origin in origins
    }
    return written | {
        "results": table_of_results(KINDS),
        "plausible": table_of_ranges(),
        "limits": table_of_limits(),
    }


def table_of_notes(notes: Sequence[NoteKind]) -> str:
    """Write the table of quality notes of one origin.

    Parameters
    ----------
    notes : what they make doubtful has a column of its own where there is any
    """
    columns = 4 if any(note.doubts for note in notes) else 3
    rows = [
        (f"`{note.code}`", ", ".join(note.severities), note.meaning, note.doubts) for note in notes
    ]
    return _table([row[:columns] for row in [("code", "severity", "meaning", "doubtful"), *rows]])


def table_of_ranges() -> str:
    """Write the table of the plausible ranges: kind of dimension, keys that are one, ends."""
    rows = [("kind", "keys that are, or end with", "from", "to")]
    for kind, (_, lowest, highest) in PLAUSIBLE_RANGES.items():
        keys = ", ".join(f"`{key}`" for key, of in DIMENSION_KINDS.items() if of == kind)
        rows.append((f"`{kind}`", keys or "other lengths of a specimen", lowest, highest))
    return _table(rows)


def table_of_limits() -> str:
    """Write the table of the lab's limits: key, default, and what is doubtful beyond it."""
    defaults = build_block(Limits)().model_dump(mode="json")
    hints = get_type_hints(Limits, include_extras=True)
    rows = [
        (f"`{key}`", value, next(part for part in get_args(hints[key]) if isinstance(part, str)))
        for key, value in defaults.items()
    ]
    return _table([("key", "default", "of what"), *rows])


def table_of_results(kinds: Iterable[type[Kind]]) -> str:
    """Write the table of the kinds of results: word in YAML, numbers, meaning, needs.

    Parameters
    ----------
    kinds : the first line of each docstring gives the meaning, behind names and a colon
    """
    rows = [
        (f"`{kind.result}`", ", ".join(_numbers(kind)), _meaning(kind), ", ".join(_needs(kind)))
        for kind in kinds
    ]
    return _table([("asked for by", "numbers", "meaning", "read from"), *rows])


def _numbers(kind: type[Kind]) -> Iterable[str]:
    """Link each number to its section, with its unit."""
    for output in kind.outputs:
        stem, _, first = output.name_in(kind, {"of": "<stiffness>"}).partition(".")
        index = "n" if stem.startswith("slip_") else "cycle"
        name = f"{stem}.<{index}>" if first else stem
        anchor = re.sub(r"\W", "", name)
        yield f"[`{name}`](#{anchor}) ({output.unit.replace('*', ' ')})"


def _meaning(kind: type[Kind]) -> str:
    first = str(kind.__doc__).partition("\n")[0].removesuffix(".")
    return first.partition(": ")[2].replace("``", "`")


def _needs(kind: Any) -> Iterable[str]:
    """Describe the data of a test that a kind of result needs."""
    needs: Needs = kind.needs
    descriptions = {
        "the curve": needs.branches,
        f"`curve.{needs.correction}`": needs.correction,
        "two clocks": needs.clocks,
        f"the step `{needs.shape}`": needs.shape,
        "a clamped end": needs.clamp,
        "the stiffness `of`": list_references(kind, "stiffness"),
    }
    return [word for word, is_needed in descriptions.items() if is_needed]


def _table(rows: Sequence[Sequence[str]]) -> str:
    head, *body = ["".join(f"| {cell} " if cell else "| " for cell in row) + "|" for row in rows]
    return "\n".join([head, "|---" * len(rows[0]) + "|", *body])


def with_tables(page: str) -> str:
    """Replace the derived tables of a page.

    Parameters
    ----------
    page : Markdown with markers

    Returns
    -------
    The page with all else as it is.

    Raises
    ------
    KeyError
        A marker names no table that derives from the code.
    """
    table_by_name = tables()
    return re.sub(
        r"(?<=<!-- table: )(\w+) -->\n.*?(?=<!-- end of table -->)",
        lambda match: f"{match[1]} -->\n{table_by_name[match[1]]}\n",
        page,
        flags=re.DOTALL,
    )


def write_reference(folder: Path) -> None:
    """Write the JSON Schemas into a folder, and update the tables of its pages.

    Parameters
    ----------
    folder : made if it is not there; pages that it does not hold are not made
    """
    folder.mkdir(parents=True, exist_ok=True)
    for name, model in SCHEMAS.items():
        (folder / name).write_text(json_schema(model), encoding="utf-8")
    for path in filter(Path.is_file, map(folder.joinpath, PAGES)):
        path.write_text(with_tables(path.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    write_reference(Path(sys.argv[1] if len(sys.argv) > 1 else "docs/reference"))
