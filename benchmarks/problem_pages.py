"""Write the figures of shipped problems into their pages, and into the table of all of them.

python -m benchmarks.problem_pages                        every shipped problem
python -m benchmarks.problem_pages peer_cap fibre_plane   these
python -m benchmarks.problem_pages --anew --pictures      plan all again, and draw them again

Existing plans are taken from out/NAME, and missing ones are made there. On a page, the lines between
`<!-- figures: NAME -->` and `<!-- end of figures -->` are written; in the table of all problems, the problem's row except
for the seconds, which `python -m benchmarks.parts` measures. All other text stays as it is.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from PIL import Image

from planner.base.errors import PlannerError
from planner.problem import shipped_problems
from planner.report.picture import draw_picture

PAGES, PICTURES = Path("docs/problems"), Path("docs/pictures")
END = "<!-- end of figures -->"
COLOURS = 256  # of a picture's palette: a third of the bytes, and nothing that one sees
Metrics = dict[str, Any]

# What is told of a plan: words, metric, how it is written. Both strategies' figures stand side by side.
FIGURES: tuple[tuple[str, Callable[[Metrics], str]], ...] = (
    ("at the commanded speed ±2 %, of the length", lambda m: f"{m['at_speed_fraction']:.1%}".replace("%", " %")),
    ("slowest while material is laid, mm/s", lambda m: f"{m['speed_min_mm_s']:.1f}"),
    (
        "deposition time, s (over the ideal one)",
        lambda m: f"{m['deposition_time_s']:,.1f} ({m['deposition_time_s'] / m['ideal_deposition_time_s']:.3f})",
    ),
    ("whole print, s", lambda m: f"{m['print_time_s']:,.0f}"),
    ("least singular value σ", lambda m: f"{m['sigma_min']:.3f}"),
    ("least distance from an end stop, °", lambda m: f"{m['joint_limit_margin_deg']:.1f}"),
    ("least distance from the wrist's flip, °", lambda m: _or_none(m.get("wrist_margin_deg"), ".1f")),
    ("least clearance beyond the tip, mm", lambda m: _or_none(m.get("clearance_min_mm"), ".1f")),
    ("tip off its line at most, mm", lambda m: _small(m["position_error_max_mm"])),
    ("axis off the normal at most, °", lambda m: _small(m["axis_error_max_deg"])),
)


def _or_none(value: float | None, form: str) -> str:
    return "–" if value is None else f"{value:{form}}"


def _many(count: int, what: str) -> str:
    return f"{count:,} {what}" + ("" if count == 1 else "s")


def _small(value: float) -> str:
    return "below 0.001" if value < 1e-3 else f"{value:.3f}"


def plan_of(name: str, out: Path, anew: bool) -> tuple[dict[str, Any], Path]:
    """plan.json of a problem and its folder; made by the command itself where it is not there."""
    folder = out / name
    if anew or not (folder / "plan.json").is_file():
        command = [sys.executable, "-m", "planner.solve", name, "--quiet", "--out", str(folder)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if not (folder / "plan.json").is_file():
            sys.exit(f"{name}: {done.stderr.strip()}")
    plan: dict[str, Any] = json.loads((folder / "plan.json").read_text(encoding="utf-8"))
    if not plan.get("metrics"):
        sys.exit(f"{name}: there is no plan, see {folder / 'report.html'}")
    return plan, folder


def figures(plan: dict[str, Any]) -> list[str]:
    """The lines of a page that tell a plan's figures."""
    m, name = plan["metrics"], plan["problem"]
    passed, checks = sum(check["ok"] for check in plan["checks"]), len(plan["checks"])
    lines = [
        f"{_many(m['beads'], 'bead')} in {_many(m['layers'], 'layer')}, {m['deposited_length_mm'] / 1e3:,.2f} m, "
        f"{m['waypoints']:,} waypoints, {m['extruded_volume_mm3'] / 1e3:,.2f} cm³. "
        f"{'Verified' if plan['verified'] else '**Not verified**'}: {passed} of {checks} checks hold. "
        f"{_dips(plan['dips'])}",
        "",
    ]
    columns = [(f"`{plan['strategy']}`", m), *((f"`{key}`", v) for key, v in plan["baseline"].items() if v)]
    lines += [f"| | {' | '.join(title for title, _ in columns)} |", "|---|" + "---|" * len(columns)]
    for words, form in FIGURES:
        lines.append(f"| {words} | {' | '.join(form(metrics) for _, metrics in columns)} |")
    lines += ["", f"Written by `python -m benchmarks.problem_pages {name}`."]
    return lines


def _dips(dips: Sequence[dict[str, Any]]) -> str:
    stops = sum(dip["limit"] == "stop" for dip in dips)
    rest = f" It stops {_times(stops)} within a bead, to cut." if stops else ""
    others = [dip for dip in dips if dip["limit"] != "stop"]
    if not others:
        return "The speed dips nowhere." + rest
    worst = max(others, key=lambda dip: float(dip["lost_s"]))
    cause = f"{worst['joint']}, {worst['limit']}" if worst["joint"] else worst["limit"]
    costliest = f"the costliest dip takes {worst['lost_s'] * 1e3:.0f} ms ({cause})"
    return f"The speed dips {_times(len(others))}; {costliest}.{rest}"


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count:,} times"


def write_page(page: Path, name: str, lines: Sequence[str]) -> None:
    """Put the figures where the page has room for them."""
    text = page.read_text(encoding="utf-8")
    begin = f"<!-- figures: {name} -->"
    before, found, rest = text.partition(begin)
    _, ended, after = rest.partition(END)
    if not (found and ended):
        sys.exit(f"{page}: no lines {begin} and {END}")
    page.write_text(f"{before}{begin}\n" + "\n".join(lines) + f"\n{END}{after}", encoding="utf-8")


def write_row(index: Path, plan: dict[str, Any]) -> None:
    """Put the figures into the problem's row of the table of all problems."""
    m, name = plan["metrics"], plan["problem"]
    size = f"{m['beads']:,}, {m['layers']:,} | {m['deposited_length_mm'] / 1e3:.1f}"
    reached = f"{m['at_speed_fraction']:.1%} | {m['print_time_s']:,.0f}".replace("%", " %")
    row = re.compile(rf"^(\| \[{name}\]\({name}\.md\) \| [^|]* \|).*\|( [^|]* )\|.*\|.*\|$", re.MULTILINE)
    text, count = row.subn(rf"\g<1> {size} |\g<2>| {reached} |", index.read_text(encoding="utf-8"))
    if count != 1:
        sys.exit(f"{index}: {count} rows of {name}")
    index.write_text(text, encoding="utf-8")


def draw(folder: Path, picture: Path) -> None:
    """The picture of a plan, with a palette."""
    draw_picture(folder, picture)
    Image.open(picture).convert("RGB").quantize(COLOURS).save(picture, optimize=True)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.problem_pages", description="Write the figures of shipped problems into their pages."
    )
    parser.add_argument("problems", nargs="*", help="default: every problem that ships")
    parser.add_argument("--out", type=Path, default=Path("out"), metavar="DIR", help="where plans are, or come to")
    parser.add_argument("--pages", type=Path, default=PAGES, metavar="DIR", help="the pages (default docs/problems)")
    parser.add_argument("--anew", action="store_true", help="plan again what is there already")
    parser.add_argument("--pictures", action="store_true", help="draw the plans, too, into docs/pictures")
    options = parser.parse_args(arguments)
    for name in options.problems or shipped_problems():
        plan, folder = plan_of(name, options.out, options.anew)
        write_page(options.pages / f"{name}.md", name, figures(plan))
        write_row(options.pages / "index.md", plan)
        if options.pictures:
            draw(folder, PICTURES / f"{name}.png")
        print(name, flush=True)
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except PlannerError as error:
        sys.exit(f"error: {error}")
