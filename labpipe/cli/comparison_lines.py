"""What ``labpipe calibrate`` says of curves from elsewhere on a terminal."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from labpipe.records.comparison import CurveMatch, ThirdCurveComparison

_WIDEST = 28


def comparison_lines(comparisons: Sequence[ThirdCurveComparison]) -> list[str]:
    """Lay out third curves for a terminal.

    Parameters
    ----------
    comparisons : third curves held against tests and model

    Returns
    -------
    A heading, a line for each curve and what it is held against, and what was left out; nothing
    without any.
    """
    if not comparisons:
        return []
    width = min(_WIDEST, max(len(each.curve.name) for each in comparisons))
    width = max(width, len("third curve"))
    heading = f"  {'third curve':<{width}}  {'held against':<22}{'points':>8}{'rms mN':>9}"
    lines = ["", f"{heading}{'of peak':>9}{'in band':>9}"]
    for each in comparisons:
        curve = each.curve
        of = f"{curve.wire}, {1e3 * curve.length:.4g} mm"
        for what, found in (("tests", each.tests), ("model", each.model)):
            if found is not None:
                called = (
                    curve.name if len(curve.name) <= _WIDEST else f"{curve.name[: _WIDEST - 1]}…"
                )
                name = f"  {called:<{width}}  {f'{what} of {of}':<22}"
                lines.append(f"{name}{_numbers(found)}")
    notes = [note for each in comparisons for note in each.notes]
    return [*lines, *(f"  {note.severity}: {note.where}: {note.message}" for note in notes)]


def _numbers(found: CurveMatch) -> str:
    errors = found.errors
    if errors is None:
        return f"{0:>8}{'-':>9}{'-':>9}{'-':>9}"
    inside = f"{100.0 * errors.inside:.3g} %" if math.isfinite(errors.inside) else "-"
    share = f"{100.0 * errors.rmse_share:.2g} %"
    return f"{errors.n:>8}{1e3 * errors.rmse:>9.3g}{share:>9}{inside:>9}"
