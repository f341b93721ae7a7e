"""The page of a report: tables and drawings put into the template."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from labpipe.records.group import Campaign, Group
from labpipe.records.quality import Severity
from labpipe.report.campaign_tables import (
    concern_tables,
    difference_table,
    method_tables,
    table_of_tests,
)
from labpipe.report.concerns import find_concerns, split_reason
from labpipe.report.group_look import count_words
from labpipe.report.group_tables import (
    key_numbers,
    sample_tables,
    slip_table,
    spool_means,
)
from labpipe.report.numbers import with_names_in_words
from labpipe.report.saved_figures import SavedFigure

if TYPE_CHECKING:
    from markupsafe import Markup

_TEMPLATE = "lab_report.html"


def render_page(
    campaign: Campaign, stems: Sequence[str], figures: Sequence[Sequence[SavedFigure]]
) -> str:
    """Write the page of a campaign.

    Parameters
    ----------
    campaign : all that is shown
    stems : one per group: its name in links
    figures : of each group

    Returns
    -------
    An HTML document that needs no other file, no network and no script. Every text of the campaign
    is escaped.
    """
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
    )
    groups = [_group(*each) for each in zip(campaign.groups, stems, figures, strict=True)]
    return environment.get_template(_TEMPLATE).render(
        campaign=campaign,
        summary=_summary(campaign),
        concerns=concern_tables(campaign),
        concern_count=len(find_concerns(campaign)),
        groups=groups,
        differences=difference_table(campaign),
        protocols=", ".join(sorted({group.protocol for group in campaign.groups})) or "none",
        methods=method_tables(campaign),
        tests=table_of_tests(campaign),
        classes=_classes(figures),
    )


def _classes(figures: Sequence[Sequence[SavedFigure]]) -> Markup:
    """The looks of all drawings, each once; made by matplotlib, none of it said by a person."""
    from markupsafe import Markup

    every = {
        name: look
        for group in figures
        for each in group
        for name, look in each.drawing.classes.items()
    }
    return Markup("\n".join(f".{name} {{{look}}}" for name, look in every.items()))


def _summary(campaign: Campaign) -> str:
    """What was tested, in one sentence."""
    samples = [sample for group in campaign.groups for sample in group.samples]
    spools = {(sample.specimen.type, sample.specimen.spool) for sample in samples}
    protocols = sorted({group.protocol for group in campaign.groups})
    words = (
        f"{_count(len(samples), 'sample')} from {_count(len(spools), 'spool')} in"
        f" {_count(len(campaign.groups), 'group')}, tested by"
        f" {', '.join(protocols) or 'no protocol'}."
    )
    if campaign.left_out:
        words += f" {_count(len(campaign.left_out), 'test')} could not be read."
    return words


def _count(count: int, what: str) -> str:
    return f"{count} {what}{'s' * (count != 1)}"


def _group(group: Group, stem: str, figures: Sequence[SavedFigure]) -> dict[str, Any]:
    from markupsafe import Markup

    return {
        "name": group.name,
        "stem": stem,
        "about": count_words(group),
        "protocol": group.protocol,
        "is_empty": not group.samples,
        "why_empty": split_reason(group.band.reason or "The group has no sample.")[1],
        "means": key_numbers(group),
        "spools": spool_means(group),
        "samples": sample_tables(group),
        "slips": slip_table(group),
        # Made by matplotlib, with every text escaped: a drawing, not text to be shown.
        "figures": [
            {"svg": Markup(each.drawing.element), "caption": each.caption} for each in figures
        ],
        "remarks": _remarks(group),
    }


def _remarks(group: Group) -> list[str]:
    """Notes that change nothing; those of several samples that say the same stand once."""
    said: dict[str, list[str]] = {}
    notes = [(sample.test, note) for sample in group.samples for note in sample.quality]
    for test, note in (*notes, *(("", note) for note in group.notes)):
        if note.severity is Severity.INFO:
            words = with_names_in_words(f"{note.where}: {note.message}")
            said.setdefault(words, []).append(test)
    return [f"{', '.join(filter(None, tests))} \u00b7 {words}" for words, tests in said.items()]
