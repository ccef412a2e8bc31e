"""A task of your own in one file: tap a peach that rolls by. docs/add_a_task.md explains each part.

python examples/task_of_your_own.py                                  # does the planner succeed by itself?
dynaforge forge --task examples/task_of_your_own.py --budget 5m      # every command takes the file
"""

from itertools import islice

import numpy as np

import dynaforge as df
from dynaforge.tasks.predicates import Departed, Near, Touched
from dynaforge.tasks.targets import Above, Downstream

RADIUS = 0.031

CONDITIONS = df.ConditionSpace(
    task="tap",
    difficulty="speed",
    ranges={"speed": (0.05, 1.0), "x": (0.45, 0.55)},
    units={"speed": "m/s", "x": "m"},
)


def launch(condition: df.Condition) -> dict[str, df.Launch]:
    """Roll the peach without slip along y; it crosses y = 0 after about 1.5 s."""
    speed, x = condition.values["speed"], condition.values["x"]
    start = df.Pose(np.eye(3), np.array((x, -0.3 - 1.2 * speed, RADIUS)))
    spin = np.array((-speed / RADIUS, 0.0, 0.0))
    return {"peach": df.Launch(start, speed * np.array((0.0, 1.0, 0.0)), spin, mass=0.1)}


AHEAD = Downstream("peach", 0.085, reach=0.6, clearance=0.08)  # where the hand waits
ABOVE = Above("peach", 0.02)  # where it taps
PHASES = (
    df.Phase("wait", df.Mode.GLOBAL, AHEAD, width=0.0, done=Near("peach", 0.3), timeout=4.0, failure="not reached"),
    df.Phase("tap", df.Mode.IK, ABOVE, width=0.0, gate=True, done=Touched("peach"), timeout=2.0, failure="missed"),
)
TASK = df.Task(
    name="tap",
    env_name="Tap",
    skill="tap",
    motion="A peach rolls by at 0.05 to 1 m/s.",
    randomisation="Speed, line.",
    goal="A finger touches the peach.",
    instruction="tap the rolling peach",
    conditions=CONDITIONS,
    scene=df.SceneSpec(bodies=(df.BodySpec("peach", "peach/peach.urdf"),), launch=launch),
    phases=PHASES,
    impossible=(("lost track", Departed("peach", 0.75)),),
    residual=df.ResidualSpec(translation=(0.15, 0.06, 0.06)),
)

if __name__ == "__main__":
    env = df.ResidualEnv(TASK)
    for condition in islice(CONDITIONS.stream("val", n_strata=8), 8):
        episode = df.PlannerOnly().attempt(env, condition)
        print(f"{condition.difficulty:.2f} m/s: {'success' if episode.success else episode.failure}")
