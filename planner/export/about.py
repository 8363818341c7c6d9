"""What every program says of itself at its head."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from planner.plan import Plan


def about(plan: Plan) -> list[str]:
    """Problem, versions, size, where it resumes, and what was verified, a line each."""
    m = plan.metrics
    return [
        f"Problem {plan.name}, strategy {plan.strategy}",
        ", ".join(f"{name} {version}" for name, version in sorted(plan.versions.items())),
        f"{len(plan.beads)} beads in {plan.layers} layers, "
        f"{m['deposited_length_mm']:.1f} mm deposited, {m['print_time_s']:.1f} s",
        *resumed(plan),
        "Verified before it was written:",
        *verified(plan),
    ]


def resumed(plan: Plan) -> list[str]:
    """A line that says where the rest of a print begins; none for a whole one."""
    return [f"Resumes at bead {plan.first_bead}: those before it must be there"] if plan.first_bead else []


def verified(plan: Plan) -> list[str]:
    """A line for each check."""
    return [f"  {c.name}: {c.worst:.6g} {c.unit} (limit {c.limit:.6g})" for c in plan.checks]
