"""The Franka Hand in Bullet: one rack and pinion, with a drive that does not give way and that answers late."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

from dynaforge.sim.bullet import palm_of
from dynaforge.sim.bullet import pybullet as p
from dynaforge.sim.hidden import HIDDEN
from dynaforge.sim.robot import RobotDescription

if TYPE_CHECKING:
    from dynaforge.sim.bullet_scene import BulletRobot

HAND_DELAY = HIDDEN["hand_delay"].nominal  # seconds from a command to the start of its motion
POSITION_GAIN, VELOCITY_GAIN = 0.3, 1.0
SPEED_MARGIN = 0.995  # a stiff gear exceeds the speed limit of the motors by up to 0.2 %
# A joint limit holds a finger that has reached it. One that is just inside of it could be pushed out by as much as a
# load moves it in a substep.
BITE = 1e-5  # metres
GEAR = {"gearRatio": -1, "erp": 2.0, "maxForce": 1e4}  # mends 40 % of an error per substep; newtons, above any load
# The geared motor adds its inertia to the fingers, which weigh a tenth of this. At that tenth, the solver's iterations
# end before it has built up the closing force: 40 N become 16 N.
FINGER_MASS = 0.4  # kg


class HandCommand(NamedTuple):
    """What motors and joint limits of the fingers are told; positions of a finger, metres from closed.

    Attributes:
        target: Where the motors move both fingers to.
        lower, upper: Between which positions each finger is held, whatever pushes it.
    """

    target: float
    lower: tuple[float, float]
    upper: tuple[float, float]


class HandState(NamedTuple):
    """What the hand remembers between control steps, and Bullet's saved states lack.

    Attributes:
        waiting: Finger positions that were sent and have not reached the drive, oldest first, metres from closed.
        due: The substep of each control step before which the oldest reaches the drive.
        last: The last command to motors and joint limits.
    """

    waiting: tuple[float, ...]
    due: int
    last: HandCommand


class Hand:
    """The drive of the fingers.

    A real hand has one motor behind a gear that does not turn when the fingers are pushed. Here each finger has a motor
    with the hand's closing force and speed limit, a stiff gear makes the two one rack and pinion, and joint limits go
    along with the fingers: a finger moves toward its target and is held against whatever pushes it away from there. A
    command reaches the drive after a dead time.

    Args:
        client: The physics client.
        bullet: The robot in Bullet.
        robot: The limits of the hand.
        physics_dt: Length of a substep, seconds.
        substeps: Substeps in a control step.

    Attributes:
        last: The last command to motors and joint limits.
    """

    def __init__(
        self, client: Any, bullet: BulletRobot, robot: RobotDescription, *, physics_dt: float, substeps: int
    ) -> None:
        self._physics_dt, self._substeps, self._open = physics_dt, substeps, robot.width_max / 2
        self._joint_states = partial(client.getJointStates, bullet.body, bullet.fingers)
        self._move = [
            partial(
                client.setJointMotorControl2,
                bullet.body,
                joint,
                p.POSITION_CONTROL,
                force=robot.grip_force,
                positionGain=POSITION_GAIN,
                velocityGain=VELOCITY_GAIN,
                maxVelocity=robot.finger_speed_max * SPEED_MARGIN,
            )
            for joint in bullet.fingers
        ]
        self._hold = [partial(client.changeDynamics, bullet.body, joint) for joint in bullet.fingers]
        self.reset()

    def reset(self, delay: float = HAND_DELAY) -> None:
        """Forget all commands and rest at the full opening, where the fingers are in Bullet's saved state.

        Args:
            delay: Dead time of the episode, seconds; rounded to whole substeps.
        """
        whole, due = divmod(round(delay / self._physics_dt), self._substeps)
        both = (self._open, self._open)
        self.restore(HandState((self._open,) * whole, due, HandCommand(self._open, both, both)))

    @property
    def state(self) -> HandState:
        """What the hand remembers, for `restore`."""
        return HandState(tuple(self._waiting), self._due, self.last)

    def restore(self, state: HandState) -> None:
        """Go on from what the hand remembered; positions and speeds of the fingers are Bullet's own state."""
        self._waiting, self._due = deque(state.waiting), state.due
        self.command(state.last)

    def send(self, width: float) -> int:
        """Send an opening on its way to the drive, at the beginning of a control step.

        Args:
            width: The opening, metres.

        Returns:
            The substep of this control step before which `drive` must be called.
        """
        self._waiting.append(min(max(width / 2, 0.0), self._open))
        return self._due

    def drive(self) -> None:
        """Let the oldest opening reach the drive, and hold the fingers where they have come.

        Fingers that are held at this opening already are told nothing.
        """
        target, (_, lower, upper) = self._waiting.popleft(), self.last
        if lower == upper == (target, target):
            return
        (left, *_), (right, *_) = self._joint_states()
        self.command(
            HandCommand(
                target,
                (min(target, _above(lower[0], left)), min(target, _above(lower[1], right))),
                (max(target, _below(upper[0], left)), max(target, _below(upper[1], right))),
            )
        )

    def command(self, command: HandCommand) -> None:
        """Command motors and joint limits."""
        self.last = command
        for move, hold, lower, upper in zip(self._move, self._hold, command.lower, command.upper, strict=True):
            hold(jointLowerLimit=lower, jointUpperLimit=upper)
            move(targetPosition=command.target)  # after the limits, to which Bullet clips it


def _below(limit: float, position: float) -> float:
    """Return an upper limit that follows a finger down and that the finger touches."""
    return position - BITE if position <= limit else limit


def _above(limit: float, position: float) -> float:
    """Return a lower limit that follows a finger up and that the finger touches."""
    return position + BITE if position >= limit else limit


def couple_fingers(client: Any, body: int, fingers: Sequence[int]) -> None:
    """Make the fingers one rack and pinion.

    Args:
        client: The physics client.
        body: Bullet's index of the robot.
        fingers: Bullet's indices of the two finger joints.
    """
    left, right = fingers
    # PyBullet ignores <mimic>: without this gear the fingers drift apart under load.
    gear = client.createConstraint(body, left, body, right, p.JOINT_GEAR, [0, 1, 0], [0] * 3, [0] * 3)
    client.changeConstraint(gear, **GEAR)
    weigh_fingers(client, body, fingers)


def weigh_fingers(client: Any, body: int, fingers: Sequence[int]) -> None:
    """Give each finger `FINGER_MASS`, at the cost of the palm, so that the whole hand weighs what it did.

    Args:
        client: The physics client.
        body: Bullet's index of the robot.
        fingers: Bullet's indices of the two finger joints.
    """
    palm = palm_of(client, body, fingers)
    masses = [client.getDynamicsInfo(body, link)[0] for link in (palm, *fingers)]
    for link, mass in zip((palm, *fingers), (sum(masses) - 2 * FINGER_MASS, FINGER_MASS, FINGER_MASS), strict=True):
        inertia = client.getDynamicsInfo(body, link)[2]
        client.changeDynamics(body, link, mass=mass, localInertiaDiagonal=inertia)
