"""Tables of the page and the workbook on lots against the smallest force allowed."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from math import isfinite

from labpipe.records.group import Campaign, Group, Lot, Sample
from labpipe.report.issues import join_sentences
from labpipe.report.page_tables import DASH, Cell, Table, make_result_cell
from labpipe.report.wording import (
    find_display,
    find_display_unit,
    typeset_unit,
    write_heading,
    write_number,
)
from labpipe.report.workbook_file import Record, make_number_cell
from labpipe.statistics.lots import FORCE_LIMIT, find_result, write_percent

_NOT_STATED = "not stated"
_PEAK = "peak_force.1"


def describe_observations(samples: Sequence[Sample]) -> str:
    """Count the answers of the test sheets, such as ``slip 3, contact broken outside 1``.

    Parameters
    ----------
    samples : of one group
    """
    names = dict.fromkeys(name for sample in samples for name in sample.specimen.observed)
    counts = Counter(
        sample.specimen.observed.get(name, _NOT_STATED) for name in names for sample in samples
    )
    return ", ".join(f"{answer} {count}" for answer, count in counts.most_common())


def make_lot_table(campaign: Campaign, stems: Sequence[str]) -> Table | None:
    """Return the answer of each lot with its numbers; None if no protocol asks for a limit.

    Parameters
    ----------
    campaign : with its groups
    stems : of the groups, for links
    """
    lots = [
        (group, lot, stem)
        for group, stem in zip(campaign.groups, stems, strict=True)
        if (lot := group.lot) is not None
    ]
    if not lots:
        return None
    heads = ("Lot", "Answer", "Why", "Limit", "Bound", "Smallest", "Cpk", "n", "Separation")
    rows = tuple(_lot_row(group, lot, stem) for group, lot, stem in lots)
    rules = {
        f"{write_percent(lot.rule.coverage)} of the lot with"
        f" {write_percent(lot.rule.confidence)} confidence"
        for _, lot, _ in lots
    }
    note = (
        f"Bound: one-sided lower tolerance bound (normal) for {' or '.join(sorted(rules))}."
        " Cpk: (mean \u2212 limit) / (3 s)."
    )
    return Table("Lots against their smallest force", heads, rows, (note,))


def _lot_row(group: Group, lot: Lot, stem: str) -> tuple[Cell, ...]:
    factor, unit = (1.0, "") if lot.limit is None else _force_scale(group)
    scale = factor * (lot.limit or 1.0)

    def write(share: float, size: float = scale) -> Cell:
        text = f"{write_number(share, None, size).value} {unit}".strip()
        return Cell(text if isfinite(share) else DASH)

    return (
        Cell(group.name, link=f"#group-{stem}"),
        Cell(str(lot.answer).upper()),
        Cell(join_sentences(lot.reasons)),
        write(1.0) if lot.limit is not None else Cell(DASH, tip="the samples have several limits"),
        write(lot.bound),
        write(lot.smallest),
        Cell(f"{lot.cpk:.2f}" if isfinite(lot.cpk) else DASH),
        Cell(str(lot.n)),
        Cell(describe_observations(group.samples) or DASH),
    )


def _force_scale(group: Group) -> tuple[float, str]:
    factor, unit = find_display_unit("", "N", find_display(group))
    return factor, typeset_unit(unit)


def make_verdict_table(group: Group) -> Table | None:
    """Return the verdict on each sample; None if the protocol asks for no limit.

    Parameters
    ----------
    group : with its lot
    """
    lot = group.lot
    if lot is None:
        return None
    factor, unit = find_display_unit("", "N", find_display(group))
    names = dict.fromkeys(name for sample in group.samples for name in sample.specimen.observed)
    heads = (
        *("Test", "Verdict", "With its interval"),
        *(write_heading(name, unit) for name in (_PEAK, FORCE_LIMIT)),
        *(name.replace("_", " ").capitalize() for name in names),
    )
    rows = []
    for sample in group.samples:
        verdict = lot.verdicts.get(sample.test)
        peak, limit = (find_result(sample.results, name) for name in (_PEAK, FORCE_LIMIT))
        seen = (Cell(sample.specimen.observed.get(name, _NOT_STATED)) for name in names)
        answers = (DASH, DASH) if verdict is None else (verdict.by_number, verdict.with_interval)
        numbers = (make_result_cell(number, factor) for number in (peak, limit))
        rows.append((Cell(sample.test), *(Cell(str(x)) for x in answers), *numbers, *seen))
    return Table(f"{group.name}: verdict on each sample", heads, tuple(rows))


def make_lot_record(group: Group, lot: Lot) -> Record:
    """Return the row of a lot in the workbook.

    Parameters
    ----------
    group, lot : of the samples
    """
    factor, unit = _force_scale(group)
    limit = lot.limit
    forces = {
        "limit": 1.0, "mean": lot.mean, "standard deviation": lot.deviation,
        "smallest": lot.smallest, "tolerance bound": lot.bound,
    }  # fmt: skip
    return {
        "group": group.name,
        "answer": str(lot.answer),
        "unit": "of the limit" if limit is None else unit,
        **{
            name: make_number_cell(share, None, factor * limit if limit is not None else 1.0)
            for name, share in forces.items()
        },
        "Cpk": make_number_cell(lot.cpk, None),
        "n": lot.n,
        "n that would pass": lot.n_needed,
        "coverage (%)": 100.0 * lot.rule.coverage,
        "confidence (%)": 100.0 * lot.rule.confidence,
        "observed": describe_observations(group.samples),
        "reason": join_sentences(lot.reasons),
    }


def make_verdict_cells(sample: Sample, lot: Lot | None) -> Record:
    """Return the answers of a test sheet and the verdict for the row of a test in the workbook.

    Parameters
    ----------
    sample : of a group
    lot : of the group, if its protocol asks for a limit
    """
    verdict = None if lot is None else lot.verdicts.get(sample.test)
    answers: Record = {
        name.replace("_", " "): word for name, word in sample.specimen.observed.items()
    }
    if verdict is None:
        return answers
    verdicts = str(verdict.by_number), str(verdict.with_interval)
    return {"verdict": verdicts[0], "verdict with interval": verdicts[1], **answers}
