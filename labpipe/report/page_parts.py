"""What goes into a report's page besides its text: script, rules of what that makes, data."""

from __future__ import annotations

import base64
import hashlib
import json
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from labpipe.records.group import Campaign
from labpipe.report.page_plots import svg
from labpipe.report.wording import printable

if TYPE_CHECKING:
    from markupsafe import Markup

SCRIPTS: Final = ("page_tables.js", "page_plots.js", "page_decisions.js")
STYLE: Final = "page_answers.css"
LOOKS: Final = "page_looks.css"
_SCHEMA: Final = 1
_NO_NETWORK: Final = "connect-src 'none'"
_OWN_SERVER: Final = "connect-src 'self'"


def page_script() -> Markup:
    """Read the script of a page, to stand alone in one ``script`` element.

    Returns
    -------
    Sorts and filters tables, zooms figures, keeps decisions. Nothing of it is visible to other
    scripts, and it asks no network.
    """
    from markupsafe import Markup

    parts = "\n".join(_text(name) for name in SCRIPTS)
    return Markup(f'"use strict";\n(() => {{\n{parts}}})();\n')


def page_style() -> Markup:
    """Read the rules of what the script makes, to stand in the ``style`` element of a page.

    Returns
    -------
    They use the page's own colours: ``--ink``, ``--soft``, ``--paper``, ``--look``, ``--accent``.
    """
    from markupsafe import Markup

    return Markup(_text(STYLE))


def page_data(campaign: Campaign, *, report: str) -> Markup:
    """Write what the script must know, to stand in a ``script`` of type ``application/json``.

    Parameters
    ----------
    campaign : with the entries of its ``decisions.json`` as they stand
    report : id of the report

    Returns
    -------
    JSON in which no text can end the element.
    """
    from markupsafe import Markup

    said = {
        "schema": _SCHEMA,
        "campaign": campaign.name,
        "report": report,
        "labpipe": campaign.labpipe_version,
        "decisions": [dict(decision) for decision in campaign.decisions],
    }
    # Escaped to ASCII, so that a lone surrogate of a name goes into the page, too.
    text = json.dumps(said, separators=(",", ":")).replace("&", r"\u0026")
    return Markup(text.replace("<", r"\u003c").replace(">", r"\u003e"))


def filled(template: str, **values: Any) -> str:
    """Fill the template of a page; every text that goes into it is escaped.

    Parameters
    ----------
    template : name of the file
    values : by name, all that the template asks for
    """
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
    )
    environment.filters["svg"] = svg
    return str(environment.get_template(template).render(**values))


def style_of(footer: str, more: str) -> Markup:
    """Put the style sheet of a page together.

    Parameters
    ----------
    footer : what stands at the foot of each printed sheet, `quoted`
    more : rules of that page alone
    """
    from markupsafe import Markup

    return Markup(f"{_text(LOOKS).replace('var(--footer)', footer)}{more}")


def style_hash(text: str) -> Markup:
    """What a page's policy calls a text that may count: its SHA-256.

    Parameters
    ----------
    text : of a style or a script, as it stands in the page
    """
    from markupsafe import Markup

    digest = hashlib.sha256(printable(text).encode()).digest()
    return Markup(f"'sha256-{base64.b64encode(digest).decode()}'")


def quoted(text: str) -> str:
    """Write a text for a style sheet, such that nothing in it can end the text or the sheet.

    Parameters
    ----------
    text : any
    """
    letters = printable(text)
    plain = (
        letter if letter.isascii() and letter.isalnum() else _escaped(letter) for letter in letters
    )
    return f'"{"".join(plain)}"'


def _escaped(letter: str) -> str:
    return f"\\{ord(letter):x} "


def served(page: str) -> str:
    """Allow a page that this machine serves itself to talk back to it.

    Parameters
    ----------
    page : of a report; its policy says that it may talk to nobody

    Returns
    -------
    The page with a policy that lets it talk to where it came from. As it was, where it has no such
    policy: then its decisions are saved as a file.
    """
    head, policy, rest = page.partition(_NO_NETWORK)
    return page if "<body" in head or not policy else f"{head}{_OWN_SERVER}{rest}"


def _text(name: str) -> str:
    return (files("labpipe.report") / name).read_text(encoding="utf-8")
