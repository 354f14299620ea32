"""Brings the processes of a launch up together, starts again what fails, and brings them down in order."""

from __future__ import annotations

import contextlib
import dataclasses
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from twin_node.nodes.launch.child import Child
from twin_node.nodes.launch.host import REFUSED
from twin_node.nodes.launch.joining import Joining
from twin_node.nodes.launch.kinds import check_together
from twin_node.nodes.launch.launch_file import LaunchPlan
from twin_node.nodes.launch.order import Order
from twin_node.nodes.launch.process_plan import ProcessPlan
from twin_node.nodes.topics import GraphError
from twin_node.runtime.neighbours import NodeNames
from twin_node.runtime.zenoh_session import WireError, close_session, open_router

FIRST_STATUS = 10
"""Exit status of a launch whose first process failed for good; the second's is one more, and so on."""
RESTARTS_ALLOWED = 5
"""A process that fails so often within `RESTART_WINDOW_S` is given up, and the launch with it; a spare alone."""
RESTART_WINDOW_S = 30.0
"""Long enough that a fault at start-up, some seconds each time, is told from one a day."""
WELL_S = 600.0
"""A process that has run for so long was well, s: what it fails of then is a new fault."""
LONGEST_WAIT_S = 60.0
"""Longest before a process that has failed again and again is started once more, s."""
HANGS_S = 20.0
"""A process that has not told for so long that it goes on hangs, s; it does once a second, on a busy machine later."""
LOADS_S = 900.0
"""So does one whose nodes are not configured by then, s, which else takes seconds."""
STEP_S = 0.5
"""Longest sleep of the launcher, s: how long an interrupt may go unnoticed."""


@dataclass(frozen=True)
class LaunchResult:
    """How a launch ended."""

    failed: str | None = None
    """Process that was given up; None where all ended as they should."""
    error: str | None = None
    status: int = 0
    """Exit status: 0, or one that tells the failed process by its place in the file."""
    restarts: int = 0


class Launcher:
    """A launch from start to end; `run` blocks, `interrupt` may be called from a signal handler."""

    def __init__(self, plan: LaunchPlan, log_folder: Path, say: Callable[[str], None]) -> None:
        """Processes write to `log_folder`/PROCESS.log; `say(line)` tells the user what happens, or raises `OSError`."""
        self._plan = plan
        self._log_folder = log_folder
        self._tell = say
        self._news = threading.Event()
        self._interrupted = False
        self._is_active = False
        self._router: Any | None = None
        self._joining = Joining(plan.zenoh.routers)
        self._names: NodeNames | None = None
        self._children: dict[str, Child] = {}
        self._spares: dict[str, Child] = {}
        self._spareless: set[str] = set()
        self._failures: dict[str, list[float]] = {}
        self._spare_failures: dict[str, list[float]] = {}
        self._begun: dict[str, float] = {}
        """When each process was last begun."""
        self._short_lives: dict[str, int] = {}
        """How often each has failed in a row, never having been well."""
        self._due: dict[str, float] = {}
        """When those that have failed are to be started again, as long as that waits."""
        self._restarts = 0
        self._looked = time.monotonic()
        self._kept = ""
        """Folder of what processes leave to those that take their places."""

    def _say(self, line: str) -> None:
        """Tells the user; where nobody reads it any more, or its disk is full, the graph goes on all the same."""
        with contextlib.suppress(OSError):
            self._tell(line)

    def interrupt(self) -> None:
        """Lets `run` bring everything down."""
        self._interrupted = True

    def children(self) -> dict[str, int]:
        """Process identifier of every process that runs."""
        return {name: child.pid for name, child in self._children.items() if child.status is None}

    def spares(self) -> dict[str, int]:
        """Process identifier of every spare that waits."""
        return {name: spare.pid for name, spare in self._spares.items() if spare.status is None}

    def active(self) -> dict[str, int]:
        """Process identifier of every process that runs and whose nodes have been told to begin."""
        return {name: child.pid for name, child in self._children.items() if child.is_active and child.status is None}

    @property
    def is_whole(self) -> bool:
        """Whether every process is active, and every spare ready to take over."""
        wanted = {process.name for process in self._processes() if process.has_spare} - self._spareless
        ready = {name for name, spare in self._spares.items() if spare.is_loaded and spare.status is None}
        return set(self.active()) == {process.name for process in self._processes()} and wanted <= ready

    @property
    def is_active(self) -> bool:
        """Whether all nodes have been told to begin."""
        return self._is_active

    def run(self) -> LaunchResult:
        """Runs until interrupted, until a process that ends the launch has finished, or until one is given up.

        Raises `GraphError` where a process refuses at the start what it was given (one that is started again and then
        refuses has failed like any other), or a node of the same name is alive already. Raises `WireError` where the
        network cannot be joined.
        """
        for process in () if self._plan.is_lockstep else self._processes():
            check_together(process.nodes, f"{self._plan.path}: process '{process.name}'")
        try:
            self._log_folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise GraphError(
                f"{self._log_folder}: no folder for logs can be made ({error.strerror}); choose one with --log-dir"
            ) from None
        with _temporary_folder() as self._kept:
            return self._run()

    def _run(self) -> LaunchResult:
        if not self._plan.is_lockstep:
            self._router = open_router(self._plan.zenoh)
        try:
            if not self._plan.is_lockstep:
                self._names = self._claimed_names()
                self._tell_of_foreign_router()
            for process in self._processes():
                self._begin(process, self._spawned(process))
            return self._watch()
        finally:
            self._stop_all()
            if self._names is not None:
                self._names.close()
            if self._router is not None:
                close_session(self._router)

    def _claimed_names(self) -> NodeNames | None:
        """Two nodes of one name would contradict each other: two arms, two speeds."""
        zenoh = self._plan.zenoh
        try:
            names = NodeNames(zenoh, [node for process in self._plan.processes for node in process.nodes])
        except WireError:
            if zenoh.router != "external":
                raise
            return None  # it may come later, from another machine
        is_first = self._router is not None and not any(zenoh.routers)
        taken = None if is_first else names.taken()
        if taken is None:
            return names
        names.close()
        raise self._alive_already(taken)

    def _alive_already(self, node: str) -> GraphError:
        return GraphError(
            f"{self._plan.path}: node '{node}' is alive already in ROS domain {self._plan.zenoh.domain_id}, in another "
            "launch or by a command of its own (record, play, view --live, ur-driver); end that, or give this one "
            "another --namespace, or another number as ROS_DOMAIN_ID"
        )

    def _tell_of_foreign_router(self) -> None:
        """A recorder that was begun before has a router too, and that is joined to no other machine's."""
        zenoh = self._plan.zenoh
        joined = ", ".join(router for router in zenoh.routers if router)
        if self._router is None and zenoh.router == "auto" and joined:
            self._say(
                f"{zenoh.endpoint}: another command's router listens here, which need not be joined to {joined}; if "
                "nothing comes from there, end that command: this launch then takes its place"
            )

    def _watch(self) -> LaunchResult:
        while not self._interrupted:
            self._news.wait(STEP_S)
            self._news.clear()
            self._keep_router()
            self._activate_when_ready()
            self._keep_spares()
            self._end_what_hangs()
            for process in self._processes():
                child = self._children[process.name]
                if child.status is None or self._waits(process):
                    continue
                child.hear_out()
                if child.status == REFUSED and (self._plan.is_lockstep or process.name not in self._failures):
                    raise GraphError(child.error or f"process '{process.name}' refused what it was given")
                if child.status == 0:
                    if process.ends_launch or self._all_are_done():
                        self._say(f"{process.name}: finished")
                        return LaunchResult(restarts=self._restarts)
                elif not self._restarted(process, child):
                    return LaunchResult(process.name, _reason(child), FIRST_STATUS + process.place, self._restarts)
        return LaunchResult(restarts=self._restarts)

    def _end_what_hangs(self) -> None:
        """A process that does not go on has failed like one that has ended; the arm has stood since.

        Time in which this launcher was stopped itself (Ctrl-Z, a machine that was) tells nothing of others.
        """
        now = time.monotonic()
        passed, self._looked = min(now - self._looked, 2 * STEP_S), now
        if self._plan.is_lockstep:
            return
        loading = [spare for spare in self._spares.values() if not spare.is_loaded]  # others only wait, in silence
        for child in (*self._children.values(), *loading):
            child.silence_s = 0.0 if child.has_pulsed else child.silence_s + passed
            child.has_pulsed = False
            if child.silence_s > (HANGS_S if child.is_active else LOADS_S) and child.status is None:
                child.give_up()

    def _keep_router(self) -> None:
        """Takes the place of a router that was another command's (a recorder's, another launch's) and ended with it.

        Those that have found each other go on without one; what is started later would be alone, and nobody told.
        """
        if self._router is None and not self._plan.is_lockstep:
            self._router = open_router(self._plan.zenoh)
        if self._router is not None:
            self._look_beyond(self._router, time.monotonic())

    def _look_beyond(self, router: Any, now: float) -> None:
        """Tells whether other machines' routers are reached, and gives way to who has the same nodes behind them.

        Where a link is slow, or comes later, nobody was seen there when the names were claimed. Raises `GraphError`.
        """
        news = self._joining.news(router, now)
        if news is not None:
            self._say(news)
        if self._names is not None and self._joining.is_fresh(now):
            claimed = self._names.claimed()
            if claimed is not None:
                raise self._alive_already(claimed)

    def _processes(self) -> tuple[ProcessPlan, ...]:
        return (_LOCKSTEP,) if self._plan.is_lockstep else self._plan.processes

    def _all_are_done(self) -> bool:
        return all(child.status == 0 for child in self._children.values())

    def _activate_when_ready(self) -> None:
        """Activates all nodes once every process is configured; later, one that was started again by itself."""
        if not self._is_active:
            if not all(child.is_configured for child in self._children.values()):
                return
            self._is_active = True
            self._say("active: " + ", ".join(self._children))
        for child in reversed(self._children.values()):
            if child.is_configured and not child.is_active:
                child.silence_s = 0.0  # it has come to life a moment ago
                child.activate()

    def _keep_spares(self) -> None:
        """One spare at a time is loaded, so that those that work are not held up."""
        if not self._is_active or not all(child.is_active for child in self._children.values()):
            return
        if any(not spare.is_loaded and spare.status is None for spare in self._spares.values()):
            return
        for process in self._processes():
            spare = self._spares.get(process.name)
            if not process.has_spare or process.name in self._spareless:
                continue
            if spare is not None and spare.error is not None:
                # What it wants only one can have, or what it needs has gone: trying again would not help it.
                self._spareless.add(process.name)
                self._say(f"{process.name}: no spare can be kept: {spare.error}")
            elif spare is None or (spare.status is not None and self._replaces(process, spare)):
                self._add_spare(process)
                return

    def _add_spare(self, process: ProcessPlan) -> None:
        try:
            self._spares[process.name] = self._spawned(process)
        except OSError as error:
            self._spareless.add(process.name)
            self._say(f"{process.name}: no spare can be kept: {error.strerror}")

    def _replaces(self, process: ProcessPlan, spare: Child) -> bool:
        """Whether another spare is tried after one that has ended without a word; where not, that is told."""
        if _counted(self._spare_failures, process.name) <= RESTARTS_ALLOWED:
            return True
        self._spareless.add(process.name)
        self._say(f"{process.name}: no spare can be kept: the last was {_reason(spare)}")
        return False

    def _spawned(self, process: ProcessPlan) -> Child:
        plan = self._plan
        order = Order(
            process.nodes,
            plan.sections,
            plan.follows_clock,
            plan.is_lockstep,
            dataclasses.asdict(plan.zenoh),
            plan.remaps,
            plan.where,
            self._kept,
            process.niceness,
        )
        log = self._log_folder / f"{process.name}.log"
        return Child(process.name, order, log, self._news.set, lambda line: self._say(f"{process.name}: {line}"))

    def _restarted(self, process: ProcessPlan, child: Child) -> bool:
        """Starts a failed process again, unless it must not be, or has failed too often.

        One that goes on failing, though never so often at once, is started at growing intervals: it costs those beside
        it ever less, and its log can be read.
        """
        failures, now = _counted(self._failures, process.name), time.monotonic()
        if not process.restarts or failures > RESTARTS_ALLOWED:
            return False
        self._restarts += 1
        was_well = now - self._begun[process.name] > WELL_S
        in_a_row = self._short_lives[process.name] = 1 if was_well else self._short_lives.get(process.name, 0) + 1
        if in_a_row <= RESTARTS_ALLOWED:
            self._say(f"{process.name}: {_reason(child)}; starting it again")
            self._start_again(process)
        else:
            wait_s = min(2.0 ** (in_a_row - RESTARTS_ALLOWED - 1), LONGEST_WAIT_S)
            often = f"it has failed {in_a_row} times, each within {WELL_S / 60:g} minutes of its start"
            self._say(f"{process.name}: {_reason(child)}; {often}; starting it again in {wait_s:g} s")
            self._due[process.name] = now + wait_s
        return True

    def _waits(self, process: ProcessPlan) -> bool:
        """Whether a process that has failed is to be started again later on; when it is time, that is done."""
        if process.name not in self._due:
            return False
        if time.monotonic() >= self._due[process.name]:
            del self._due[process.name]
            self._start_again(process)
        return True

    def _start_again(self, process: ProcessPlan) -> None:
        """One that there is no room for just now has failed once more, and is tried again at the next look."""
        spare = self._spares.pop(process.name, None)
        if spare is None or spare.status is not None:
            try:
                spare = self._spawned(process)
            except OSError as error:
                self._say(f"{process.name}: cannot be started ({error.strerror})")
                return
        self._begin(process, spare)

    def _begin(self, process: ProcessPlan, child: Child) -> None:
        self._children[process.name], child.silence_s = child, 0.0
        self._begun[process.name] = time.monotonic()
        child.configure()

    def _stop_all(self) -> None:
        """Sources first, as they stand in the file, so that what they sent is still dealt with."""
        for spare in self._spares.values():
            spare.discard()
        for child in self._children.values():
            child.stop()


_LOCKSTEP = ProcessPlan("lockstep", (), restarts=False, ends_launch=True)


def _temporary_folder() -> tempfile.TemporaryDirectory[str]:
    try:
        return tempfile.TemporaryDirectory(prefix="twin_node_", ignore_cleanup_errors=True)
    except OSError as error:
        raise GraphError(f"no temporary folder can be made ({error.strerror}); free space, or set TMPDIR") from None


def _counted(failures: dict[str, list[float]], name: str) -> int:
    """Adds one of now to the failures by their names; gives back how many have been since `RESTART_WINDOW_S`."""
    now = time.monotonic()
    failures[name] = [*(t for t in failures.get(name, []) if now - t < RESTART_WINDOW_S), now]
    return len(failures[name])


def _reason(child: Child) -> str:
    if child.error is not None:
        return f"failed: {child.error}"
    status = child.status
    return f"killed by signal {-status}" if status is not None and status < 0 else f"ended with status {status}"
