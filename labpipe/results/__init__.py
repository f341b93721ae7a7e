"""All kinds of results of a protocol, as one record each.

A new one is a dataclass in the module of its family, and its name in this list; grammar, checks,
JSON Schema, descriptions and reference page derive from `KINDS`.
"""

from __future__ import annotations

from labpipe.results import bending, cycles, failures, kinds, slack_and_slips, stiffness, tension
from labpipe.results import kinks_and_plateaus as kinks

KINDS: tuple[type[kinds.Kind], ...] = (
    kinds.ClockResult,
    *(stiffness.UnloadingStiffness, stiffness.LoadingStiffness, stiffness.Hardening),
    *(stiffness.InitialStiffness, stiffness.LineStiffness, stiffness.NormalisedStiffness),
    *(stiffness.Modulus, stiffness.ComplianceResult, kinks.TwoSegments, kinks.Kink),
    *(cycles.PeakForce, cycles.PeakDisplacement, cycles.Energy, cycles.ResidualDisplacement),
    *(failures.FailureResult, failures.EnergyToBreak, failures.PeakForceDisplacement),
    *(failures.ForceLimit, slack_and_slips.SlipResults, slack_and_slips.SlackResult),
    *(kinks.Plateau, bending.BendingStiffness),
    *(tension.ElasticModulus, tension.ProofStress, tension.YieldStress, tension.TensileStrength),
    *(tension.MaximumForceElongation, tension.BreakElongation),
    *(bending.TipTravel, bending.MomentCurvature, bending.MidSpan, bending.Twist),
)
"""In the order of the reference page."""
