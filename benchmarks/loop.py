"""The loop at the top of the README: the report's scene during a print, as an animated picture.

python -m benchmarks.loop                        docs/pictures/printing.webp
python -m benchmarks.loop hemisphere_honeycomb --out honeycomb.webp
"""

from __future__ import annotations

import io
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from PIL import Image
from playwright.sync_api import Page

from benchmarks.browser import chromium, page_of
from benchmarks.command import parser_of, told
from benchmarks.screenshots import LOGO, PICTURES
from planner.base.arrays import Array
from planner.base.errors import EXIT_VERIFIED
from planner.plan import Plan
from planner.planning.pipeline import load, solve
from planner.report.html import write_report

WINDOW = (1366, 768)
WIDTH = 640  # px of the picture
ASIDE, ABOVE, AWAY = 70.0, 24.0, 0.75  # degrees around the tip, from the arm's reach, and above the horizon; m
BESIDE = 0.06, 0.05  # m from the tip to what is in the picture's middle: back towards the arm, and up
FRAMES, RATE = 96, 12.0  # pictures, and how many a second
STEP = 0.25  # s of the print between two of them
PRINTED = 0.4  # of the print that is laid before it begins, at least
TOWARDS = 0.35  # cosine between the nozzle and the way to the camera, at which both nozzle and print are seen
QUALITY = 72  # of WebP
MOST = 4_000_000  # bytes
STAND = f"""() => {{
  const s = report.scene.stage, n = s.now.nozzle, tip = new s.THREE.Vector3(n[3], n[7], n[11]);
  const reach = Math.atan2(tip.y, tip.x), around = reach + {np.radians(ASIDE)}, up = {np.radians(ABOVE)};
  const middle = tip.clone().add(new s.THREE.Vector3(-{BESIDE[0]} * Math.cos(reach), -{BESIDE[0]} * Math.sin(reach), {BESIDE[1]}));
  const from = new s.THREE.Vector3(Math.cos(around) * Math.cos(up), Math.sin(around) * Math.cos(up), Math.sin(up));
  s.fly(middle.clone().addScaledVector(from, {AWAY}), middle, true);
}}"""
DRAWN = """(t) => new Promise((done) => {
  report.scene.seek(t); requestAnimationFrame(() => requestAnimationFrame(done));
})"""
BARE = "#letters, .views, .legend, #card-box { visibility: hidden !important; }"


@told
def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code: 1 for a picture of more bytes than a README should load."""
    parser = parser_of("loop", __doc__)
    parser.add_argument("problem", nargs="?", default=LOGO, help=f"default: {LOGO}")
    parser.add_argument("--out", type=Path, default=PICTURES / "printing.webp", metavar="FILE")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", dest="changes")
    options = parser.parse_args(arguments)
    size = write_loop(options.problem, options.changes, options.out)
    print(f"{options.out.name}: {FRAMES} pictures, {size / 1e3:.0f} kB")
    return EXIT_VERIFIED if size <= MOST else 1


def write_loop(problem: str, changes: Sequence[str], path: Path) -> int:
    """Plan a print and write the loop of it; returns its size [bytes]. Raises what `solve` does."""
    plan = solve(load(problem, *changes))
    times = stretch(plan)
    with tempfile.TemporaryDirectory() as folder, chromium() as browser:
        report = Path(folder) / "report.html"
        write_report(plan, report)
        with page_of(browser, report, WINDOW) as page:
            first, *others = frames(page, times.tolist())
    first.save(path, save_all=True, append_images=others, duration=round(1e3 / RATE), loop=0, quality=QUALITY, method=6)
    return path.stat().st_size


def stretch(plan: Plan) -> Array:
    """Times (FRAMES) [s] of the part of a print in which the arm hides it least."""
    t, arm = plan.trajectory, plan.cell.arm
    few = np.arange(0, len(t), max(round(STEP / t.dt), 1))
    T_world_nozzle = arm.poses(t.q[few, : len(arm)])
    x, y = T_world_nozzle[len(few) // 2, :2, 3]
    around = np.arctan2(y, x) + np.radians(ASIDE)
    towards = -T_world_nozzle[:, :2, 2] @ [np.cos(around), np.sin(around)]
    off = np.convolve(np.abs(towards - TOWARDS), np.ones(FRAMES), "valid")
    first = int(PRINTED * len(off))
    begin = first + int(np.argmin(off[first:])) if len(off) else 0
    return np.asarray(t.t[few[begin : begin + FRAMES]])


def frames(page: Page, times: Sequence[float]) -> Iterator[Image.Image]:
    """The scene at times [s], from the arm's side, with what is laid by then and nothing over it."""
    page.evaluate("() => { document.getElementById('grow').checked = true; }")
    page.evaluate(f"(t) => {{ report.scene.seek(t); ({STAND})(); }}", times[len(times) // 2])
    view = page.locator("#view")
    for t in times:
        page.evaluate(DRAWN, t)
        picture = Image.open(io.BytesIO(view.screenshot(style=BARE))).convert("RGB")
        yield picture.resize((WIDTH, round(WIDTH * picture.height / picture.width)), Image.Resampling.LANCZOS)


if __name__ == "__main__":
    sys.exit(main())
