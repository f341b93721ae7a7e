"""What the protocol of a test states for the groups of a report.

Which sizes its specimen has, which of its numbers the rig sets, and which can be negative.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace

from labpipe.protocol.schema import Protocol, SpecimenBlock
from labpipe.records.declarations import Output
from labpipe.records.result import Specimen


@dataclass(frozen=True, slots=True)
class NumberKinds:
    """Results of a protocol that groups treat otherwise than the rest, by stem: no cycle, no part.

    Parameters
    ----------
    signed : that can be negative
    set_by_rig : that say how the rig was driven, not how the specimen behaves
    """

    signed: frozenset[str] = frozenset()
    set_by_rig: frozenset[str] = frozenset()


def number_kinds(protocol: Protocol) -> NumberKinds:
    """Tell apart the results of a protocol.

    Parameters
    ----------
    protocol : resolved; where it states the stroke, the rig sets what follows the stroke
    """
    outputs = dict(_outputs(protocol))
    is_set = protocol.rig.stroke is not None
    return NumberKinds(
        frozenset(stem for stem, output in outputs.items() if output.can_be_negative),
        frozenset(stem for stem, output in outputs.items() if is_set and output.is_set_by_stroke),
    )


def _outputs(protocol: Protocol) -> Iterator[tuple[str, Output]]:
    for entry in protocol.results:
        said = {field.name: getattr(entry, field.name) for field in fields(entry)}
        yield from ((output.name.format_map(said), output) for output in entry.outputs)


def with_sizes(specimen: Specimen, said: SpecimenBlock) -> Specimen:
    """Add to a specimen the sizes that its protocol states; its sheet overrides them.

    Parameters
    ----------
    specimen : as its sheet describes it
    said : of the resolved protocol, which holds the overrides of the test
    """
    section = {} if said.section is None else {**vars(said.section)}
    section.pop("area", None)  # no length
    sizes = {"length": said.length, "span": said.span, **section}
    stated = {name: size for name, size in sizes.items() if size is not None}
    return replace(specimen, dimensions={**stated, **specimen.dimensions})
