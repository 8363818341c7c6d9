"""The live view without files, clocks, processes or sockets: what happened goes in, what is to be done comes out.

A burst of saves is one reading of the files, and one solve: they are read when they have been quiet for a moment. A
save that says nothing new changes nothing; one that does ends the solve that runs. What cannot be read, or planned,
leaves the last good results where they are.
"""

from __future__ import annotations

from dataclasses import replace

from planner.view.content import Content, Mistake, changes
from planner.view.events import (
    Again,
    Beside,
    Broke,
    Cancel,
    Choose,
    Drafts,
    Effect,
    Event,
    Read,
    ReadFiles,
    Remove,
    Shown,
    Solved,
    Staged,
    Start,
    Tick,
    Touched,
)
from planner.view.state import Entry, Job, Outcome, Result, View, key_of

QUIET_TIME = 0.15  # s without another change before files are read: editors write in several steps
LONGEST_WAIT = 2.0  # s after which a file that never rests is read all the same
MOST_ENTRIES = 50  # of the history

Step = tuple[View, tuple[Effect, ...]]


def step(view: View, event: Event) -> Step:
    """What the view is after an event, and what is to be done about it, in order."""
    match event:
        case Touched(now):
            first = now if view.touched is None else view.touched[0]
            return replace(view, touched=(first, min(now + QUIET_TIME, first + LONGEST_WAIT))), ()
        case Tick(now):
            if view.touched is None or view.reading or now < view.touched[1]:
                return view, ()
            return replace(view, touched=None, reading=True), (ReadFiles(),)
        case Read(found, at):
            return _read(replace(view, reading=False), found, at)
        case Shown():
            return _shown(replace(view, reading=False), event)
        case Staged(job, stage, draft):
            if view.running is None or view.running.number != job:
                return view, ()
            return replace(view, running=replace(view.running, stage=stage, draft=draft)), ()
        case Solved(job, outcome, at):
            return _solved(view, job, outcome, at)
        case Broke(job, mistake):
            return _broke(view, job, mistake)
        case Choose(pane, strategy):
            return _with_panes(view, _exchanged(view.panes, pane, strategy))
        case Beside(strategy):
            kept = view.panes[:1]
            return _with_panes(view, kept if strategy is None or strategy in kept else (*kept, strategy))
        case Drafts(wanted):
            return replace(view, drafts=wanted), ()
        case Again():
            return _anew(replace(view, trouble=None))


def _read(view: View, found: Content | Mistake, at: str) -> Step:
    if isinstance(found, Mistake):
        return replace(view, mistake=found, note=""), ()
    if found == view.content and view.trouble is None:
        return _go_on(replace(view, mistake=None, note=f"saved at {at}: nothing that matters to the plan"))
    fresh = replace(view, content=found, turn=view.turn + 1, mistake=None, trouble=None, note=f"files as of {at}")
    return _anew(replace(fresh, panes=_following(view, found)))


def _following(view: View, content: Content) -> tuple[str, ...]:
    """The panes, the first one with the strategy that the file names, if it named another one before."""
    wanted = dict(content.fields).get("strategy")
    if view.content is None or wanted is None or wanted == dict(view.content.fields).get("strategy"):
        return view.panes
    return _exchanged(view.panes, 0, wanted)


def _anew(view: View) -> Step:
    """Solve all panes again; results of strategies that no pane shows are of the past then."""
    if view.content is None or not view.solving:
        return view, ()
    past = [result for name, result in view.results.items() if name not in view.panes]
    kept = {name: result for name, result in view.results.items() if name in view.panes}
    cancel: tuple[Effect, ...] = () if view.running is None else (Cancel(),)
    fresh, more = _go_on(replace(view, running=None, tried=frozenset(), results=kept))
    return fresh, (*cancel, *(Remove(result.key) for result in past), *more)


def _go_on(view: View) -> Step:
    """Start the next solve that a pane waits for, if none runs and the files can be read."""
    due = next((strategy for strategy in view.panes if strategy not in view.tried), None)
    ready = view.solving and view.running is None and view.content is not None and view.mistake is None
    if not ready or due is None:
        return view, ()
    job = Job(view.jobs + 1, due, view.drafts)
    return replace(view, jobs=job.number, running=job), (Start(job),)


def _solved(view: View, number: int, outcome: Outcome, at: str) -> Step:
    job, content = view.running, view.content
    if job is None or content is None or job.number != number:
        return view, (Remove(key_of(number, outcome.draft)),)
    result = Result(key_of(number, outcome.draft), view.turn, job.strategy, outcome)
    old = view.results.get(job.strategy)
    removed = () if old is None else (Remove(old.key),)
    view = replace(view, results={**view.results, job.strategy: result})
    if outcome.draft:
        return view, removed
    view = _noted(view, job.strategy, outcome, content, at)
    view, effects = _go_on(replace(view, running=None, tried=view.tried | {job.strategy}))
    return view, (*removed, *effects)


def _noted(view: View, strategy: str, outcome: Outcome, content: Content, at: str) -> View:
    """The view with another row in its history."""
    last = next((entry for entry in reversed(view.history) if entry.strategy == strategy), None)
    known = view.solved.get(strategy)
    entry = Entry(
        number=view.entries + 1,
        at=at,
        strategy=strategy,
        changes=None if known is None else changes(known, content),
        outcome=outcome,
        before=() if last is None else last.outcome.figures,
    )
    history = (*view.history, entry)[-MOST_ENTRIES:]
    return replace(view, history=history, entries=entry.number, solved={**view.solved, strategy: content})


def _broke(view: View, number: int, mistake: Mistake) -> Step:
    if view.running is None or view.running.number != number:
        return view, ()
    # what is wrong with a file is wrong for every strategy; anything else may be this one's own trouble
    over = frozenset(view.panes) if mistake.file or mistake.field else frozenset({view.running.strategy})
    return _go_on(replace(view, running=None, trouble=mistake, tried=view.tried | over))


def _shown(view: View, event: Shown) -> Step:
    turn = view.turn + 1
    result = Result(f"{turn}-folder", turn, event.strategy, event.outcome)
    view = replace(view, panes=(event.strategy,), turn=turn, mistake=None, note=f"results as of {event.at}")
    view = replace(view, content=event.settings, tried=frozenset(view.panes), results={event.strategy: result})
    return _noted(view, event.strategy, event.outcome, event.settings, event.at), ()


def _exchanged(panes: tuple[str, ...], pane: int, strategy: str) -> tuple[str, ...]:
    """Panes with a strategy put into one; a strategy that another shows changes places with it."""
    if not 0 <= pane < len(panes):
        return panes
    old = panes[pane]
    return tuple(strategy if i == pane else old if name == strategy else name for i, name in enumerate(panes))


def _with_panes(view: View, panes: tuple[str, ...]) -> Step:
    if not view.solving:
        return view, ()
    view = replace(view, panes=panes)
    if view.running is not None and view.running.strategy not in panes:
        view, effects = _go_on(replace(view, running=None))
        return view, (Cancel(), *effects)
    return _go_on(view)
