"""Write the sheet of a virtual tensile test: what a person at the bench would have filled in."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence

from labpipe.virtual_lab.tensile_scenario import TensileScenario

PROTOCOL_UNCERTAINTY = {"corrugated-tube": 0.0025, "twist-tube": 0.0025, "pet-tape": 0.0025}
"""Uncertainty of the scale of force that the shipped protocols say, by name; none in the others."""


def write_tensile_sheet(scenario: TensileScenario, files: Sequence[str]) -> str:
    """Word the test sheet.

    Parameters
    ----------
    scenario : the test
    files : names of the exports

    Returns
    -------
    The text of ``test.yaml``.
    """
    specimen = (
        f"{{type: {_text(scenario.specimen_type)}, spool: {_text(scenario.spool)}, "
        f"sample: {_text(scenario.sample)}, length: {1e3 * scenario.length:.10g} mm}}"
    )
    names = [_text(file) for file in files]
    frame = names[0] if len(names) == 1 else f"[{', '.join(names)}]"
    lines = [
        "# A synthetic test, made by labpipe's virtual lab. Its truth stands in truth.json.",
        f"test: {_text(scenario.name)}",
        f"protocol: {scenario.protocol}",
        f"specimen: {specimen}",
        f"date: {scenario.date}",
        "operator: virtual lab",
        f"files: {{frame: {frame}}}",
        *_overrides(scenario),
    ]
    return "\n".join(lines) + "\n"


def _overrides(scenario: TensileScenario) -> Iterator[str]:
    """What the protocol cannot know: the certificate of the load cell, another size of tube."""
    uncertainty = scenario.instruments.gain_uncertainty
    is_known = uncertainty == PROTOCOL_UNCERTAINTY.get(scenario.protocol, 0.0)
    if scenario.section or not is_known:
        yield "overrides:"
    if not is_known:
        said = f"{{value: {100.0 * uncertainty:.10g} %, because: certificate of the load cell}}"
        yield f"  sources.frame.channels.force.scale_uncertainty: {said}"
    for name, size in scenario.section:
        value = f"{1e3 * size:.10g} mm"
        yield f"  specimen.section.{name}: {{value: {value}, because: a tube of another size}}"


def _text(text: str) -> str:
    """In double quotes, which YAML reads as JSON does: names of exports hold commas."""
    return json.dumps(text, ensure_ascii=False)
