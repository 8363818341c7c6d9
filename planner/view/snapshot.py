"""What the page is told of the view: one value, whole, whenever something changed."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from planner.problem.settings import STRATEGY_NAMES
from planner.progress import STAGES
from planner.view.figures import NONE, ROWS, difference, heading, verdict, written
from planner.view.state import Entry, Result, View

_SHOWN = ("start", *STAGES, "baseline", "report")


def snapshot(view: View, title: str, file: str) -> dict[str, Any]:
    """The view as plain values."""
    return {
        "title": title,
        "file": file,
        "solving": view.solving,
        "drafts": view.drafts,
        "strategies": list(STRATEGY_NAMES),
        "note": view.note,
        "mistake": None if view.mistake is None else asdict(view.mistake),
        "trouble": None if view.trouble is None else asdict(view.trouble),
        "panes": [_pane(view, strategy) for strategy in view.panes],
        "differences": differences(view),
        "history": {"columns": _columns(view), "rows": [_row(view, entry) for entry in reversed(view.history)]},
    }


def _pane(view: View, strategy: str) -> dict[str, Any]:
    job, result = view.running, view.results.get(strategy)
    running = None
    if job is not None and job.strategy == strategy:
        running = {
            "job": job.number,
            "stage": job.stage,
            "draft": job.draft,
            "done": _SHOWN.index(job.stage) / len(_SHOWN) if job.stage in _SHOWN else None,
        }
    waiting = view.solving and running is None and strategy not in view.tried and view.content is not None
    return {"strategy": strategy, "running": running, "waiting": waiting, "result": _result(view, result)}


def _result(view: View, result: Result | None) -> dict[str, Any] | None:
    if result is None:
        return None
    outcome = result.outcome
    return {
        "key": result.key,
        "kind": outcome.kind,
        "words": outcome.words,
        "draft": outcome.draft,
        "old": result.turn != view.turn or view.mistake is not None or view.trouble is not None,
    }


def differences(view: View) -> list[dict[str, str]]:
    """Key figures of two panes side by side; none where there are not two whole plans of the same files."""
    if len(view.panes) < 2:
        return []
    pair = [view.results.get(strategy) for strategy in view.panes]
    sides = [dict(each.outcome.figures) for each in pair if each is not None and not each.outcome.draft]
    if len(sides) < 2 or not all(sides) or len({each.turn for each in pair if each is not None}) > 1:
        return []
    rows = []
    for row in ROWS:
        left, right = (side.get(row.key) for side in sides)
        if left is None and right is None:
            continue
        better = {"better": "left", "worse": "right"}.get(verdict(row, left, right), "")
        rows.append(
            {
                **heading(row),
                "left": written(row, left),
                "right": written(row, right),
                "difference": difference(row, right, left),
                "better": better,
            }
        )
    return rows


def _shown_keys(view: View) -> list[str]:
    present = {name for entry in view.history for name, _ in entry.outcome.figures}
    return [row.key for row in ROWS if row.key in present]


def _columns(view: View) -> list[dict[str, str]]:
    keys = _shown_keys(view)
    return [heading(row) for row in ROWS if row.key in keys]


def _row(view: View, entry: Entry) -> dict[str, Any]:
    keys = _shown_keys(view)
    now, before = dict(entry.outcome.figures), dict(entry.before)
    cells = []
    for row in ROWS:
        if row.key not in keys:
            continue
        value, old = now.get(row.key), before.get(row.key)
        change = difference(row, value, old)
        cells.append(
            {
                "text": written(row, value),
                "change": "" if change in (NONE, "0") else change,
                "verdict": verdict(row, value, old),
            }
        )
    return {
        "number": entry.number,
        "at": entry.at,
        "strategy": entry.strategy,
        "kind": entry.outcome.kind,
        "words": entry.outcome.words,
        "changes": None if entry.changes is None else list(entry.changes),
        "cells": cells,
    }
