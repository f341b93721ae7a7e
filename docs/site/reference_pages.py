"""Derived parts of the reference pages: JSON schemas for editors, and Markdown tables.

``python -m docs.site.reference_pages FOLDER`` writes them (``make reference``). With a schema,
an editor completes keys and marks faults. The tables replace those between ``<!-- table: NAME -->``
and ``<!-- end of table -->``; all other text of a page is written by hand.
"""

from __future__ import annotations

import ast
import inspect
import json
import re
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any, get_args, get_type_hints

from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import core_schema

from labpipe.messages import get_code, list_subpackages, read_templates
from labpipe.protocol.grammar import Block, build_block
from labpipe.protocol.model_files import HarnessFile
from labpipe.protocol.schema import Protocol
from labpipe.protocol.sheet_grammar import CampaignPlan, TestSheet
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
"""Origin of the notes of a subpackage whose templates state none; of others ``processing``."""
PAGES = ("protocol.md", "quality-notes.md", "results.md")
"""Pages with derived tables."""


class _Schemas(GenerateJsonSchema):
    """Generator of schemas that accept unquoted numbers as text.

    Docstrings of fields are read here, as pydantic would parse the source in every process.
    """

    def model_schema(self, schema: core_schema.ModelSchema) -> JsonSchemaValue:
        """Return the schema of a model, described by the docstrings of its fields."""
        model, json_schema = schema["cls"], super().model_schema(schema)
        for block in (base for base in reversed(model.__mro__) if issubclass(base, Block)):
            docstrings = read_field_docstrings(block.__module__).get(block.__name__, {})
            for name, docstring in docstrings.items():
                key = model.model_fields[name].alias or name
                json_schema["properties"][key]["description"] = docstring
        return json_schema

    def str_schema(self, schema: core_schema.StringSchema) -> JsonSchemaValue:
        """Return a schema that accepts a text, or the number that other YAML readers make of it."""
        return super().str_schema(schema) | {"type": ["string", "number"]}


@cache
def read_field_docstrings(module: str) -> Mapping[str, Mapping[str, str]]:
    """Read the docstrings below annotated fields of the classes of a module.

    Parameters
    ----------
    module : full name of an imported module

    Returns
    -------
    Docstrings, by names of class and field.
    """
    tree = ast.parse(inspect.getsource(sys.modules[module]))
    return {
        definition.name: {
            field.target.id: inspect.cleandoc(text)
            for field, statement in pairwise(definition.body)
            if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name)
            if isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)
            if isinstance(text := statement.value.value, str)
        }
        for definition in tree.body
        if isinstance(definition, ast.ClassDef)
    }


def format_json_schema(model: type[Block]) -> str:
    """Format the JSON schema of a block.

    Parameters
    ----------
    model : `Protocol`, `TestSheet`, `CampaignPlan` or `HarnessFile`
    """
    dialect = {"$schema": "https://json-schema.org/draft/2020-12/schema"}
    schema = model.model_json_schema(by_alias=True, schema_generator=_Schemas)
    return json.dumps(dialect | schema, indent=2) + "\n"


@dataclass(frozen=True, slots=True)
class NoteKind:
    """Kind of quality notes: one code of one origin.

    Parameters
    ----------
    origin : part of labpipe that makes the notes, such as ``readers`` or ``processing``
    code : code of the notes
    severities : possible severities
    meaning : a phrase for the reference page
    doubts : results that the note makes doubtful; may be empty
    """

    origin: str
    code: str
    severities: tuple[Severity, ...]
    meaning: str
    doubts: str = ""


def list_note_kinds() -> tuple[NoteKind, ...]:
    """List all kinds of quality notes, from the templates of messages that state a meaning.

    Returns
    -------
    The kinds, sorted by origin and code; a code with two origins appears once for each.
    """
    kinds = (
        NoteKind(
            template.get("origin", ORIGINS.get(subpackage, "processing")),
            get_code(f"{subpackage}.{name}"),
            tuple(map(Severity, template["severity"].split(" or "))),
            template["meaning"],
            template.get("doubts", ""),
        )
        for subpackage in list_subpackages()
        for name, template in read_templates(subpackage).items()
        if "meaning" in template
    )
    return tuple(sorted(kinds, key=lambda kind: (kind.origin, kind.code)))


def format_tables() -> dict[str, str]:
    """Format all derived tables in Markdown, by name; notes have one table per origin."""
    notes: dict[str, list[NoteKind]] = {}
    for note in list_note_kinds():
        notes.setdefault(note.origin, []).append(note)
    tables = {origin: format_note_table(kinds) for origin, kinds in notes.items()}
    results, ranges, limits = format_result_table(KINDS), format_range_table(), format_limit_table()
    return tables | {"results": results, "plausible": ranges, "limits": limits}


def format_note_table(notes: Sequence[NoteKind]) -> str:
    """Format the table of the notes of one origin.

    Parameters
    ----------
    notes : if any makes a result doubtful, the table has a column ``doubtful``
    """
    columns = 4 if any(note.doubts for note in notes) else 3
    rows = [("code", "severity", "meaning", "doubtful")]
    rows += [(f"`{x.code}`", ", ".join(x.severities), x.meaning, x.doubts) for x in notes]
    return _format_table([row[:columns] for row in rows])


def format_range_table() -> str:
    """Format the table of plausible ranges: kind of dimension, its keys, and both ends."""
    rows = [("kind", "keys that are, or end with", "from", "to")]
    for kind, (_, lowest, highest) in PLAUSIBLE_RANGES.items():
        keys = [f"`{key}`" for key, key_kind in DIMENSION_KINDS.items() if key_kind == kind]
        rows.append(
            (f"`{kind}`", ", ".join(keys) or "other lengths of a specimen", lowest, highest)
        )
    return _format_table(rows)


def format_limit_table() -> str:
    """Format the table of the limits: key, default and description."""
    defaults = build_block(Limits)().model_dump(mode="json")
    hints = get_type_hints(Limits, include_extras=True)
    rows = [
        (f"`{key}`", value, next(part for part in get_args(hints[key]) if isinstance(part, str)))
        for key, value in defaults.items()
    ]
    return _format_table([("key", "default", "of what"), *rows])


def format_result_table(kinds: Iterable[type[Kind]]) -> str:
    """Format the table of the kinds of results: key, numbers, meaning and needs.

    Parameters
    ----------
    kinds : the first line of each docstring has the meaning after a colon
    """
    rows = [
        (f"`{kind.result}`", ", ".join(_list_numbers(kind)), _read_meaning(kind), _list_needs(kind))
        for kind in kinds
    ]
    return _format_table([("asked for by", "numbers", "meaning", "read from"), *rows])


def _list_numbers(kind: type[Kind]) -> Iterable[str]:
    """List the numbers of a result with their units, each as a link to its section."""
    for output in kind.outputs:
        stem, _, first = output.format_name(kind, {"of": "<stiffness>"}).partition(".")
        index = "n" if stem.startswith("slip_") else "cycle"
        name = f"{stem}.<{index}>" if first else stem
        anchor = re.sub(r"\W", "", name)
        yield f"[`{name}`](#{anchor}) ({output.unit.replace('*', ' ')})"


def _read_meaning(kind: type[Kind]) -> str:
    first = str(kind.__doc__).partition("\n")[0].removesuffix(".")
    return first.partition(": ")[2].replace("``", "`")


def _list_needs(kind: Any) -> str:
    """List the data of a test that a kind of result needs."""
    needs: Needs = kind.needs
    descriptions = {
        "the curve": needs.branches,
        f"`curve.{needs.correction}`": needs.correction,
        "two clocks": needs.clocks,
        f"the step `{needs.shape}`": needs.shape,
        "a clamped end": needs.clamp,
        "the stiffness `of`": list_references(kind, "stiffness"),
    }
    return ", ".join(text for text, is_needed in descriptions.items() if is_needed)


def _format_table(rows: Sequence[Sequence[str]]) -> str:
    head, *body = ["".join(f"| {cell} " if cell else "| " for cell in row) + "|" for row in rows]
    return "\n".join([head, "|---" * len(rows[0]) + "|", *body])


def replace_tables(page: str) -> str:
    """Replace the derived tables of a page.

    Parameters
    ----------
    page : Markdown with markers

    Returns
    -------
    The page; its other text is unchanged.

    Raises
    ------
    KeyError
        If a marker names an unknown table.
    """
    table_by_name = format_tables()
    return re.sub(
        r"(?<=<!-- table: )(\w+) -->\n.*?(?=<!-- end of table -->)",
        lambda match: f"{match[1]} -->\n{table_by_name[match[1]]}\n",
        page,
        flags=re.DOTALL,
    )


def write_reference(folder: Path) -> None:
    """Write the JSON schemas into a folder, and update the tables of its pages.

    Parameters
    ----------
    folder : created if necessary; missing pages are not created
    """
    folder.mkdir(parents=True, exist_ok=True)
    for name, model in SCHEMAS.items():
        (folder / name).write_text(format_json_schema(model), encoding="utf-8")
    for path in filter(Path.is_file, map(folder.joinpath, PAGES)):
        path.write_text(replace_tables(path.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    write_reference(Path(sys.argv[1] if len(sys.argv) > 1 else "docs/reference"))
