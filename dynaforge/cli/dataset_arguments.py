"""The arguments of the commands on a folder of demonstrations; see `arguments.py`."""

from __future__ import annotations

import argparse

from dynaforge.cli.task_arguments import add_own_task_argument
from dynaforge.demos import DemonstrationDataset
from dynaforge.demos.dataset_task import task_of
from dynaforge.options.values import NAME, Distinct, Existing, Number, Text, Whole, Written, add_workers, one_of
from dynaforge.tasks import Task


def open_dataset(options: argparse.Namespace) -> tuple[DemonstrationDataset, Task]:
    """Open the folder for reading, with its task.

    Raises:
        ValueError: The task is one of the user's own and was not given, or another one was given.
    """
    dataset = DemonstrationDataset(options.folder)
    try:
        return dataset, task_of(dataset, options.task_file)
    except ValueError as error:
        raise ValueError(f"--task-file: {error}" if options.task_file else str(error)) from error


def on_dataset(parser: argparse.ArgumentParser) -> None:
    """Add the folder and, for tasks of one's own, their file."""
    held = Existing("folder", holding="dataset.json", otherwise="holds no demonstrations")
    parser.add_argument("folder", type=held, help="folder of `dynaforge collect`")
    add_own_task_argument(parser)


def _add_observations(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--observations", type=Existing("folder", holding="settings.json", otherwise="holds no observations"),
        help="folder of `dynaforge render`; by default observations/ if there",
    )  # fmt: skip


def render(parser: argparse.ArgumentParser) -> None:
    """Add the options of `render`."""
    on_dataset(parser)
    parser.add_argument(
        "--cameras", nargs="+", type=Text("the name of a camera", NAME), action=Distinct, metavar="NAME",
        default=["front", "wrist"], help="of front, side, wrist, or your own",
    )  # fmt: skip
    parser.add_argument(
        "--camera-file", type=Existing("file"),
        help="JSON list of cameras of your own: name, eye, look_at, up, in_hand, size, fov",
    )  # fmt: skip
    parser.add_argument("--size", nargs=2, type=Whole(1, 4096), metavar=("W", "H"), help="pixels (default 128 128)")
    parser.add_argument(
        "--points", type=Whole(0, 10**6), default=0, help="size of the point clouds, e.g. 1024; 0 for none"
    )
    parser.add_argument("--no-images", action="store_true", help="keep the point clouds only")
    parser.add_argument(
        "--workspace", nargs=6, type=Number(-1e6, 1e6), metavar=("X0", "Y0", "Z0", "X1", "Y1", "Z1"),
        help="box that the points are cropped to, metres; by default all that the tasks reach, above the table",
    )  # fmt: skip
    add_workers(parser)
    parser.add_argument(
        "--out",
        type=Written("folder", holding="settings.json"),
        help="folder of the observations (default: observations/ in the dataset's)",
    )


def check_render(options: argparse.Namespace) -> None:
    """Refuse an empty workspace, and a rendering of nothing."""
    if options.workspace is not None:
        for axis, low, high in zip("XYZ", options.workspace[:3], options.workspace[3:], strict=True):
            if low >= high:
                raise ValueError(f"--workspace is empty: {axis}0 is {low:g}, {axis}1 must be more than that.")
    if options.no_images and not options.points:
        raise ValueError("--no-images leaves nothing to render: ask for --points, or leave it out.")


def view(parser: argparse.ArgumentParser) -> None:
    """Add the options of `view`."""
    on_dataset(parser)
    parser.add_argument(
        "--limit", type=Whole(), default=40, help="recordings with clip and plots, spread over the difficulties"
    )
    parser.add_argument("--no-clips", action="store_true", help="plots only, which is far quicker")
    _add_observations(parser)
    add_workers(parser)
    parser.add_argument(
        "--viser", action="store_true", help="also a page with the scene in three dimensions, 1 MB a recording"
    )
    parser.add_argument("--rerun", action="store_true", help="also a .rrd file for Rerun's viewer, 0.5 MB a recording")
    parser.add_argument("--out", type=Written("file"), help="HTML file (default: view.html in the folder)")


def check_view(options: argparse.Namespace) -> None:
    """Refuse pictures that would not be shown."""
    if options.no_clips and options.observations:
        raise ValueError("--no-clips leaves out what --observations would show; give one of them.")


def export(parser: argparse.ArgumentParser) -> None:
    """Add the options of `export`."""
    from dynaforge.demos.exporters import FORMATS
    from dynaforge.tasks.action import ACTION_MODES, ROTATIONS

    on_dataset(parser)
    parser.add_argument(
        "--format", required=True, **one_of("format", FORMATS),
        help="; ".join(f"{name}: {text}" for name, text in FORMATS.items()),
    )  # fmt: skip
    parser.add_argument(
        "--actions", default="ee", **one_of("action", ACTION_MODES),
        help="end-effector pose or joint positions, and width",
    )  # fmt: skip
    parser.add_argument(
        "--rotation", default="quat_wxyz", **one_of("rotation", ROTATIONS),
        help="of an end-effector pose: quaternion, two columns of its matrix, which jump nowhere, or rotation vector",
    )  # fmt: skip
    parser.add_argument(
        "--no-elbow", action="store_true",
        help="end-effector actions without the third joint's angle; fast motions are then not met exactly",
    )  # fmt: skip
    _add_observations(parser)
    parser.add_argument("--no-observations", action="store_true", help="leave out what observations/ holds")
    parser.add_argument(
        "--depth", action="store_true",
        help="depth maps in a LeRobot dataset too, whose policies take them for pictures; the others hold them anyway",
    )  # fmt: skip
    parser.add_argument(
        "--privileged", action="store_true",
        help="the truth about objects beside pictures and points too; without those it is there anyway",
    )  # fmt: skip
    parser.add_argument("--failures", action="store_true", help="failed recordings too (collect --keep-failures)")
    licence = Text("an SPDX identifier such as MIT or CC-BY-4.0", r"[A-Za-z0-9][A-Za-z0-9.+() -]*")
    parser.add_argument(
        "--replays", type=Whole(0), default=10, metavar="N",
        help="successes whose actions are given to the task's env, to see them succeed again",
    )  # fmt: skip
    parser.add_argument("--license", type=licence, default="MIT", help="SPDX identifier for the card")
    parser.add_argument("--out", type=Written("folder", new=True), help="new folder; by default FOLDER-FORMAT")


def check_export(options: argparse.Namespace) -> None:
    """Refuse options that contradict each other, and a format without what it needs."""
    seen = options.observations or options.folder / "observations"
    if options.format == "dp3-zarr" and (options.no_observations or not (seen / "settings.json").is_file()):
        raise ValueError(f"--format dp3-zarr needs point clouds: `dynaforge render {options.folder} --points 1024`.")
    if options.no_observations and options.observations:
        raise ValueError("--observations names what --no-observations leaves out; give one of the two.")
    if options.actions == "joint" and options.rotation != "quat_wxyz":
        raise ValueError(f"--rotation {options.rotation} belongs to --actions ee; joint positions have no rotation.")
    if options.actions == "joint" and options.no_elbow:
        raise ValueError("--no-elbow belongs to --actions ee; joint positions settle the elbow.")


def verify(parser: argparse.ArgumentParser) -> None:
    """Add the options of `verify`."""
    on_dataset(parser)
    parser.add_argument(
        "--replay", action="store_true", help="make every recorded attempt again and compare all that it records"
    )
    parser.add_argument(
        "--audit", action="store_true",
        help="look for teleports, edited velocities, broken limits; with --replay for deep overlaps too",
    )  # fmt: skip
    parser.add_argument(
        "--pictures",
        action="store_true",
        help="render what lies in observations/ again and compare it, to the bit",
    )
    add_workers(parser)
