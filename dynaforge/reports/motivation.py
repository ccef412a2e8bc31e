"""The picture of why: several generators on the same condition, side by side, with the contact force on the robot."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynaforge.demos import Episode
from dynaforge.demos.replay import Replayer
from dynaforge.generators.generator import Generator, make_env
from dynaforge.geometry import Array, one_line
from dynaforge.reports.extras import load_extra
from dynaforge.reports.plots import BLUE, GREY, RED
from dynaforge.reports.video import encode_mp4
from dynaforge.sim import Condition
from dynaforge.sim.camera import film_camera
from dynaforge.tasks import Task

Frame = NDArray[np.uint8]

FRAME_STEPS = 2  # control steps from frame to frame
BEFORE, AFTER = 0.5, 2.0  # seconds of the strip before the first touch of all, and after the last one
HELD = 1.0  # seconds that a film shows its end
CAPTION, TRACE = 22, 64  # pixels of a film's two lines and of its curve of force


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Shot:
    """One generator's attempt, filmed.

    Attributes:
        label: Which generator it is, in words.
        episode: The attempt.
        frames: Pictures (H, W, 3), one for every `FRAME_STEPS` control steps.
        forces: Greatest net contact force of a physics substep in the control steps up to each frame, since the frame
            before, newtons, shape (F,).
        interval: Seconds from frame to frame.
    """

    label: str
    episode: Episode
    frames: Sequence[Frame]
    forces: Array
    interval: float

    __repr__ = one_line

    @property
    def end(self) -> float:
        """The time of the last frame, seconds."""
        return (len(self.frames) - 1) * self.interval

    @property
    def verdict(self) -> str:
        """How the attempt ended."""
        return "success" if self.episode.success else self.episode.failure

    def index(self, time: float) -> int:
        """Return the frame that shows a moment: the last one before it."""
        return min(max(int(time / self.interval + 1e-6), 0), len(self.frames) - 1)

    def caption(self, time: float) -> str:
        """Return what is written under the frame of a moment: the contact force, and at the end how it ended."""
        index = self.index(time)
        told = f"{index * self.interval:.2f} s   {self.forces[index]:.0f} N"
        return f"{told}   {self.verdict}" if index == len(self.frames) - 1 else told


def first_telling(
    task: Task, planner: Generator, solver: Generator, conditions: Iterable[Condition]
) -> tuple[int, Episode, Episode] | None:
    """Return the first condition that one generator fails and another one solves.

    Args:
        task: The task.
        planner: What must fail.
        solver: What must succeed.
        conditions: The conditions, in order.

    Returns:
        The place of the condition, from 0, and both attempts at it; None if there is no such condition.
    """
    with contextlib.ExitStack() as stack:
        envs = [stack.enter_context(contextlib.closing(make_env(each, task))) for each in (planner, solver)]
        for index, condition in enumerate(conditions):
            failed = planner.attempt(envs[0], condition)
            if failed.success or not len(failed):
                continue
            solved = solver.attempt(envs[1], condition)
            if solved.success:
                return index, failed, solved
    return None


def shoot(task: Task, episodes: Iterable[tuple[str, Episode]]) -> list[Shot]:
    """Film attempts from their recordings: each is simulated again with the camera on, bit for bit.

    Args:
        task: Their task.
        episodes: The attempts, each with a label in words.

    Raises:
        ValueError: A recording is empty, or cannot be simulated again.
    """
    shots, camera = [], film_camera(task.camera)
    with contextlib.closing(Replayer(task, visuals=True)) as replayer:
        for label, episode in episodes:
            if not len(episode):
                raise ValueError(f"The attempt of {episode.generator!r} cannot be filmed: {episode.failure}.")
            states = replayer.recorded_states(episode)
            frames = [replayer.scene.picture(camera) for step, _ in enumerate(states) if step % FRAME_STEPS == 0]
            forces = greatest_since(episode.steps["peak_force"], FRAME_STEPS)
            interval = FRAME_STEPS * task.scene.control_dt
            shots.append(Shot(label=label, episode=episode, frames=frames, forces=forces, interval=interval))
    return shots


def greatest_since(forces: Array, every: int) -> Array:
    """Return the greatest of the values up to every n-th one, since the n-th one before.

    Args:
        forces: A value for each control step, shape (T,).
        every: n.

    Returns:
        Shape (ceil(T / n),); the first entry is the first value.
    """
    ends = range(0, len(forces), every)
    return np.array([np.max(forces[max(end - every + 1, 0) : end + 1]) for end in ends])


def moments(shots: Sequence[Shot], n: int) -> Array:
    """Return the moments of a film strip, the same for all its rows, shape (n,).

    They are spread evenly from shortly before anything is touched in any of the shots until shortly after the last
    first touch, and cover everything where nothing is ever touched.
    """
    touched = [time for shot in shots if (time := shot.episode.meta.get("contact_time")) is not None]
    end = max(shot.end for shot in shots)
    first, last = (min(touched) - BEFORE, max(touched) + AFTER) if touched else (0.0, end)
    return np.linspace(max(first, 0.0), min(last, end), n)


def film(shots: Sequence[Shot]) -> bytes:
    """Return the shots side by side as MP4, with force, verdict and a curve of the force under each; at real speed."""
    interval, scale = shots[0].interval, _scale(shots)
    times = np.arange(0.0, max(shot.end for shot in shots) + HELD, interval)
    return encode_mp4([_film_frame(shots, time, scale) for time in times], fps=1.0 / interval)


def film_strip(shots: Sequence[Shot], *, title: str, n: int = 7) -> bytes:
    """Return a row of frames for each shot as PNG, with the contact force under each frame and its curve below the row.

    Args:
        shots: The shots.
        title: What is written above them.
        n: Frames in a row.
    """
    times, scale = moments(shots, n), _scale(shots)
    figure = load_extra("matplotlib.figure").Figure(figsize=(1.9 * n, 2.6 * len(shots) + 0.4), layout="constrained")
    load_extra("matplotlib.backends.backend_agg").FigureCanvasAgg(figure)
    figure.suptitle(title, fontsize=10)
    for part, shot in zip(np.atleast_1d(figure.subfigures(len(shots), 1)), shots, strict=True):
        axes = part.subplot_mosaic([[f"{k}" for k in range(n)], ["force"] * n], height_ratios=(2.6, 1.0))
        part.suptitle(f"{shot.label}: {shot.verdict}", fontsize=10, x=0.01, ha="left")
        for k, time in enumerate(times):
            axes[f"{k}"].imshow(shot.frames[shot.index(time)], interpolation="antialiased")
            axes[f"{k}"].set(xticks=[], yticks=[])
            axes[f"{k}"].set_xlabel(shot.caption(time), fontsize=7.5, labelpad=2)
        _draw_force(axes["force"], shot, times, scale)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    return buffer.getvalue()


def _draw_force(axes: Any, shot: Shot, times: Array, scale: float) -> None:
    shown = np.arange(len(shot.forces)) * shot.interval
    axes.fill_between(shown, shot.forces, step="mid", color=BLUE, alpha=0.35, linewidth=0)
    axes.plot(shown, shot.forces, drawstyle="steps-mid", color=BLUE, linewidth=1.0)
    for time in times[times <= shot.end]:
        axes.axvline(shot.index(time) * shot.interval, color=GREY, linewidth=0.6, linestyle=":")
    if shot.end < times[-1]:
        axes.axvline(shot.end, color=RED, linewidth=1.0)
    axes.set(xlim=(times[0], times[-1]), ylim=(0.0, scale), ylabel="N")
    axes.tick_params(labelsize=7)
    axes.set_xlabel("s", fontsize=7, labelpad=0)


def _scale(shots: Sequence[Shot]) -> float:
    """Return the upper end of the axes of force, newtons."""
    return max(10.0, 1.1 * max(float(shot.forces.max()) for shot in shots))


def _film_frame(shots: Sequence[Shot], time: float, scale: float) -> Frame:
    """Draw the frames of one moment side by side."""
    image, draw, fonts = (load_extra(f"PIL.{name}") for name in ("Image", "ImageDraw", "ImageFont"))
    height, width, _ = shots[0].frames[0].shape
    sheet = image.new("RGB", (width * len(shots), height + 2 * CAPTION + TRACE), "white")
    pen, font = draw.Draw(sheet), fonts.load_default(size=15)
    for column, shot in enumerate(shots):
        x, index = column * width, shot.index(time)
        sheet.paste(image.fromarray(shot.frames[index]), (x, CAPTION))
        pen.text((x + 6, 2), shot.label, fill="#111827", font=font)
        pen.text((x + 6, height + CAPTION + 2), shot.caption(time), fill="#111827", font=font)
        seconds = max(each.end for each in shots) or shot.interval
        across = x + 6 + (width - 12) * np.arange(index + 1) * shot.interval / seconds
        down = height + 2 * CAPTION + (TRACE - 4) * (1.0 - shot.forces[: index + 1] / scale)
        pen.line([(x + 6, sheet.height - 4), (x + width - 6, sheet.height - 4)], fill=GREY)
        pen.line(list(zip(across.tolist(), down.tolist(), strict=True)), fill=BLUE, width=2)
    return np.asarray(sheet)
