"""Write the sheet of a virtual tensile test: what a person at the bench would have filled in."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence

from labpipe.virtual_lab.tensile_scenario import TensileScenario


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
    uncertainty = 100.0 * scenario.instruments.gain_uncertainty
    if uncertainty or scenario.section:
        yield "overrides:"
    if uncertainty:
        force, why = "  sources.frame.channels.force", "because: certificate of the load cell"
        gain = f"{{gain: 1 N/N, gain_uncertainty: {uncertainty:.10g} %}}"
        yield f"{force}.unit: {{value: {scenario.export.force_unit}, {why}}}"
        yield f"{force}.calibration: {{value: {gain}, {why}}}"
    for name, size in scenario.section:
        value = f"{1e3 * size:.10g} mm"
        yield f"  specimen.section.{name}: {{value: {value}, because: a tube of another size}}"


def _text(text: str) -> str:
    """In double quotes, which YAML reads as JSON does: names of exports hold commas."""
    return json.dumps(text, ensure_ascii=False)
