"""Films attempts again, with the camera on: same condition, same policy, same bits."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynaforge.algos.policy_file import MlpPolicyFile
from dynaforge.demos import Attempt, Episode
from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.generators import Generator, PlannerOnly, ResidualGenerator
from dynaforge.reports import Clip, encode_mp4
from dynaforge.sim import Condition
from dynaforge.tasks import Task

Frame = NDArray[np.uint8]


def film(
    env: ResidualEnv, generator: Generator, condition: Condition, *, every: int = 2
) -> tuple[Episode, list[Frame]]:
    """Run one attempt and draw every second control step.

    Args:
        env: Made with `render_mode="rgb_array"`.
        generator: What attempts.
        condition: The condition.
        every: Control steps from frame to frame.
    """
    frames: list[Frame] = []
    count = 0

    def draw(step: Any) -> None:
        nonlocal count
        if count % every == 0:
            image = env.render()
            assert image is not None
            frames.append(image)
        count += 1

    env.world.listeners.append(draw)
    try:
        episode = generator.attempt(env, condition)
    finally:
        env.world.listeners.remove(draw)
    return episode, frames


def skill_picture(task: Task, conditions: Iterable[Condition]) -> Frame:
    """Draw the moment at which the planner alone ends the last phase that a residual would correct.

    Of the conditions, the first that the planner wins is shown; the last of them, if it wins none.
    """
    last = max(k for k, phase in enumerate(task.phases) if phase.gate)
    env = ResidualEnv(task, render_mode="rgb_array")
    shown: Frame | None = None

    def draw(step: Any) -> None:
        nonlocal shown
        if step.planned.phase == last or shown is None:
            shown = env.render()

    env.world.listeners.append(draw)
    try:
        for condition in conditions:
            shown = None
            if PlannerOnly().attempt(env, condition).success:
                break
    finally:
        env.close()
    assert shown is not None
    return shown


def film_clips(task: Task, policy: Path, attempts: list[Attempt], *, each: int = 2) -> list[Clip]:
    """Film the first `each` successes and failures among the attempts of a policy."""
    generator = ResidualGenerator(MlpPolicyFile.load(policy, task=task))
    chosen = [[a for a in attempts if a.success is wanted][:each] for wanted in (True, False)]
    env = ResidualEnv(task, render_mode="rgb_array")
    try:
        clips = []
        for attempt in chosen[0] + chosen[1]:
            episode, frames = film(env, generator, attempt.condition)
            caption = f"difficulty {attempt.difficulty:.2f}, ended in phase {episode.outcome.phase}"
            clips.append(Clip(encode_mp4(frames, fps=15), attempt.condition.id, episode.outcome, caption))
        return clips
    finally:
        env.close()
