"""All kinds of results of a protocol, as one record each.

A new one is a dataclass in the module of its family, and its name in this list; grammar, checks,
JSON Schema, descriptions and reference page derive from `KINDS`.
"""

from __future__ import annotations

from labpipe.results.bending import BendingStiffness, MidSpan, MomentCurvature, TipTravel, Twist
from labpipe.results.cycles import Energy, PeakDisplacement, PeakForce, ResidualDisplacement
from labpipe.results.failures import EnergyToBreak, FailureResult, ForceLimit, PeakForceDisplacement
from labpipe.results.kinds import ClockResult, Kind
from labpipe.results.kinks_and_plateaus import Kink, Plateau, TwoSegments
from labpipe.results.slack_and_slips import SlackResult, SlipResults
from labpipe.results.stiffness import (
    ComplianceResult,
    Hardening,
    InitialStiffness,
    LineStiffness,
    LoadingStiffness,
    Modulus,
    NormalisedStiffness,
    UnloadingStiffness,
)
from labpipe.results.tension import (
    BreakElongation,
    ElasticModulus,
    MaximumForceElongation,
    ProofStress,
    TensileStrength,
    YieldStress,
)

KINDS: tuple[type[Kind], ...] = (
    ClockResult,
    *(UnloadingStiffness, LoadingStiffness, Hardening, InitialStiffness, LineStiffness),
    *(NormalisedStiffness, Modulus, ComplianceResult, TwoSegments, Kink),
    *(PeakForce, PeakDisplacement, Energy, ResidualDisplacement, FailureResult, EnergyToBreak),
    *(PeakForceDisplacement, ForceLimit),
    *(SlipResults, SlackResult, Plateau, BendingStiffness),
    *(ElasticModulus, ProofStress, YieldStress, TensileStrength),
    *(MaximumForceElongation, BreakElongation),
    *(TipTravel, MomentCurvature, MidSpan, Twist),
)
"""In the order of the reference page."""
