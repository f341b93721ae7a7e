"""JSON Schema of protocols and test sheets, for editors.

``python -m labpipe.protocol.json_schema FOLDER`` writes them. With the schema named in its first
line, an editor completes keys and marks faults while one types.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from labpipe.protocol.grammar import Block
from labpipe.protocol.schema import Protocol
from labpipe.protocol.sheet_grammar import TestSheet

SCHEMAS: dict[str, type[Block]] = {
    "protocol.schema.json": Protocol,
    "test-sheet.schema.json": TestSheet,
}


def json_schema(model: type[Block]) -> str:
    """Write the JSON Schema of a block as text.

    Parameters
    ----------
    model : `Protocol` or `TestSheet`
    """
    schema = {"$schema": "https://json-schema.org/draft/2020-12/schema"}
    return json.dumps(schema | model.model_json_schema(by_alias=True), indent=2) + "\n"


def write_schemas(folder: Path) -> None:
    """Write the JSON Schemas of protocols and test sheets into a folder.

    Parameters
    ----------
    folder : made if it is not there
    """
    folder.mkdir(parents=True, exist_ok=True)
    for name, model in SCHEMAS.items():
        (folder / name).write_text(json_schema(model), encoding="utf-8")


if __name__ == "__main__":
    write_schemas(Path(sys.argv[1] if len(sys.argv) > 1 else "docs/reference"))
