"""Parts of a report's page besides its text: script, style sheets, data."""

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
_NO_NETWORK: Final = "connect-src 'none'"
_OWN_SERVER: Final = "connect-src 'self'"


def page_script() -> Markup:
    """Return the script of a page for one ``script`` element.

    It sorts and filters tables, zooms figures and stores decisions. It defines no global names and
    uses no network.
    """
    from markupsafe import Markup

    parts = "\n".join(_text(name) for name in SCRIPTS)
    return Markup(f'"use strict";\n(() => {{\n{parts}}})();\n')


def page_style() -> Markup:
    """Return the style rules of elements made by the script, in the colours of the page."""
    from markupsafe import Markup

    return Markup(_text(STYLE))


def page_data(campaign: Campaign, *, report: str) -> Markup:
    """Return the data of the script for a ``script`` element of type ``application/json``.

    Parameters
    ----------
    campaign : with the current entries of its ``decisions.json``
    report : id of the report

    Returns
    -------
    JSON in which no text can end the element.
    """
    schema = 1
    from markupsafe import Markup

    data = {
        "schema": schema,
        "campaign": campaign.name,
        "report": report,
        "labpipe": campaign.labpipe_version,
        "decisions": [dict(decision) for decision in campaign.decisions],
    }
    # Escaped to ASCII: a name may contain a lone surrogate.
    text = json.dumps(data, separators=(",", ":")).replace("&", r"\u0026")
    return Markup(text.replace("<", r"\u003c").replace(">", r"\u003e"))


def fill_template(template: str, **values: Any) -> str:
    """Fill the template of a page; all texts are escaped.

    Parameters
    ----------
    template : name of the file
    values : all values of the template, by name
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
    """Return the style sheet of a page.

    Parameters
    ----------
    footer : of each printed sheet, from `css_string`
    more : rules of that page alone
    """
    from markupsafe import Markup

    return Markup(f"{_text(LOOKS).replace('var(--footer)', footer)}{more}")


def style_hash(text: str) -> Markup:
    """Return the SHA-256 of a style or a script as the page's policy writes it.

    Parameters
    ----------
    text : of a style or a script, as in the page
    """
    from markupsafe import Markup

    digest = hashlib.sha256(printable(text).encode()).digest()
    return Markup(f"'sha256-{base64.b64encode(digest).decode()}'")


def css_string(text: str) -> str:
    """Write a text as an escaped string of a style sheet.

    Parameters
    ----------
    text : any
    """
    letters = printable(text)
    plain = (
        letter if letter.isascii() and letter.isalnum() else f"\\{ord(letter):x} "
        for letter in letters
    )
    return f'"{"".join(plain)}"'


def allow_own_server(page: str) -> str:
    """Allow a page that this machine serves to connect to its server.

    Parameters
    ----------
    page : of a report, whose policy forbids connections

    Returns
    -------
    The page with a policy that allows connections to its own server; unchanged without such a
    policy: then its decisions are saved as a file.
    """
    head, policy, rest = page.partition(_NO_NETWORK)
    return page if "<body" in head or not policy else f"{head}{_OWN_SERVER}{rest}"


def _text(name: str) -> str:
    return (files("labpipe.report") / name).read_text(encoding="utf-8")
