"""Facts of a protocol for the groups of a report.

The sizes of its specimen, the numbers set by the rig, and those that can be negative.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace

from labpipe.protocol.schema import Protocol, SpecimenBlock
from labpipe.records.declarations import Output
from labpipe.records.result import Specimen


@dataclass(frozen=True, slots=True)
class NumberKinds:
    """Results that groups treat specially, by name without cycle and part.

    Parameters
    ----------
    signed : may be negative
    set_by_rig : describe the motion of the rig, not the specimen
    """

    signed: frozenset[str] = frozenset()
    set_by_rig: frozenset[str] = frozenset()


def number_kinds(protocol: Protocol) -> NumberKinds:
    """Classify the results of a protocol.

    Parameters
    ----------
    protocol : resolved; if it states the stroke, the rig sets results that depend on the stroke
    """
    outputs = dict(_outputs(protocol))
    is_set = protocol.rig.stroke is not None
    return NumberKinds(
        frozenset(stem for stem, output in outputs.items() if output.can_be_negative),
        frozenset(stem for stem, output in outputs.items() if is_set and output.is_set_by_stroke),
    )


def _outputs(protocol: Protocol) -> Iterator[tuple[str, Output]]:
    for entry in protocol.results:
        values = {field.name: getattr(entry, field.name) for field in fields(entry)}
        yield from ((output.name.format_map(values), output) for output in entry.outputs)


def add_sizes(specimen: Specimen, block: SpecimenBlock) -> Specimen:
    """Add the sizes of the protocol to a specimen; its sheet overrides them.

    Parameters
    ----------
    specimen : from its sheet
    block : of the resolved protocol, with the overrides of the test
    """
    section = {} if block.section is None else {**vars(block.section)}
    section.pop("area", None)  # not a length
    sizes = {"length": block.length, "span": block.span, **section}
    stated = {name: size for name, size in sizes.items() if size is not None}
    return replace(specimen, dimensions={**stated, **specimen.dimensions})
