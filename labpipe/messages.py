"""Fill in the templates of messages, which are in the ``messages.toml`` of each subpackage.

A template is a table of TOML with a name. The entries of a template depend on its use:

- an error: ``expected``, ``found``, ``remedy``, and ``code`` if the class of the error does not
  state it;
- a quality note: ``severity``, ``says``, and ``meaning`` and ``doubts`` for the reference page;
- a reason or any other sentence: ``says``.

The code of a note or reason is the name of its template. If several templates have the same code,
the others state it as ``code``.

Sentences have fields for `str.format`. A test compares the fields with the facts that the code
passes, so that a sentence can be reworded without a change of the code.
"""

from __future__ import annotations

import tomllib
from functools import cache
from importlib.resources import files
from pathlib import Path

Template = dict[str, str]
"""Texts of one message, keyed by the name of the entry."""


@cache
def read_templates(subpackage: str) -> dict[str, Template]:
    """Read the templates of a subpackage, keyed by name.

    Parameters
    ----------
    subpackage : name of the subpackage without ``labpipe``, such as ``readers`` or
        ``mechanics.wire``

    Raises
    ------
    FileNotFoundError
        If the subpackage has no ``messages.toml``.
    """
    text = (files(f"labpipe.{subpackage}") / "messages.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)


def list_subpackages() -> list[str]:
    """List the subpackages that have a ``messages.toml``."""
    package = Path(str(files("labpipe")))
    paths = sorted(package.rglob("messages.toml"))
    return [".".join(path.relative_to(package).parts[:-1]) for path in paths]


def get_template(name: str) -> Template:
    """Return a template.

    Parameters
    ----------
    name : subpackage and name of the template, such as ``readers.no_header``

    Raises
    ------
    KeyError
        If the subpackage has no such template.
    """
    subpackage, _, template = name.rpartition(".")
    return read_templates(subpackage)[template]


def get_code(name: str) -> str:
    """Return the code of the notes or reasons that are made from a template."""
    return get_template(name).get("code", name.rpartition(".")[2])


def format_sentence(name: str, /, **facts: object) -> str:
    """Fill in the sentence of a template.

    Parameters
    ----------
    name : subpackage and name of the template, such as ``process.rest_force``
    facts : values of the fields of the template, keyed by field
    """
    return get_template(name)["says"].format(**facts)


def format_error_parts(name: str, /, **facts: object) -> dict[str, str]:
    """Fill in the three texts of an error: ``expected``, ``found`` and ``remedy``.

    Parameters
    ----------
    name, facts : see `format_sentence`
    """
    template = get_template(name)
    return {key: template[key].format(**facts) for key in ("expected", "found", "remedy")}
