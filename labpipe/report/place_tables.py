"""Table of harness bundles between slipping and sticking."""

from __future__ import annotations

from math import isnan

from labpipe.records.group import BundlePlace, Campaign, Group
from labpipe.report.concerns import sentences
from labpipe.report.group_tables import DASH, Cell, Table
from labpipe.report.numbers import display_of, shown_in, unit_words, write_number
from labpipe.report.wording import Scale

UNIT = "N*m^2"
_NOTES = (
    "All slips: every wire slips on its neighbours, and its strands on each other. Wires slip: the"
    " same with strands that stick. Nothing slips:"
    " the section stays plane, bent in the plane of the test; below it, the least and the largest"
    " of all directions. Both are worked out from the wire sheet, for wires alone: what tape,"
    " conduit and friction add is in the measured number only.",
    "Share of the way: 0 % where all slips, 100 % where nothing does. Its interval is that of the"
    " measured number; how well the wire sheet knows the wires is not in it.",
)


def has_bundles(campaign: Campaign) -> bool:
    """Tell whether any sample of a campaign is a harness bundle."""
    return any(
        sample.specimen.bundle is not None for group in campaign.groups for sample in group.samples
    )


def place_table(campaign: Campaign) -> Table | None:
    """Make the table of bending stiffnesses between their bounds; None without a wire sheet.

    Parameters
    ----------
    campaign : its places
    """
    if not campaign.places:
        return None
    scales = place_scales(campaign)
    rows = tuple(_row(each, scales[each.group]) for each in campaign.places)
    units = dict.fromkeys(unit_words(scale.unit) for scale in scales.values())
    unit = next(iter(units)) if len(units) == 1 else "unit of the group"
    heads = (
        "Test", f"Bending stiffness ({unit})", f"All slips ({unit})", f"Wires slip ({unit})",
        f"Nothing slips ({unit})", "Share of the way",
    )  # fmt: skip
    return Table("Between slipping and sticking", heads, rows, _NOTES)


def place_scales(campaign: Campaign) -> dict[str, Scale]:
    """Unit of bending stiffness by group."""
    return {group.name: _scale(group) for group in campaign.groups}


def _scale(group: Group) -> Scale:
    return shown_in("", UNIT, display_of(group))


def _row(place: BundlePlace, scale: Scale) -> tuple[Cell, ...]:
    head = Cell(place.test, place.group) if place.test else Cell(f"mean of {place.group}")
    value = place.value if place.value is not None else float("nan")
    written = write_number(value, place.interval, scale.factor)
    why = sentences(place.reasons)
    if isnan(place.low):
        none = Cell(DASH)
        return head, Cell(written.value, written.interval), none, none, none, Cell(DASH, why)
    low, free, high, least, largest = (
        write_number(each, None, scale.factor, digits=3).value
        for each in (place.low, place.free, place.high, *place.principal)
    )
    share = write_number(100.0 * place.share, None, digits=2)
    if place.share_interval is not None:
        share = write_number(place.share, place.share_interval, 100.0)
    text = share.value if isnan(place.share) else f"{share.value} %"
    return (
        head,
        Cell(written.value, written.interval),
        Cell(low),
        Cell(free),
        Cell(high, "" if least == largest else f"{least} to {largest}"),
        Cell(text, why or (f"{share.interval} %" if share.interval else "")),
    )
