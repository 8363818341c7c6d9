"""The data sent to the view's page, the reports that it shows, and the orders that it may send."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from tornado.web import HTTPError

from planner.base.progress import STAGES
from planner.base.web.server import NO_ORDER, TAKEN, Inside, News, PageSite
from planner.problem.settings import STRATEGY_NAMES
from planner.view.machine import (
    NONE,
    ROWS,
    Again,
    Beside,
    Choose,
    Drafts,
    Entry,
    Event,
    Result,
    View,
    difference,
    heading,
    verdict,
    written,
)

# ----------------------------------------------------------------------------------------------------
# The state sent to the page: the whole of it, whenever something changes.

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
    """Key figures of two panes side by side; none unless both have whole plans of the same files."""
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


# ----------------------------------------------------------------------------------------------------
# The view's site: the page, the reports in it, and the user's orders.

LARGEST_REPORT = 100_000_000  # bytes; reports have at most 15 MB
SENDING_TIME = 120.0  # s for an answer: enough for a report through a slow tunnel
# A report from elsewhere must not control the view: it gets no origin, and can reach no address.
REPORT_POLICY = (
    "sandbox allow-scripts allow-downloads; default-src 'none'; script-src 'unsafe-inline' 'wasm-unsafe-eval' blob:; "
    "style-src 'unsafe-inline'; img-src data: blob:; font-src data:; worker-src blob:; frame-ancestors 'self'"
)


def view_site(news: News, report: Callable[[str], Path | None], take: Callable[[Event], None]) -> PageSite:
    """The view's site.

    report  key of a result → file of its report; take: receives the user's orders as events
    """

    def taken(body: bytes) -> int:
        event = order_of(body)
        if event is None:
            return NO_ORDER
        take(event)
        return TAKEN

    reports = (r"report/([0-9]{1,9}-(?:draft|whole|folder))", _Report, {"report": report})
    return PageSite("live view", "planner.view", news, taken, (reports,))


class _Report(Inside):
    async def get(self, key: str) -> None:
        path = self.more["report"](key)
        data = None if path is None else await asyncio.to_thread(_bytes_of, path)
        if data is None:
            raise HTTPError(404)
        self.set_header("Content-Security-Policy", REPORT_POLICY)
        self.set_header("Content-Type", "text/html; charset=utf-8")
        await self.in_time(self.finish(data), SENDING_TIME)


def _bytes_of(path: Path) -> bytes | None:
    try:
        with path.open("rb") as stream:
            data = stream.read(LARGEST_REPORT + 1)
    except OSError:
        return None  # removed in the meantime, replaced by a newer one
    return data if len(data) <= LARGEST_REPORT else None


def order_of(body: bytes) -> Event | None:
    """The event for an order from the page; None if it is not a valid order."""
    try:
        order = json.loads(body)
    except (ValueError, RecursionError):
        return None
    match order:
        case {"do": "choose", "pane": int(pane), "strategy": str(strategy), **rest} if not rest and _known(strategy):
            return Choose(pane, strategy)
        case {"do": "beside", "strategy": str(strategy), **rest} if not rest and _known(strategy):
            return Beside(strategy)
        case {"do": "beside", "strategy": None, **rest} if not rest:
            return Beside(None)
        case {"do": "drafts", "wanted": bool(wanted), **rest} if not rest:
            return Drafts(wanted)
        case {"do": "again", **rest} if not rest:
            return Again()
        case _:
            return None


def _known(strategy: str) -> bool:
    return strategy in STRATEGY_NAMES
