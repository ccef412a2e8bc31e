"""What an episode may record at each control step: one table of names, shapes, units and frames."""

from __future__ import annotations

import difflib
import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from dynaforge.sim.state import BODY_COLUMNS


@dataclass(frozen=True, slots=True, kw_only=True)
class Field:
    """One recorded quantity.

    Attributes:
        meaning: One sentence.
        shape: Shape at one step, without the leading T. A letter stands for a size that the episode chooses, the same
            for all quantities.
        dtype: Type in which it is stored.
        unit: SI unit, "-" for none.
        frame: Frame in which its components are expressed, "-" for none.
    """

    meaning: str
    shape: tuple[int | str, ...] = ()
    dtype: Literal["float64", "int16", "bool"] = "float64"
    unit: str = "-"
    frame: str = "-"


_BODY = {
    name: Field(meaning=column.meaning, shape=(column.size,), unit=column.unit, frame="world")
    for name, column in BODY_COLUMNS.items()
}

_ROBOT = {
    "q": Field(meaning="Measured arm joint positions.", shape=(7,), unit="rad"),
    "dq": Field(meaning="Measured arm joint velocities.", shape=(7,), unit="rad/s"),
    "ee_position": Field(meaning="Measured end-effector position.", shape=(3,), unit="m", frame="world"),
    "ee_quat_wxyz": Field(meaning="Measured end-effector orientation.", shape=(4,), frame="world"),
    "width": Field(meaning="Measured opening between the fingers.", unit="m"),
}


def _sensed(field: Field) -> Field:
    """Return the field of a quantity as planner and policy saw it; a sensed velocity is that of a body's origin."""
    meaning = field.meaning.removeprefix("Measured ").replace("its centre of mass", "its origin")
    note = "Recorded with real sensing only: as planner and policy saw it. "
    return replace(field, meaning=note + meaning[0].upper() + meaning[1:])


SCHEMA: Mapping[str, Field] = MappingProxyType(
    {
        "time": Field(meaning="Simulated time since reset at which the step begins; increases.", unit="s"),
        "phase": Field(meaning="Index into `meta['phases']` of the phase that acted.", dtype="int16"),
        "gate": Field(meaning="Residual gate m of Eq. 5.", dtype="bool"),
        **_ROBOT,
        "peak_force": Field(
            meaning="Greatest net contact force on the robot in a substep of the control step before; 0 at first.",
            unit="N",
        ),
        **{f"object/<name>/{key}": field for key, field in _BODY.items()},
        **{f"fixture/<name>/{key}": field for key, field in _BODY.items()},
        **{f"sensed/{key}": _sensed(field) for key, field in _ROBOT.items()},
        **{f"sensed/<name>/{key}": _sensed(field) for key, field in _BODY.items()},
        "planner_action": Field(
            meaning="a_plan: target pose, then gripper width.", shape=("A",), unit="m, -, m", frame="base"
        ),
        "residual_action": Field(
            meaning="m * scale * a_res as applied.", shape=("R",), unit="m, rad, m", frame="world"
        ),
        "requested_action": Field(
            meaning="a_plan + m * scale * residual, Eq. 5.", shape=("A",), unit="m, -, m", frame="base"
        ),
        "projected_action": Field(
            meaning="What the limits left of the request, Eq. 5.", shape=("A",), unit="m, -, m", frame="base"
        ),
        "joint_reference": Field(meaning="projected_action in joint form, as commanded.", shape=(7,), unit="rad"),
        "joint_velocity_reference": Field(meaning="Joint velocities fed forward with them.", shape=(7,), unit="rad/s"),
        "width_reference": Field(meaning="Gripper width commanded.", unit="m"),
        "left_contact": Field(meaning="The left finger touches the manipulated object.", dtype="bool"),
        "right_contact": Field(meaning="The right finger touches the manipulated object.", dtype="bool"),
        "reward": Field(meaning="Reward of the step; R of Eq. 6 at the last, else 0."),
    }
)
"""Names of `Episode.steps`. `<name>` stands for a body's name; names under `extra/` are free."""


LONGEST_STEP = 10.0  # seconds: there is a digest for every second, so a jump in time would cost memory
_META: Mapping[str, tuple[str, Callable[[Any], bool]]] = {
    "phases": ("a list of names", lambda value: _all_text(value, list)),
    "state_digests": ("a list of digests", lambda value: _all_text(value, list)),
    "versions": ("a mapping of names to versions", lambda value: _all_text(value, dict)),
    "task_hash": ("a digest", lambda value: isinstance(value, str)),
    "policy_hash": ("a digest", lambda value: isinstance(value, str)),
    "dynamics": ("'prescribed'", lambda value: value == "prescribed"),
    "prescribed": ("a mapping", lambda value: isinstance(value, dict)),
    "contact_time": ("seconds, or null", lambda value: value is None or type(value) in (int, float)),
    "planned_contact_time": ("seconds, or null", lambda value: value is None or type(value) in (int, float)),
}


def _all_text(value: Any, kind: type[list[Any] | dict[Any, Any]]) -> bool:
    items = value.values() if isinstance(value, dict) else value
    return isinstance(value, kind) and all(isinstance(item, str) for item in items)


def check_meta(meta: Any) -> None:
    """Check the types of the known entries of `Episode.meta`; other names are free.

    Raises:
        ValueError: An entry is of another type.
    """
    if not isinstance(meta, Mapping):
        raise ValueError("its meta is no mapping")
    for name, (kind, fits) in _META.items():
        if name in meta and not fits(meta[name]):
            raise ValueError(f"its {name} is {meta[name]!r:.80}, where {kind} is expected")


def field_of(name: str) -> Field | None:
    """Return the field of a recorded name; None for a free name under `extra/`.

    Raises:
        ValueError: The name is not in the schema; the closest names are listed.
    """
    parts = name.split("/")
    if parts[0] == "extra" and len(parts) > 1:
        return None
    key = f"{parts[0]}/<name>/{parts[2]}" if len(parts) == 3 and parts[1] else name
    if key in SCHEMA:
        return SCHEMA[key]
    close = difflib.get_close_matches(key, SCHEMA, n=3)
    hint = f"Did you mean {', '.join(map(repr, close))}?" if close else "Names of your own go under 'extra/'."
    raise ValueError(f"No step quantity {name!r} in the episode schema. {hint}")


def validate_steps(steps: Mapping[str, Any]) -> dict[str, NDArray[Any]]:
    """Check recorded arrays against the schema and return frozen C-ordered copies, sorted by name.

    Args:
        steps: Arrays with the same leading dimension T; `time` is required unless there are none.

    Raises:
        ValueError: A name is unknown, a shape or type is wrong, lengths differ, or time does not increase.
    """
    if odd := [name for name in steps if not isinstance(name, str)]:
        raise ValueError(f"Step quantity {odd[0]!r} has no name; names are texts.")
    sizes: dict[str, int] = {}
    arrays = {name: _checked(name, steps[name], sizes) for name in sorted(steps)}
    if not arrays:
        return arrays
    if "time" not in arrays:
        raise ValueError("Steps need 'time', the simulated seconds of each control step.")
    if not len(arrays["time"]):
        raise ValueError("Steps hold no control step; an attempt without any has no steps at all.")
    with np.errstate(invalid="ignore"):  # infinity minus infinity
        gaps = np.diff(arrays["time"], prepend=0.0)
    if not (np.all(gaps[1:] > 0.0) and np.all(np.abs(gaps) < LONGEST_STEP)):
        raise ValueError(f"Step quantity 'time' must increase from step to step, by less than {LONGEST_STEP:g} s.")
    return arrays


def _checked(name: str, value: Any, sizes: dict[str, int]) -> NDArray[Any]:
    field = field_of(name)
    try:
        given = np.asarray(value)
    except ValueError as error:
        raise ValueError(f"Step quantity {name!r} is no array: {error}.") from error
    if given.ndim == 0 or given.dtype.kind not in "biuf":
        raise ValueError(f"Step quantity {name!r} must be a numeric array with leading dimension T.")
    if field is not None and not np.can_cast(given.dtype, field.dtype, "same_kind"):
        raise ValueError(f"Step quantity {name!r} is {given.dtype}; the schema stores {field.dtype}.")
    if field is not None and given.ndim != 1 + len(field.shape):
        raise ValueError(f"Step quantity {name!r} has shape {given.shape}; expected (T, {field.shape}).")
    wanted: tuple[int | str, ...] = ("T", *(field.shape if field is not None else given.shape[1:]))
    for size, want in zip(given.shape, wanted, strict=True):
        expected = sizes.setdefault(want, size) if isinstance(want, str) else want
        if size != expected:
            raise ValueError(
                f"Step quantity {name!r} has shape {given.shape}; expected {wanted} with {sizes} from the others."
            )
    array = np.array(given, dtype=field.dtype if field is not None else given.dtype, order="C")
    array.setflags(write=False)
    return array


def state_digests(steps: Mapping[str, NDArray[Any]]) -> list[str]:
    """Return a digest of the measured state at the beginning and after every second of simulated time.

    It covers joint positions and velocities and all poses and twists, bit for bit: two recordings with the same digests
    have the same physics.

    Args:
        steps: As `Episode.steps`.
    """
    if not steps:
        return []
    times = steps["time"]
    rows = np.searchsorted(times, np.arange(0.0, times[-1] + 1e-9, 1.0) - 1e-9)
    names = [name for name in sorted(steps) if name in ("q", "dq") or name.startswith(("object/", "fixture/"))]
    return [
        hashlib.sha256(b"".join(np.ascontiguousarray(steps[name][row]).tobytes() for name in names)).hexdigest()[:16]
        for row in rows.tolist()
    ]


def schema_markdown() -> str:
    """Return the schema as a Markdown table, for the documentation."""
    rows = ["| name | shape | type | unit | frame | meaning |", "|---|---|---|---|---|---|"]
    for name, field in SCHEMA.items():
        shape = ", ".join(["T", *map(str, field.shape)])
        rows.append(f"| `{name}` | ({shape}) | {field.dtype} | {field.unit} | {field.frame} | {field.meaning} |")
    return "\n".join(rows)
