"""What made the attempts in a folder of demonstrations, as `generators.json` notes it for each generator."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from dynaforge.sim.checks import check_kind, check_number
from dynaforge.sim.setting import Setting


@dataclass(frozen=True, slots=True)
class Provenance:
    """What made the attempts of a generator.

    Attributes:
        policy: Digest of the policy; "" without one.
        task_definition: Digest of the task's definition, which covers its setting.
        task_file: Name of the file that defined the task; "" for a task of the package. Only for messages: a dataset
            may come from anybody, so nothing that it names is ever imported.
        setting: Setting of the task; None where it was not noted.
        lead_time: Seconds of constant-velocity prediction in the planner, which belongs to the definition too.
    """

    policy: str
    task_definition: str
    task_file: str = field(default="", compare=False)
    setting: Setting | None = field(default=None, compare=False)
    lead_time: float = field(default=0.0, compare=False)

    def __post_init__(self) -> None:
        check_kind("Provenance: policy", self.policy, str)
        check_kind("Provenance: task_definition", self.task_definition, str)
        check_kind("Provenance: task_file", self.task_file, str)
        check_kind("Provenance: setting", self.setting, (Setting, type(None)))
        check_number("Provenance: lead_time", self.lead_time, least=0.0)

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain data, without what is not known."""
        return {
            "policy": self.policy,
            "task_definition": self.task_definition,
            **({"task_file": self.task_file} if self.task_file else {}),
            **({} if self.setting is None else {"setting": self.setting.to_dict()}),
            **({"lead_time": self.lead_time} if self.lead_time else {}),
        }

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> Provenance:
        """Rebuild it from `to_dict`.

        Raises:
            ValueError, TypeError: A field is missing, unknown or malformed.
        """
        setting = {"setting": Setting.from_dict(data["setting"])} if "setting" in data else {}
        return Provenance(**{**data, **setting})


def settings_of(sources: Iterable[Provenance]) -> list[Setting]:
    """Return the settings that are noted, each once."""
    return list(dict.fromkeys(source.setting for source in sources if source.setting is not None))


def check_setting(place: str, sources: Iterable[Provenance], setting: Setting | None) -> None:
    """Raise ValueError if attempts were made under another setting than one that is asked for.

    Args:
        place: Where the attempts are, for the message.
        sources: What made them.
        setting: What is asked for; None where that is not known.
    """
    others = [other for other in settings_of(sources) if setting is not None and other != setting]
    if others:
        flags = " ".join(f"--{name} {word}" for name, word in others[0].words().items())
        raise ValueError(
            f"{place} holds attempts under another setting ({others[0]}) than this one ({setting}). Choose another "
            f"folder, or that setting: {flags}."
        )


def check_lead_time(place: str, sources: Iterable[Provenance], lead_time: float) -> None:
    """Raise ValueError if attempts were made with another prediction in the planner than one that is asked for.

    Args:
        place: Where the attempts are, for the message.
        sources: What made them.
        lead_time: What is asked for, seconds.
    """
    others = [source.lead_time for source in sources if source.lead_time != lead_time]
    if others:
        raise ValueError(
            f"{place} holds attempts of a planner that predicts by {others[0]:g} s, not by {lead_time:g} s. Choose "
            "another folder."
        )
