"""The driver's own loop, one step after another: look, check, decide, tell the arm. No process, no clock of its own."""

from __future__ import annotations

import contextlib
from dataclasses import replace

import numpy as np

from twin_node.arm.errors import ArmError
from twin_node.arm.limiter import SpeedLimiter
from twin_node.arm.ur.follower import PathFollower
from twin_node.arm.ur.foresight import Foresight
from twin_node.arm.ur.freshness import Freshness
from twin_node.arm.ur.link import UrLink
from twin_node.arm.ur.parameters import DriverMode, UrParameters
from twin_node.arm.ur.records import Acknowledge, Decide, DriverReport, DriverState, Follow, Halt, LeavePath, Order
from twin_node.arm.ur.sample import UrSample, implausible, not_ready
from twin_node.arm.ur.slider import Slider
from twin_node.scene import NO_EVIDENCE, Separation

_FOLLOW_RAD = 0.2
"""How far the arm may be behind servoJ's target beside what it lags by the look-ahead at its fastest joint's speed."""
_SETTLE_S = 0.5
"""How long all must be well before a driver that may resume by itself does."""
_LONGEST_LOOK = 3
"""Periods that may pass between two looks at the controller's clock before the rest is the driver's own lateness. A
servoed arm does not make up for it either: it would be sent all of that way at once."""
_HELD_UP_S = 0.08
"""A driver that was held up for so long has left the robot's watchdog, of 10 Hz, without a beat."""
_UNSEEN_S = 5.0
"""A protective stop cannot be unlocked sooner (user manual): within it none has come and gone while nobody looked."""
_LONGEST_WAIT_S = 0.2
"""A path that has waited longer is one for another time: whoever sent it has seen the arm stand. As decisions have."""
_PAUSES_S = 0.1
"""Within this time of its next beat the controller tells of the pause."""


class UrDriver:
    """Drives one connection. All times are ns of one clock that never goes back.

    Whatever is wrong halts it: the speed is set to zero, and the heartbeat ends, so that the robot's own program
    pauses even where the slider does not reach it. A halt stays until `Acknowledge`.
    """

    def __init__(self, parameters: UrParameters, link: UrLink, now: int, halt: Halt | None = None) -> None:
        """`halt` is what an earlier connection left behind."""
        self._parameters = parameters
        self._mode = parameters.mode
        self._model = parameters.arm()
        self._longest_lag_rad = parameters.lookahead_s * float(self._model.max_velocity.max()) + _FOLLOW_RAD
        self._link = link
        self._freshness = Freshness(now, _LONGEST_LOOK * round(parameters.period_s * 1e9))
        self._foresight = Foresight(self._model)
        self._limiter = SpeedLimiter(parameters.limiter)
        self._heard: Separation | None = None
        self._heard_stamp = 0
        self._told: Separation | None = None
        self._halt = halt
        self._well_since: int | None = None
        self._was_playing = False
        """Whether the robot's program ran when all was last well."""
        self._sample: UrSample | None = None
        self._sample_stamp = 0
        self._slider = Slider(link) if self._mode is DriverMode.SLIDER else None
        self._follower: PathFollower | None = None
        self._stepped = now
        self._held_up: int | None = None
        """When the driver was last at work again after it had been held up."""
        if self._mode is DriverMode.SERVO and halt is None:
            self._begin_servo(now)

    def _begin_servo(self, now: int) -> None:
        """Where that cannot be, the arm is halted from the start, and its joints are told of all the same."""
        try:
            problem = self._look(now)
            if problem is None:
                self._link.prepare_servo()
        except ArmError as error:
            problem = str(error)
        if problem is not None:
            self._stop_for(problem)

    def order(self, order: Order, now: int) -> None:
        """Take an order. Raises `ArmError` or `RobotError`, with the reason, for one that is refused.

        A decision that cannot be is refused too, and halts the arm.
        """
        if isinstance(order, Decide):
            self._decide(order.separation, now)
        elif isinstance(order, Follow):
            self._follow(order, now)
        elif isinstance(order, LeavePath):
            self._leave_path()
        elif isinstance(order, Acknowledge):
            self._acknowledge(now)

    def step(self, now: int) -> DriverReport:
        """One period. Nothing in it waits for the arm."""
        passed_s = (now - self._stepped) * 1e-9
        dt = min(passed_s, _LONGEST_LOOK * self._parameters.period_s)
        self._stepped, self._held_up = now, now if passed_s > _HELD_UP_S else self._held_up
        try:
            problem = self._look(now)
            self._told = self._from_rest(self._limiter.tick(now))
            self._judge(problem or self._hunger(now), now)
            self._tell(now, dt)
        except ArmError as error:
            self._stop_for(str(error))
            return self._report(now, is_over=True)
        return self._report(now, is_over=self._freshness.age_s > self._parameters.lost_s)

    def stop(self, reason: str) -> bool:
        """Tell the arm to stand, as the last thing; what cannot be told any more, its watchdog does.

        True where a servoed arm has to be braked along its path: `step` until it `is_braking` no longer.
        """
        if self._halt is None:
            self._stop_for(reason)
        if self._slider is not None:
            with contextlib.suppress(ArmError):  # the link is gone, the heartbeat too: the robot's program pauses
                self._link.set_speed(0.0)
        return self.is_braking

    def _from_rest(self, told: Separation) -> Separation:
        """What the arm is told, unless its program is paused: it is to begin at rest then.

        The slider's way to zero also shows whether it can still be moved: a connection that was cut without a word
        pauses the program too.
        """
        is_paused = self._sample is not None and self._sample.is_paused
        if self._slider is None or not is_paused or told.speed_fraction == 0:
            return told
        self._limiter.stand()
        unseen = "" if self._foresight.is_known else ", and this driver has not seen how it goes on"
        reason = f"stopped: the robot's program is paused{unseen}; press play"
        return replace(told, speed_fraction=0.0, reason=reason)

    def _look(self, now: int) -> str | None:
        """Take the controller's state; gives back what is wrong with it, in words. Raises `ArmError`: it is gone."""
        sample = self._link.read()
        if self._freshness.see(sample.clock_s, now):
            wrong = implausible(self._model, sample, self._sample)
            self._sample = sample if wrong is None else None
            self._sample_stamp = now
            if wrong is not None:
                return wrong
            self._see_again(now)
        if self._freshness.has_gone_back:
            raise ArmError("the controller's clock went back: it was restarted")
        age_s = self._freshness.age_s
        if age_s > self._parameters.stale_s:
            return f"controller silent for {age_s * 1e3:.0f} ms"
        if self._sample is None:
            return None if self._halt is None else self._halt.reason
        return not_ready(self._sample) or self._disobedience(self._sample, now) or self._lapse(self._sample, now)

    def _see_again(self, now: int) -> None:
        """A halt of an earlier connection: of what was done to the arm meanwhile, nobody may have told."""
        halt = self._halt
        if halt is None or halt.seen is None:
            return
        self._halt = replace(halt, seen=None)
        unseen_s = (now - halt.seen) * 1e-9
        if unseen_s > _UNSEEN_S:
            self._halt = Halt(f"{halt.reason}; the arm was not seen for {unseen_s:.0f} s", is_safety=True)

    def _lapse(self, sample: UrSample, now: int) -> str | None:
        """Whether the driver's own lateness has just paused the program that it is to press play for, in words."""
        if self._held_up is None or self._halt is not None or not (self._parameters.plays and self._was_playing):
            return None
        is_own = sample.is_paused and (now - self._held_up) * 1e-9 < _PAUSES_S
        return "the driver was held up: the robot's watchdog has paused its program" if is_own else None

    def _disobedience(self, sample: UrSample, now: int) -> str | None:
        """Whether the arm does what it is told, in words where not."""
        if self._follower is not None and self._halt is None:
            behind = float(np.abs(sample.q - self._follower.q).max())
            if behind > self._longest_lag_rad:
                return f"the arm is {behind:.2f} rad from where it was sent"
            if not sample.is_playing:
                return "the control script has stopped"
        return None if self._slider is None else self._slider.disobedience(sample, now)

    def _hunger(self, now: int) -> str | None:
        """Whether forecasts have stopped coming, in words; a driver that may resume only stands, without a halt."""
        if self._heard is None or self._told is None or self._parameters.resumes:
            return None
        limits = self._parameters.limiter
        age_s = max(
            (now - self._heard_stamp) * 1e-9,
            (now - self._heard.evidence_stamp) * 1e-9 - limits.evidence_latency_s,
        )
        return self._told.reason if age_s >= 2 * limits.deadline_s else None

    def _judge(self, problem: str | None, now: int) -> None:
        """Halt for a problem, or go on where that is allowed and all has been well for a while."""
        if self._mode is DriverMode.READ_ONLY:
            self._halt = None if problem is None else Halt(problem)
            return
        self._watch_program(is_well=problem is None)
        if problem is not None:
            self._well_since = None
            is_worse = self._halt is not None and not self._halt.is_safety and not self._may_move
            if self._halt is None or is_worse:
                self._stop_for(problem)
        elif self._halt is not None and self._parameters.resumes and not self._halt.is_safety:
            self._well_since = self._well_since or now
            if (now - self._well_since) * 1e-9 > _SETTLE_S and not self.is_braking:
                self._resume(now)

    def _resume(self, now: int) -> None:
        """Acknowledge by itself; where that is refused, stay halted for that reason and try again later."""
        try:
            self._acknowledge(now)
        except ArmError as error:
            self._stop_for(str(error))
            self._well_since = None

    def _watch_program(self, is_well: bool) -> None:
        """Keep in mind whether a halt interrupts the robot's program: of another one, or an ended one, it does not."""
        if self._halt is None:
            if is_well and self._sample is not None:
                self._was_playing = self._sample.is_playing
        elif self._sample is not None and self._sample.has_ended:
            self._halt = replace(self._halt, interrupts=False)

    def _stop_for(self, reason: str) -> None:
        interrupts = self._was_playing if self._halt is None else self._halt.interrupts
        self._halt = Halt(reason, is_safety=not self._may_move, interrupts=interrupts)

    @property
    def _may_move(self) -> bool:
        """False where the controller says that it lets nothing move."""
        return self._sample is None or self._sample.may_move

    @property
    def is_braking(self) -> bool:
        """Whether a servoed arm is still led along its path: another command would stop it dead."""
        return self._follower is not None and self._follower.is_braking

    def _decide(self, separation: Separation, now: int) -> None:
        problem = self._impossible(separation, now)
        if problem is not None:
            if self._mode is not DriverMode.READ_ONLY:
                self._judge(problem, now)
            raise ArmError(problem)
        if separation.evidence_stamp == NO_EVIDENCE:
            if self._heard is None:
                return  # the twin has not begun: the arm stands, and nothing is wrong
        else:
            self._heard, self._heard_stamp = separation, now
        self._limiter.decide(separation, now)

    def _impossible(self, separation: Separation, now: int) -> str | None:
        """Why nobody can have decided so, in words; None: somebody can."""
        if not 0 <= separation.speed_fraction <= 1:
            found = f"{separation.speed_fraction:g}"
            return f"decision: expected a speed fraction of 0 to 1, found {found}; check who decides"
        ahead_s = (separation.evidence_stamp - now) * 1e-9
        if ahead_s > self._parameters.limiter.evidence_latency_s:
            return (
                f"decision: its evidence lies {ahead_s:.3g} s in the future, so nobody knows how old it is; let chrony "
                "or PTP keep the clocks of cameras and driver together"
            )
        return None

    def _acknowledge(self, now: int) -> None:
        if self._halt is None:
            return
        problem = self._look(now)
        if problem is not None:
            raise ArmError(f"acknowledge: expected an arm that is well, found: {problem}")
        if self.is_braking:
            raise ArmError(
                "acknowledge: expected an arm that stands, found one that still brakes; acknowledge once it does"
            )
        if self._mode is DriverMode.SERVO:
            self._link.prepare_servo()
        elif self._parameters.plays and self._halt.interrupts and self._sample is not None and self._sample.is_paused:
            self._link.play()  # only what the halt has paused: whoever paused it before may be beside the arm
        self._follower = None
        self._limiter = SpeedLimiter(self._parameters.limiter)
        self._told = self._limiter.tick(now)  # one that resumes would yet be told what was decided while it was halted
        self._heard = None
        self._halt = None

    def _follow(self, order: Follow, now: int) -> None:
        self._check_servo()
        waited_s = (now - order.came) * 1e-9
        if waited_s > _LONGEST_WAIT_S:
            raise ArmError(f"trajectory: refused, it has waited {waited_s:.2f} s for a driver that hung; send it again")
        if self._halt is not None:
            raise ArmError(f"trajectory: refused while halted ({self._halt.reason}); acknowledge first")
        if self._sample is None:
            raise ArmError("trajectory: refused, no state from the controller yet; send it again")
        if self._follower is not None and not self._follower.is_done:
            if self._follower.is_left:
                raise ArmError("trajectory: refused while another is being left; send it once the arm stands")
            raise ArmError("trajectory: refused while another is followed; wait for its end or send one without points")
        lookahead_s = self._parameters.lookahead_s
        self._follower = PathFollower(self._model, order.path, self._sample.target_q, lookahead_s)

    def _leave_path(self) -> None:
        self._check_servo()
        if self._follower is not None:
            self._follower.leave()

    def _check_servo(self) -> None:
        if self._mode is not DriverMode.SERVO:
            raise ArmError(f"trajectory: expected servo mode, found {self._mode.value} mode; choose --mode servo")

    def _tell(self, now: int, dt: float) -> None:
        """Slider and heartbeat, or the next angles, as the mode has it."""
        if self._slider is not None:
            self._slider.move(self._fraction(), now)
            if self._halt is None:
                self._slider.beat(now)
        elif self._mode is DriverMode.SERVO:
            self._servo(self._fraction(), now, dt)

    def _fraction(self) -> float:
        return 0.0 if self._halt is not None or self._told is None else self._told.speed_fraction

    def _servo(self, fraction: float, now: int, dt: float) -> None:
        """The next angles; halted, the arm is braked along its path, then the script is left to its watchdog."""
        follower, sample = self._follower, self._sample
        if self._halt is not None:
            is_blind = sample is None or self._freshness.age_s > self._parameters.stale_s
            if follower is None or not follower.is_braking or is_blind or sample is None or not sample.may_move:
                self._follower = None
                return
        if follower is not None:
            is_taken = self._link.servo(follower.advance(fraction, dt))
        else:
            is_taken = sample is None or self._link.servo(sample.target_q)
        if not is_taken:
            self._follower = None
            if self._halt is None:
                self._stop_for("the control script does not run: it refused a command")

    def _remark(self, slider: Slider, now: int) -> str:
        """What else is to be known of the robot's program, after the reason why it goes or stands; empty: nothing."""
        if self._halt is None:
            return slider.idleness(self._sample, now)
        is_known = self._freshness.age_s <= self._parameters.stale_s
        return slider.unwatchfulness(self._sample, now) if is_known else ""

    def _report(self, now: int, is_over: bool) -> DriverReport:
        is_deaf = self._mode is DriverMode.READ_ONLY
        reason = "read only" if is_deaf or self._told is None else self._told.reason
        if self._halt is not None:
            reason = self._halt.reason
        if self._slider is not None:
            reason += self._remark(self._slider, now)
        report = DriverReport(
            stamp=now,
            state=DriverState.READY if self._halt is None else DriverState.HALTED,
            reason=reason,
            speed_fraction=None if is_deaf else self._fraction(),
            halt=self._halt,
            is_over=is_over,
        )
        if self._sample is None:
            return report
        sample, received = self._sample, self._sample_stamp
        ahead = self._follower.ahead(now) if self._follower else self._foresight.ahead(sample, received, now)
        return replace(report, sample=sample, sample_stamp=received, future=ahead)
