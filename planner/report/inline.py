"""The scene of a plan inside another page: in a notebook, below the cell that shows it."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from pathlib import Path

from planner.base.arguments import as_one_of, as_path
from planner.base.errors import InputError
from planner.plan.plan import Plan, plan_line
from planner.report import page
from planner.report.html import stage
from planner.report.judged import judged
from planner.report.scene import plan_scene

HEIGHTS = (200, 4000)  # px


@dataclass(frozen=True, repr=False)
class InlineScene:
    """A page with the animated scene of a plan; notebooks draw it if it is the last value of a cell.

    Attributes:
        html: The whole page, which needs no network.
        height: Height of the frame around it [px].
        told: The plan in one line, as the frame's title.
    """

    html: str
    height: int
    told: str

    def save(self, path: str | Path) -> Path:
        """Write the page into a separate file.

        Args:
            path: The file to write.

        Returns:
            Path of the file.

        Raises:
            OutputError: If it cannot be written.
        """
        target = as_path(path, "path")
        page.write_text(target, self.html)
        return target

    def __repr__(self) -> str:
        return f"<InlineScene of {self.told}>"

    def _repr_html_(self) -> str:
        frame = f'<iframe title="{escape(self.told)}" sandbox="allow-scripts" style="width:100%;height:{self.height}px;border:0"'
        return f'{frame} srcdoc="{escape(self.html)}"></iframe>'


def show(plan: Plan, height: int = 640) -> InlineScene:
    """The scene of a plan for a notebook.

    Args:
        plan: The plan, as `solve` returns it.
        height: Height of the frame around it [px], 200 to 4000.

    Raises:
        InputError: If the height is invalid.
    """
    as_one_of(plan, Plan, "plan", "what solve gives")
    if type(height) is not int or not HEIGHTS[0] <= height <= HEIGHTS[1]:
        raise InputError(
            f"{height!r} is not a valid height", field="height", hint=f"{HEIGHTS[0]} to {HEIGHTS[1]} pixels"
        )
    places = judged(plan).places
    text = page.page(
        "inline",
        plan.name,
        {"scene": plan_scene(plan, places), "charts": []},
        **stage(
            name=plan.problem.name,
            moves=bool(plan.deposit.any()),
            layers=plan.layers,
            dips=bool(plan.dips),
            marks=any(place.letter for place in places),
        ),
        told=plan_line(plan),
    )
    return InlineScene(str(text), height, plan_line(plan))
