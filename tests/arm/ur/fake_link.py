"""A controller without a network: a test says what it tells, and sees what it was told."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from twin_node.arm.errors import ArmError
from twin_node.arm.ur import UrSample
from twin_node.robot import ur_model
from twin_node.scene import Float64, JointPath

MODEL = ur_model("ur5e")
START = np.array([0.1, -1.3, 1.9, -2.2, -1.5, 0.0])


def quintic(start: Float64 = START, way: float = 0.8, seconds: float = 2.0) -> JointPath:
    """A smooth move of the first two joints."""
    s = np.linspace(0, 1, 201)
    shape = s**3 * (10 - 15 * s + 6 * s**2)
    positions = start + shape[:, None] * np.array([way, way / 2, 0, 0, 0, 0])
    return JointPath(MODEL.joint_names, (s * seconds * 1e9).astype(np.int64) + 5_000_000_000, positions)


def sample(clock_s: float = 1.0, **changes: object) -> UrSample:
    """An arm at `START` that moves its first joint at 0.5 rad/s under a program at full speed."""
    moving = np.array([0.5, 0, 0, 0, 0, 0])
    whole = UrSample(
        clock_s=clock_s,
        q=START,
        qd=moving,
        target_q=START,
        target_qd=moving,
        robot_mode=7,
        safety_mode=1,
        runtime_state=2,
        speed_slider=0.0,
        speed_scaling=1.0,
    )
    return replace(whole, **changes)


@dataclass
class FakeLink:
    """Its slider obeys at once, its arm follows servoJ exactly or, sent a goal every 4 ms, behind a look-ahead."""

    state: UrSample = field(default_factory=sample)
    speeds: list[float] = field(default_factory=list)
    beats: list[int] = field(default_factory=list)
    servoed: list[NDArray[np.floating]] = field(default_factory=list)
    preparations: int = 0
    plays: int = 0
    is_lost: bool = False
    is_obedient: bool = True
    runs_script: bool = True
    script_starts: bool = True
    is_remote: bool = True
    lookahead_s: float = 0.004

    def tell(self, **changes: object) -> None:
        """Change what it tells."""
        self.state = replace(self.state, **changes)

    def read(self) -> UrSample:
        if self.is_lost:
            raise ArmError("connection lost")
        return self.state

    def set_speed(self, fraction: float) -> None:
        self.speeds.append(fraction)
        if self.is_obedient:
            self.tell(speed_slider=fraction)

    def beat(self, count: int) -> None:
        self.beats.append(count)

    def servo(self, q: NDArray[np.floating]) -> bool:
        if self.runs_script:
            self.servoed.append(q)
            come = self.state.target_q + (q - self.state.target_q) * 0.004 / self.lookahead_s
            self.tell(q=come, target_q=come)
        return self.runs_script

    def prepare_servo(self) -> None:
        if not self.script_starts:
            raise ArmError("control script: it does not start")
        self.preparations += 1
        self.runs_script = True

    def play(self) -> None:
        if not self.is_remote:
            raise ArmError("the dashboard does not start the program")
        self.plays += 1
        self.tell(runtime_state=2)

    def close(self) -> None:
        self.is_lost = True
