"""Every template of a message is used with the facts that it has fields for, and is documented."""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from pathlib import Path
from string import Formatter
from typing import Any

import pytest

from docs.site.reference_pages import list_note_kinds
from labpipe.messages import get_code, list_subpackages, read_templates

NAME = re.compile(r"[a-z_]+(\.[a-z_]+)*\.[a-z0-9_]+")
TAKES_A_TEMPLATE = {"about", "of", "build_refusal", "format_sentence", "format_error_parts"}
"""Functions whose first argument names a template, or chooses one of several."""
FORWARDS = {name: {"name", "span"} for name in ("_make_stretch_notes", "_make_span_note")}
FORWARDS["report"] = set()
"""Function that gives a template on -> the facts that it adds."""
NOTED = {"Finding.of", "QualityNote.of", "record.report", *FORWARDS}
OTHER_ARGUMENTS = {"period", "clock", "is_blocking", "is_key", "missing", "channel", "segment"}


TEMPLATES = {
    f"{subpackage}.{name}": template
    for subpackage in list_subpackages()
    for name, template in read_templates(subpackage).items()
}


@pytest.fixture(scope="module")
def calls(repository: Path) -> dict[ast.Call, str]:
    """Calls in all modules, with the names of the modules."""
    return {
        node: path.relative_to(repository).as_posix()
        for path in (repository / "labpipe").rglob("*.py")
        for node in ast.walk(_with_facts_named(ast.parse(path.read_text(encoding="utf-8"))))
        if isinstance(node, ast.Call) and node.args
    }


def _with_facts_named(module: ast.Module) -> ast.Module:
    """The module with the keys of the dictionary above in place of ``**facts``."""
    for function in (node for node in ast.walk(module) if isinstance(node, ast.FunctionDef)):
        keys: dict[str, list[Any]] = {}
        parts: list[Any] = sorted(ast.walk(function), key=lambda part: getattr(part, "lineno", 0))
        for x in parts:
            if isinstance(getattr(x, "value", 0), ast.Dict) and not isinstance(x, ast.keyword):
                name = ast.unparse(x).split()[0].strip(":")
                earlier = keys.get(name, []) if isinstance(x, ast.AugAssign) else []
                keys[name] = earlier + [getattr(key, "value", "**") for key in x.value.keys]
            for old in [y for y in getattr(x, "keywords", ()) if y.arg is None]:
                names = keys.get(ast.unparse(old.value), ["**"])
                x.keywords += [ast.keyword(name, old.value) for name in names]
                x.keywords.remove(old)
    return module


def test_templates_and_calls_agree(calls: dict[ast.Call, str]) -> None:
    faults, used = [], set()
    for call, module in calls.items():
        for name in _templates_named(call):
            used.add(name)
            facts, fields = _facts(call), fields_of(TEMPLATES.get(name, {}))
            if facts - fields - OTHER_ARGUMENTS or fields - facts:
                faults.append(f"{module}: {name} has the fields {sorted(fields)}, not {facts}")
    faults += [f"{name} is used nowhere" for name in TEMPLATES.keys() - used]
    faults += [f"{name} has no template" for name in used - TEMPLATES.keys()]
    assert not faults, "\n".join(sorted(faults))


def test_quality_notes_are_documented(calls: dict[ast.Call, str], repository: Path) -> None:
    """Templates of notes, and no others, have a severity; the reference page or that of bands has
    their codes."""
    notes = {
        name
        for call in calls
        if ast.unparse(call.func).removeprefix("self.") in NOTED
        for name in _templates_named(call)
    }
    assert notes == {name for name, template in TEMPLATES.items() if "severity" in template}
    documented = {kind.code for kind in list_note_kinds()}
    bands = (repository / "docs/explanations/rod-bands.md").read_text(encoding="utf-8")
    documented |= set(re.findall(r"`(\w+)`", bands))
    assert not sorted({get_code(name) for name in notes} - documented)


def test_reasons_of_failures_are_documented(calls: dict[ast.Call, str], repository: Path) -> None:
    """Every code of a failure has a row in the reference page, and every row is a code."""
    page = (repository / "docs/reference/results.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(\w+)` \|", page.partition("## Reason codes")[2], re.MULTILINE)
    codes: dict[str, set[str]] = defaultdict(set)
    for call in calls:
        codes[ast.unparse(call.func)].update(map(get_code, _templates_named(call)))
        if ast.unparse(call.func) == "Failure" and isinstance(call.args[0], ast.Constant):
            codes["Failure"].add(str(call.args[0].value))
    failures = codes["Failure"] | codes["Failure.of"] | codes["UnavailableError.of"]
    assert not sorted(failures - set(rows))
    assert not sorted(set(rows) - failures - codes["Reason.of"])


def test_templates_are_whole() -> None:
    shapes: dict[frozenset[str], list[str]] = defaultdict(list)
    for subpackage in list_subpackages():
        for name, template in read_templates(subpackage).items():
            keys = frozenset(template) - {"code", "origin", "doubts"}
            shapes[keys].append(f"{subpackage}.{name}")
    allowed = [{"expected", "found", "remedy"}, {"severity", "meaning", "says"}]
    allowed += [{"severity", "says"}, {"says"}]
    assert not [names for shape, names in shapes.items() if shape not in allowed]


def fields_of(template: dict[str, str]) -> set[str]:
    texts = [template.get(part, "") for part in ("expected", "found", "remedy", "says")]
    fields = {field for text in texts for _, field, _, _ in Formatter().parse(text) if field}
    return {re.split(r"[.\[]", field)[0] for field in fields}


def _templates_named(call: ast.Call) -> list[str]:
    """Names of templates in the first argument of a call."""
    function = ast.unparse(call.func).rpartition(".")[2]
    if function not in TAKES_A_TEMPLATE | FORWARDS.keys():
        return []
    texts = [part.value for part in ast.walk(call.args[0]) if isinstance(part, ast.Constant)]
    return [text for text in texts if isinstance(text, str) and NAME.fullmatch(text)]


def _facts(call: ast.Call) -> set[str]:
    facts = FORWARDS.get(ast.unparse(call.func).removeprefix("self."), set())
    return facts | {keyword.arg or "**" for keyword in call.keywords}
