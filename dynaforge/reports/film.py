"""Films of attempts, made again with the camera on: same condition, same policy, same bits."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynaforge.demos import Attempt, Episode
from dynaforge.envs.residual_env import ResidualEnv
from dynaforge.generators import Generator, PlannerOnly, ResidualGenerator
from dynaforge.generators.by_name import policy_for
from dynaforge.reports import Clip, encode_mp4
from dynaforge.sim import Condition
from dynaforge.tasks import Task

Frame = NDArray[np.uint8]


def film(
    env: ResidualEnv, generator: Generator, condition: Condition, *, every: int = 2
) -> tuple[Episode, list[Frame]]:
    """Run one attempt and film it.

    Args:
        env: An env made with `render_mode="rgb_array"`.
        generator: What makes the attempt.
        condition: The condition.
        every: Control steps from frame to frame.

    Returns:
        The episode, and its frames.
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

    with env.world.listening(draw):
        return generator.attempt(env, condition), frames


def skill_picture(task: Task, conditions: Iterable[Condition]) -> Frame:
    """Return a picture of the end of the last gated phase, in a planner-only episode.

    The episode is that of the first condition on which the planner succeeds, or of the last condition if there is none.
    """
    last = max(k for k, phase in enumerate(task.phases) if phase.gate)
    env = ResidualEnv(task, render_mode="rgb_array")
    picture: Frame | None = None

    def draw(step: Any) -> None:
        nonlocal picture
        if step.planned.phase == last or picture is None:
            picture = env.render()

    with contextlib.closing(env), env.world.listening(draw):
        for condition in conditions:
            picture = None
            if PlannerOnly().attempt(env, condition).success:
                break
    assert picture is not None
    return picture


def film_clips(task: Task, policy: Path, attempts: list[Attempt], *, each: int = 2) -> list[Clip]:
    """Film the first successes and the first failures among the attempts of a policy.

    Args:
        task: The task.
        policy: File of the policy.
        attempts: Its attempts.
        each: How many successes, and how many failures.
    """
    generator = ResidualGenerator(policy_for(task, policy))
    successes = [attempt for attempt in attempts if attempt.success][:each]
    failures = [attempt for attempt in attempts if not attempt.success][:each]
    env = ResidualEnv(task, render_mode="rgb_array")
    try:
        clips = []
        for attempt in successes + failures:
            episode, frames = film(env, generator, attempt.condition)
            caption = f"difficulty {attempt.difficulty:.2f}, ended in phase {episode.outcome.phase}"
            clips.append(Clip(encode_mp4(frames, fps=15), attempt.condition.id, episode.outcome, caption))
        return clips
    finally:
        env.close()
