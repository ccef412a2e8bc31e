"""Encoding of frames: MP4 for browsers, GIF for a README, contact sheets for print."""

from __future__ import annotations

import io
import math
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dynaforge.reports.extras import load_extra

Frames = NDArray[np.uint8]


def encode_mp4(frames: Sequence[Frames] | Frames, *, fps: float = 30.0, quality: int = 23) -> bytes:
    """Encode frames as an H.264 MP4 that browsers play (yuv420p, index in front).

    Odd sizes are padded by one repeated row or column, since yuv420p halves both.

    Args:
        frames: T images, each (H, W, 3) uint8, RGB.
        fps: Frames per second.
        quality: CRF of x264: 18 is nearly lossless, 28 is coarse.

    Raises:
        ValueError: No frames, or not images of one size.
        RuntimeError: ffmpeg failed; its message is passed on.
    """
    film = _film(frames)
    _, height, width, _ = film.shape
    film = np.pad(film, ((0, 0), (0, height % 2), (0, width % 2), (0, 0)), mode="edge")
    options = ["-c:v", "libx264", "-preset", "medium", "-crf", str(quality), "-pix_fmt", "yuv420p"]
    return _ffmpeg(film, fps, [*options, "-movflags", "+faststart"], ".mp4")


def encode_gif(frames: Sequence[Frames] | Frames, *, fps: float = 15.0, width: int | None = None) -> bytes:
    """Encode frames as an endless GIF with a palette of its own.

    Args:
        frames: T images, each (H, W, 3) uint8, RGB.
        fps: Frames per second; GIF stores hundredths of a second, so 10, 20, 25 and 50 are exact.
        width: Width to scale to, pixels; None keeps the size.

    Raises:
        ValueError, RuntimeError: As `encode_mp4`.
    """
    scale = f"scale={width}:-1:flags=lanczos," if width else ""
    palette = f"{scale}split[a][b];[a]palettegen=stats_mode=diff[p];[b][p]paletteuse=dither=bayer:bayer_scale=4"
    return _ffmpeg(_film(frames), fps, ["-filter_complex", palette, "-loop", "0"], ".gif")


def contact_sheet(
    frames: Sequence[Frames], labels: Sequence[str] = (), *, columns: int = 4, cell_width: int = 320
) -> bytes:
    """Lay frames out on a grid, row by row, each with a label below it, as PNG.

    Args:
        frames: Images (H, W, 3) uint8 of one size.
        labels: One label per frame, or none at all.
        columns: Frames per row.
        cell_width: Width of a frame on the sheet, pixels.

    Raises:
        ValueError: No frames, frames of different sizes, or not as many labels as frames.
    """
    film = _film(frames)
    if labels and len(labels) != len(film):
        raise ValueError(f"{len(film)} frames need as many labels, given {len(labels)}.")
    image, draw, fonts = (load_extra(f"PIL.{name}") for name in ("Image", "ImageDraw", "ImageFont"))
    columns = max(1, min(columns, len(film)))
    gap, strip = 8, 26 if labels else 0
    cell = (cell_width, round(cell_width * film.shape[1] / film.shape[2]))
    rows = math.ceil(len(film) / columns)
    size = (gap + columns * (cell[0] + gap), gap + rows * (cell[1] + strip + gap))
    sheet = image.new("RGB", size, "white")
    pen, font = draw.Draw(sheet), fonts.load_default(size=15)
    for index, frame in enumerate(film):
        row, column = divmod(index, columns)
        x, y = gap + column * (cell[0] + gap), gap + row * (cell[1] + strip + gap)
        sheet.paste(image.fromarray(frame).resize(cell, image.Resampling.LANCZOS), (x, y))
        if labels:
            pen.text((x + 2, y + cell[1] + 3), _shortened(labels[index], pen, font, cell[0]), fill="#111827", font=font)
    buffer = io.BytesIO()
    sheet.save(buffer, format="PNG")
    return buffer.getvalue()


def encode_png(frame: Frames) -> bytes:
    """Encode one image (H, W, 3) uint8 as PNG."""
    buffer = io.BytesIO()
    load_extra("PIL.Image").fromarray(frame).save(buffer, format="PNG", optimize=True)
    return buffer.getvalue()


def _shortened(text: str, pen: object, font: object, width: int) -> str:
    """Return the text, cut so that it fits a width in pixels."""
    if pen.textlength(text, font=font) <= width:  # type: ignore[attr-defined]
        return text
    while text and pen.textlength(text + "…", font=font) > width:  # type: ignore[attr-defined]
        text = text[:-1]
    return text + "…"


def _film(frames: Sequence[Frames] | Frames) -> Frames:
    """Return the frames as one array, shape (T, H, W, 3)."""
    if len(frames) == 0:
        raise ValueError("A film needs at least one frame.")
    if len({np.shape(frame) for frame in frames}) != 1:
        raise ValueError("All frames of a film must have one size.")
    film = np.asarray(frames)
    if film.ndim != 4 or film.shape[3] != 3 or film.dtype != np.uint8:
        raise ValueError(f"Frames must be (H, W, 3) uint8, given {film.shape[1:]} {film.dtype}.")
    return np.ascontiguousarray(film)


def _ffmpeg(film: Frames, fps: float, options: Sequence[str], suffix: str) -> bytes:
    _, height, width, _ = film.shape
    program = load_extra("imageio_ffmpeg").get_ffmpeg_exe()
    source = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", f"{fps:g}", "-i", "-"]
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / f"film{suffix}"  # not a pipe, since the index of an MP4 is moved to the front
        command = [program, "-loglevel", "error", "-y", *source, *options, str(target)]
        # Generous, only against a hang: encoders are far faster than 5 frames per second.
        done = subprocess.run(
            command, input=film.tobytes(), capture_output=True, timeout=60 + len(film) / 5, check=False
        )
        if done.returncode:
            raise RuntimeError(f"ffmpeg failed: {done.stderr.decode(errors='replace').strip()[-500:]}")
        return target.read_bytes()
