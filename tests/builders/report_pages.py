"""Pages of synthetic campaigns, as `labpipe report` writes them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import date
from hashlib import sha256
from itertools import pairwise
from pathlib import Path

from labpipe.records.group import Campaign, Difference, Group, Sample
from labpipe.report.lab_report import render_page
from labpipe.report.wording import printable
from tests.builders.campaigns import build_difference, build_group, build_sample, troubled_samples

DAY = date(2026, 3, 9)


def key_of(name: str) -> str:
    """Key of the results of a synthetic test."""
    return sha256(name.encode("utf-8", "surrogatepass")).hexdigest()


def named(sample: Sample, name: str) -> Sample:
    """The same sample under another name, with what a processed test has."""
    return replace(
        sample, test=name, label=name, run=key_of(name), date=DAY, operator="virtual lab",
        source=f"processed/c/{name}/result.h5",
    )  # fmt: skip


def campaign_of(
    names: Sequence[str],
    *,
    most: int = 6,
    decisions: Sequence[Mapping[str, str]] = (),
) -> Campaign:
    """Tests of these names, so many in a group; of the first group one is doubtful, one failed."""
    samples = [
        named(
            build_sample(f"s{number % 2}", f"{number}", seed=number, scale=1 + 0.01 * number), name
        )
        for number, name in enumerate(names)
    ]
    if len(names) >= 6:
        samples[:6] = map(named, troubled_samples(), names[:6])
    groups = tuple(
        build_group(f"tube {at // most}", samples[at : at + most], scaled=False)
        for at in range(0, len(samples), most)
    )
    return Campaign(
        "Synthetic",
        groups,
        tuple(_difference(*pair) for pair in pairwise(groups)),
        labpipe_version="0.0",
        name="c",
        decisions=(*decisions,),
    )


def _difference(one: Group, other: Group) -> Difference:
    names = one.name, other.name
    return replace(build_difference(), first=names[0], second=names[1], fields={"type": names})


def page_of(folder: Path, campaign: Campaign) -> Path:
    """Write the page of a campaign; gives the file."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "report.html"
    path.write_text(printable(render_page(campaign)), encoding="utf-8")
    return path
