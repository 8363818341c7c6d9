"""What a nozzle task demands of the joints at the commanded speed: twists, their rates, and rungs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from planner.readonly import Array
from planner.resolve.spacing import places_along
from planner.task import FREE, Cones, NozzleTask

SAMPLES_PER_RUNG = 8  # at least: what roll and holder do between rungs must be resolved by the samples


@dataclass(frozen=True)
class Demand:
    """All tasks' samples and rungs in one row, ready for compiled kernels (n samples, r rungs).

    tip (n, 3), frames (n, 3, 3)   as in the tasks
    twist, rate (n, 6)             velocity of the nozzle in the part frame with roll and holder at rest, at the
                                   commanded speed, linear rows first [m/s, rad/s], and its time derivative
    now (n)                        when a sample is reached, in beads: see `NozzleTask.moments`
    weight (n)                     time that a sample stands for at that speed [s]; 0 where nothing is deposited
    rung (r)                       sample of each rung
    place (r)                      where along its task a rung stands, from 0 to 1, in shares of the task's samples
    start, stop (r)                samples that a rung answers for
    time (r)                       time from the rung before it at the commanded speed [s]
    task_rungs (b + 1)             rungs of task i are task_rungs[i] .. task_rungs[i + 1]
    cones                          of the tasks, the same for all
    """

    tip: Array
    frames: Array
    twist: Array
    rate: Array
    now: Array
    weight: Array
    rung: NDArray[np.int64]
    place: Array
    start: NDArray[np.int64]
    stop: NDArray[np.int64]
    time: Array
    task_rungs: NDArray[np.int64]
    cones: Cones = FREE

    def rungs_of(self, task: int) -> slice:
        """Rungs of the task at this index."""
        return slice(int(self.task_rungs[task]), int(self.task_rungs[task + 1]))

    def only(self, rungs: NDArray[np.int64], task_rungs: Sequence[int]) -> Demand:
        """The same samples with some of the rungs (indices), which `task_rungs` divides anew into tasks."""
        return replace(
            self,
            rung=self.rung[rungs],
            place=self.place[rungs],
            start=self.start[rungs],
            stop=self.stop[rungs],
            time=self.time[rungs],
            task_rungs=np.array(task_rungs),
        )


def demand_of(tasks: Sequence[NozzleTask], spacing: float) -> Demand:
    """Differentiate the tasks' paths at the commanded speed and set rungs `spacing` [m] apart, see `places_along`."""
    twists, rates, weights, rungs, places, starts, stops, times = [], [], [], [], [], [], [], []
    offset = 0
    counts = [0]
    for task in tasks:
        t = task.s / task.speed
        linear = np.gradient(task.tip, t, axis=0)
        # omega = 1/2 sum of e_k x e_k' over the frame's axes
        spin = np.gradient(task.frames, t, axis=0)
        angular = 0.5 * np.cross(task.frames, spin, axisa=1, axisb=1).sum(axis=1)
        twist = np.concatenate([linear, angular], axis=1)
        weight = np.gradient(t)
        weight[: task.first] = weight[task.last + 1 :] = 0.0
        twists.append(twist)
        rates.append(np.gradient(twist, t, axis=0))
        weights.append(weight)
        n = len(task)
        place = places_along(task, spacing, SAMPLES_PER_RUNG)
        at = np.round(place * (n - 1)).astype(np.int64)
        edges = np.concatenate([[0], (at[1:] + at[:-1]) // 2, [n]])
        rungs.append(at + offset)
        places.append(place)
        starts.append(edges[:-1] + offset)
        stops.append(edges[1:] + offset)
        times.append(np.concatenate([[0.0], np.diff(t[at])]))
        counts.append(counts[-1] + len(at))
        offset += n
    return Demand(
        tip=np.concatenate([task.tip for task in tasks]),
        frames=np.ascontiguousarray(np.concatenate([task.frames for task in tasks])),
        twist=np.concatenate(twists),
        rate=np.concatenate(rates),
        now=np.concatenate([task.moments for task in tasks]),
        weight=np.concatenate(weights),
        rung=np.concatenate(rungs),
        place=np.concatenate(places),
        start=np.concatenate(starts),
        stop=np.concatenate(stops),
        time=np.concatenate(times),
        task_rungs=np.array(counts),
        cones=tasks[0].cones,
    )
