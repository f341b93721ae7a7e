"""What a walk of a line leaves: its states, step by step, and why it ended where it did."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal, TypeAlias

import numpy as np

from labpipe.records.arrays import ArrayRecord, Floats

Status: TypeAlias = Literal["ok", "doubtful", "failed"]


@dataclass(frozen=True, slots=True, eq=False)
class RodState(ArrayRecord):
    """A line in equilibrium, with its memory.

    Parameters
    ----------
    positions : shape (n + 1, 3), m, of the nodes
    frames : shape (n, 4), unit quaternions of the elements
    stretches : shape (n,), strain of the elements along themselves
    forces : shape (n, 3), N, in space: what the part behind an element pulls the part before it
        with (tension is along d3)
    moments : shape (n + 1, 2, 3), N m, in space: what the part behind pulls the part before with,
        before and behind every node; both are the same but where a clamp holds the node; zero
        before the first and behind the last node
    curvatures : shape (n + 1, 2, 3), 1/m, less those at rest: two bendings and the twist, in the
        mean frame; before and behind every node as the moments; beside a clamp the mean of half an
        element
    node_curvatures : shape (n + 1, 2, 3), 1/m, the same, but carried on to the clamps
    rests : shape (n + 1, 2, sliders, 2), 1/m, where the sliders rest: the memory
    reaction_forces : shape (boundaries, 3), N, what each boundary does to the line in all, loads
        included; weight and moments have none
    reaction_moments : shape (boundaries, 3), N m, of clamps, about their node
    contacts : shape (planes, n + 1, 3), m, where the nodes stick to the planes: their memory
    contact_forces : shape (planes, n + 1, 3), N, what the planes do to the nodes
    slid : shape (boundaries,), m: arc length at rest that lies in a ring; NaN for others
    """

    positions: Annotated[Floats, "nodes", 3]
    frames: Annotated[Floats, "elements", 4]
    stretches: Annotated[Floats, "elements"]
    forces: Annotated[Floats, "elements", 3]
    moments: Annotated[Floats, "nodes", 2, 3]
    curvatures: Annotated[Floats, "nodes", 2, 3]
    node_curvatures: Annotated[Floats, "nodes", 2, 3]
    rests: Annotated[Floats, "nodes", 2, "sliders", 2]
    reaction_forces: Annotated[Floats, "boundaries", 3]
    reaction_moments: Annotated[Floats, "boundaries", 3]
    contacts: Annotated[Floats, "planes", "nodes", 3]
    contact_forces: Annotated[Floats, "planes", "nodes", 3]
    slid: Annotated[Floats, "boundaries"]

    @property
    def bendings(self) -> Floats:
        """Curvature across the line at the nodes, 1/m, shape (n + 1,), less that at rest.

        The larger one where a clamp parts both sides.
        """
        across = self.node_curvatures[:, :, :2]
        return np.asarray(np.max(np.linalg.norm(across, axis=2), axis=1))


@dataclass(frozen=True, slots=True)
class Reason:
    """Why a walk failed or is doubtful.

    Parameters
    ----------
    code : one word
    sentence : for people, with the step and the place
    step : in which
    node : where; None where no place stands out
    """

    code: str
    sentence: str
    step: int
    node: int | None = None


@dataclass(frozen=True, slots=True, eq=False)
class RodPath(ArrayRecord):
    """The states of a walk.

    Parameters
    ----------
    states : of steps 0, 1, ...; fewer than asked for where the walk failed
    status : `failed` where a step has no equilibrium that can be reached; `doubtful` where all have
        but a number is not backed, as beyond the range of the law
    reasons : why, first things first; empty where all is well
    snapped : steps in which the line jumped: it snapped or something let go, so that the
        equilibrium is not the continuation of the one before, and what the jump set free was lost
    work : shape (states,), J, of clamps, loads and weight on the line since before step 0, and what
        it stored then
    stored : shape (states,), J, elastic, of bending, twist and stretch
    lost : shape (states,), J, in the sliders
    rubbed : shape (states,), J, on planes
    jumped : shape (states,), J, set free in jumps and kept by nothing
    lost_in_jumps : shape (states,), J, of `lost`: in the sliders, on the way down in jumps
    """

    states: tuple[RodState, ...]
    status: Status
    reasons: tuple[Reason, ...]
    snapped: tuple[int, ...]
    work: Annotated[Floats, "states"]
    stored: Annotated[Floats, "states"]
    lost: Annotated[Floats, "states"]
    rubbed: Annotated[Floats, "states"]
    jumped: Annotated[Floats, "states"]
    lost_in_jumps: Annotated[Floats, "states"]

    @property
    def last(self) -> RodState:
        """The last state that was reached.

        Raises
        ------
        ValueError
            If there is none: the walk failed in step 0.
        """
        if not self.states:
            message = f"no state was reached: {self.reasons[0].sentence}"
            raise ValueError(message)
        return self.states[-1]
