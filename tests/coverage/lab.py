"""The tests that the study draws from the virtual lab, by kind and seed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from labpipe.records.result import Result
from labpipe.virtual_lab import observe
from tests.builders.tensile_tests import reduced_in_memory, shipped
from tests.coverage import lab_bending, lab_tensile

REPOSITORY = Path(__file__).resolve().parents[2]
ON_A_STRING = {
    "wire-cantilever": lab_bending.wire,
    "stranded-wire": lab_bending.stranded_wire,
    "taped-bundle": lab_bending.taped_bundle,
}
KINDS = (*lab_tensile.KINDS, *ON_A_STRING, "conduit-bundle")


def rows(kind: str, seed: int, folder: Path) -> list[dict[str, Any]]:
    """Observe and process a test: of each result whose truth is known truth, numbers, status, why.

    Parameters
    ----------
    kind, seed : one of `KINDS`; of all chance
    folder : for its sheet
    """
    protocols = REPOSITORY / "protocols"
    if kind in lab_tensile.KINDS:
        test = observe(lab_tensile.drawn(kind, seed), seed)
        seen = lab_tensile.as_recorded(kind, seed, test)
        results = reduced_in_memory(seen, shipped(REPOSITORY, kind))
        return compared(results, lab_tensile.truth(kind, seed, test))
    if kind in ON_A_STRING:
        scenario = ON_A_STRING[kind](seed)
        return compared(*lab_bending.on_a_string(scenario, seed, folder, protocols))
    conduit = lab_bending.conduit_bundle(seed)
    return compared(*lab_bending.on_two_supports(conduit, seed, folder, protocols))


def compared(results: tuple[Result, ...], truth: dict[str, float]) -> list[dict[str, Any]]:
    """The same of results; where other slips were found than there are, none of them counts."""
    slips, found = (
        {name for name in names if name.startswith("slip_")}
        for names in (truth, {result.name for result in results})
    )
    made = [_row(result, truth[result.name]) for result in results if result.name in truth]
    if slips == found:
        return made
    nothing = dict.fromkeys(("value", "estimate", "lower", "upper"))
    why = {"status": "failed", "why": "other slips were found"}
    lost = [{"name": name, "truth": truth[name], **nothing, **why} for name in sorted(slips)]
    return [row for row in made if row["name"] not in slips] + lost


def _row(result: Result, truth: float) -> dict[str, Any]:
    interval = result.interval
    return {
        "name": result.name,
        "truth": truth,
        "value": result.value,
        "estimate": result.estimate,
        "lower": None if interval is None else interval.lower,
        "upper": None if interval is None else interval.upper,
        "status": str(result.status),
        "why": result.reason_text,
    }
