"""Where bodies come nearest to each other: a table whose rows bring the scene there."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from typing import TYPE_CHECKING

from planner.report.wording import number

if TYPE_CHECKING:
    from planner.plan import Plan
    from planner.report.places import Place


def approaches_section(plan: Plan, places: Sequence[Place]) -> str:
    """Table of the pairs that come nearest; nothing where no bodies come near. `places` hold them, in the same order."""
    if not plan.approaches:
        return ""
    t = plan.trajectory
    numbers = [k for k, place in enumerate(places) if place.kind == "near"]
    rows = []
    for each, k in zip(plan.approaches, numbers, strict=True):
        bead = int(t.bead[each.sample])
        where = f"bead {bead}, {t.s[each.sample] * 1e3:.1f} mm along it" if bead >= 0 else "travel"
        bad = each.distance < each.need
        pair = f"{escape(each.a)} – {escape(each.b)}"
        show = f"<button type=button data-place={k} aria-pressed=false>show<span class=unseen> {pair}</span></button>"
        rows.append(
            f"<tr{' class=bad' if bad else ''}><th scope=row>{pair}</th><td class=n>{number(each.distance * 1e3, 1)}</td>"
            f"<td class=n>{number(each.need * 1e3, 1)}</td><td class=n>{t.t[each.sample]:.2f}</td>"
            f"<td class=where>{where}</td><td>{show}</td></tr>"
        )
    return (
        "<h2>What comes near</h2><p class=note>Pairs of bodies that come nearest to each other anywhere in the motion, "
        "those with the least to spare first. “Show” brings the scene to that moment, the pair in orange and blue. "
        "Bodies are the simple ones that the checks use. Near its tip the nozzle has to touch the print: that zone is "
        "judged by the check “nozzle clear of part and print”, and left out here where it holds.</p>"
        "<div class=wide><table><thead><tr><th class=left>pair</th><th>distance, mm</th><th>to be kept, mm</th>"
        "<th>time, s</th><th class=left>where</th><th class=left>in the scene</th></tr></thead>"
        f"<tbody>{''.join(rows)}</tbody></table></div>"
    )
