"""Every template of a message is used, with the facts that it has fields for."""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from pathlib import Path
from string import Formatter

from labpipe.messages import list_subpackages, read_templates

NAME = re.compile(r"[a-z_]+(\.[a-z_]+)*\.[a-z0-9_]+")
TAKES_A_TEMPLATE = {"about", "of", "build_refusal", "format_sentence", "format_error_parts"}
"""Functions whose first argument names a template, or chooses one of several."""
OTHER_ARGUMENTS = {"during", "clock", "blocks", "at", "missing"}


def test_templates_and_calls_agree(repository: Path) -> None:
    templates = {
        f"{subpackage}.{name}": template
        for subpackage in list_subpackages()
        for name, template in read_templates(subpackage).items()
    }
    faults, used = [], set()
    for path in (repository / "labpipe").rglob("*.py"):
        for call in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            for name in _templates_named(call):
                place = f"{path.relative_to(repository)}: {name}"
                used.add(name)
                if name not in templates:
                    faults.append(f"{place} has no template")
                    continue
                facts, fields = _facts(call), fields_of(templates[name])
                if facts - fields - OTHER_ARGUMENTS or fields - facts:
                    faults.append(f"{place} has the fields {sorted(fields)}, not {facts}")
    faults += [f"{name} is used nowhere" for name in templates.keys() - used]
    assert not faults, "\n".join(sorted(faults))


def test_templates_are_whole() -> None:
    shapes: dict[frozenset[str], list[str]] = defaultdict(list)
    for subpackage in list_subpackages():
        for name, template in read_templates(subpackage).items():
            shapes[frozenset(template) - {"code", "origin", "doubts"}].append(
                f"{subpackage}.{name}"
            )
    allowed = [{"expected", "found", "remedy"}, {"severity", "meaning", "says"}]
    allowed += [{"severity", "says"}, {"says"}]
    assert not [names for shape, names in shapes.items() if shape not in allowed]


def fields_of(template: dict[str, str]) -> set[str]:
    texts = [template.get(part, "") for part in ("expected", "found", "remedy", "says")]
    fields = {field for text in texts for _, field, _, _ in Formatter().parse(text) if field}
    return {re.split(r"[.\[]", field)[0] for field in fields}


def _templates_named(node: ast.AST) -> list[str]:
    """Names of templates in the first argument of a call."""
    if not isinstance(node, ast.Call) or not node.args:
        return []
    function = (
        node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
    )
    if function not in TAKES_A_TEMPLATE:
        return []
    texts = [part.value for part in ast.walk(node.args[0]) if isinstance(part, ast.Constant)]
    return [text for text in texts if isinstance(text, str) and NAME.fullmatch(text)]


def _facts(node: ast.AST) -> set[str]:
    assert isinstance(node, ast.Call)
    return {keyword.arg or "**" for keyword in node.keywords}
