"""The figures of a group: which there are, what they say in words, and how they are saved."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from functools import partial
from pathlib import Path

import numpy as np

from labpipe.records.group import Band, Group
from labpipe.report.group_curves import draw_curves, draw_scaled, seen
from labpipe.report.group_dots import draw_dots, numbers_to_draw
from labpipe.report.group_lines import draw_lines, has_lines
from labpipe.report.group_look import count_words, finite_end, group_scale
from labpipe.report.group_slips import draw_slips, with_slips
from labpipe.report.numbers import in_words
from labpipe.report.saving import FigureToSave, SavedFigure, save_report_figures


def drawings(group: Group) -> Iterator[FigureToSave]:
    """List the figures that a group has data for; the curves are always there.

    Parameters
    ----------
    group : with or without samples

    Yields
    ------
    Curves, normalised curves, slips, fitted lines, numbers, by names without that of the group.
    """
    about = f"{group.name}, {count_words(group)}"
    yield FigureToSave(
        "curves", partial(draw_curves, group), _curve_caption(group, group.band), _curve_alt(group)
    )
    if group.band_scaled is not None:
        caption = (
            "Force over the peak force of the same sample. What is left of the scatter is not"
            " a matter of strength. " + _curve_caption(group, group.band_scaled, is_scaled=True)
        )
        alt = f"Force over peak force against displacement of {about}."
        yield FigureToSave("scaled", partial(draw_scaled, group), caption, alt)
    if with_slips(group):
        caption = (
            "Samples that slid in their grips, first loading. Grey and dashed: the force as it was"
            " measured. In colour: the force that the numbers were taken from. Each triangle is a"
            " slip of the list above."
        )
        slipped = ", ".join(sample.test for sample in with_slips(group))
        yield FigureToSave(
            "slips", partial(draw_slips, group), caption, f"Slips of {slipped} on their curves."
        )
    if has_lines(group):
        yield FigureToSave("lines", partial(draw_lines, group), _LINES, _line_alt(group))
    numbers = numbers_to_draw(group)
    if numbers:
        names = "; ".join(in_words(number.name) for number in numbers)
        yield FigureToSave(
            "numbers", partial(draw_dots, group), _DOTS, f"Each sample's {names}: {about}."
        )


_LINES = (
    "Straight lines over the windows that they were fitted in, on the first loading of each"
    " sample (grey). The slopes in the key are those of the table of means. Broad and pale: the"
    " windows that the protocol sets. Dotted: the two segments whose break point was fitted too."
    " The curves go on beyond the right edge."
)
_DOTS = (
    "A dot and its 95 % interval for each sample, for the mean of each spool and for the mean that"
    " holds (the last row). In large groups the samples of a spool share a row, without intervals."
    " Intervals that are wider than the panel are cut by its edge; the tables have their ends."
)


def _curve_caption(group: Group, band: Band, *, is_scaled: bool = False) -> str:
    words = (
        "Thin: the first loading of each sample, up to its failure where it failed. Faint:"
        " unloading and later cycles, where there are any."
    )
    if band.n < 2 or not np.isfinite(band.lower).any():
        return f"{words} There is no band; the figure says why."
    return (
        f"{words} Thick: the mean of {band.n} {band.over}, drawn only where all of them have data."
        " Grey area: holds the mean at any one displacement with 95 %."
        + _whole_words(group, band, is_scaled=is_scaled)
        + _cut_words(group, band, is_scaled=is_scaled)
    )


def _whole_words(group: Group, band: Band, *, is_scaled: bool) -> str:
    """Of the band for the whole curve, and how far it goes where the panel does not show it."""
    if not np.isfinite(band.lower_all).any():
        return ""
    words = " Dashed edges: hold the whole mean curve with 95 %."
    low, high = seen(group, band, is_scaled=is_scaled)
    if low <= np.nanmin(band.lower_all) and np.nanmax(band.upper_all) <= high:
        return words
    at = int(np.nanargmax(band.upper_all - band.lower_all))
    across, up = group_scale(group, "displacement"), group_scale(group, "force")
    force, unit = (1.0, "") if is_scaled else (up.factor, f" {up.unit}")
    return (
        f"{words} They leave the panel, as {band.n} curves say little about a whole one:"
        f" at {across.factor * band.displacement[at]:.3g} {across.unit}, where they are furthest"
        f" apart, they are at {force * band.lower_all[at]:.3g} and"
        f" {force * band.upper_all[at]:.3g}{unit}."
    )


def _cut_words(group: Group, band: Band, *, is_scaled: bool) -> str:
    low, high = seen(group, band, is_scaled=is_scaled)
    is_cut = np.nanmin(band.lower) < low or np.nanmax(band.upper) > high
    return " The grey area is wider than the panel and is cut by its edge." if is_cut else ""


def _curve_alt(group: Group) -> str:
    across, up = group_scale(group, "displacement"), group_scale(group, "force")
    words = f"Force against displacement: {group.name}, {count_words(group)}."
    if not len(group.band.displacement):
        return words
    far = across.factor * finite_end(group.band.displacement)
    top = up.factor * finite_end(group.band.mean)
    return (
        f"{words} The mean reaches {top:.3g} {up.unit}; it is known up to {far:.3g} {across.unit}."
    )


def _line_alt(group: Group) -> str:
    names = dict.fromkeys(line.result for sample in group.samples for line in sample.lines)
    words = "; ".join(in_words(name) for name in names)
    return f"Fitted lines on the curves of {group.name}: {words}."


def save_drawings(group: Group, folder: Path, *, stem: str) -> list[SavedFigure]:
    """Draw the figures of a group and save each as SVG, PNG and PDF.

    Parameters
    ----------
    group : to draw
    folder : there already
    stem : begins the names of the files, and the ids of the drawings in a page

    Returns
    -------
    In the order of `drawings`.
    """
    wanted = [each._replace(name=f"{stem}-{each.name}") for each in drawings(group)]
    return save_report_figures(wanted, folder)


def stems(names: Iterable[str]) -> list[str]:
    """Turn names of groups into beginnings of file names: ASCII, lower case, each its own.

    Examples
    --------
    >>> stems(["A2, wire cantilever", "A2-wire-cantilever", "°"])
    ['a2-wire-cantilever', 'a2-wire-cantilever-2', 'group']
    """
    found: list[str] = []
    for name in names:
        plain = re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")[:60] or "group"
        stem, number = plain, 1
        while stem in found:
            number += 1
            stem = f"{plain}-{number}"
        found.append(stem)
    return found
