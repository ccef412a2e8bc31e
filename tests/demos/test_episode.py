from __future__ import annotations

import pickle
from dataclasses import replace
from typing import Any

import h5py
import numpy as np
import pytest
from demo_episodes import make_episode

from dynaforge.demos import Attempt, DamagedFileError, Episode
from dynaforge.demos.episode_file import read_episode, write_episode
from dynaforge.demos.ledger import Ledger
from dynaforge.demos.schema import SCHEMA, schema_markdown
from dynaforge.sim import Condition
from dynaforge.sim.loads import Loads
from dynaforge.tasks import Outcome


def with_steps(**steps: Any) -> Episode:
    return Episode(
        condition=Condition("can", 1, 0.4, {}),
        generator="planner",
        outcome=Outcome(success=True, checkpoint=4, phase="lift"),
        duration=1.0,
        steps=steps,
    )


def test_written_episode_reads_back_bit_for_bit(tmp_path):
    episode = make_episode()
    write_episode(tmp_path / "one.h5", episode)
    back = read_episode(tmp_path / "one.h5")
    assert back.header() == episode.header()
    assert back.condition == episode.condition
    assert set(back.steps) == set(episode.steps)
    for name, array in episode.steps.items():
        assert back.steps[name].dtype == array.dtype
        assert back.steps[name].tobytes() == array.tobytes()


def test_file_opens_with_plain_h5py_and_holds_its_header(tmp_path):
    write_episode(tmp_path / "one.h5", make_episode())
    with h5py.File(tmp_path / "one.h5") as file:
        assert '"generator": "planner"' in file.attrs["header"]
        assert file["steps"]["object/can/position"].shape == (20, 3)


def test_an_episode_without_steps_reads_back(tmp_path):
    write_episode(tmp_path / "none.h5", with_steps())
    assert dict(read_episode(tmp_path / "none.h5").steps) == {}


def test_content_hash_changes_with_any_array_and_with_the_header():
    base = make_episode()
    touched = dict(base.steps) | {"q": base.steps["q"] + np.eye(20, 7) * 1e-15}
    other = Episode.from_header(base.header(), touched)
    renamed = Episode.from_header(base.header() | {"phase": "close"}, base.steps)
    assert len({base.content_hash(), other.content_hash(), renamed.content_hash()}) == 3
    assert make_episode().content_hash() == base.content_hash()


def test_episode_survives_pickling_between_processes():
    episode = make_episode()
    assert pickle.loads(pickle.dumps(episode)).content_hash() == episode.content_hash()


def test_steps_are_read_only_copies():
    time = np.arange(3.0)
    episode = with_steps(time=time)
    time[0] = 9.0
    assert episode.steps["time"][0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        episode.steps["time"][0] = 1.0


@pytest.mark.parametrize("position", [*range(0, 600, 7), -1])
def test_a_single_flipped_bit_is_noticed_and_the_file_named(tmp_path, position):
    path = tmp_path / "flipped.h5"
    write_episode(path, make_episode())
    data = bytearray(path.read_bytes())
    data[position] ^= 1 << (position % 8)
    path.write_bytes(data)
    with pytest.raises(DamagedFileError, match=r"flipped\.h5 is damaged"):
        read_episode(path)


@pytest.mark.parametrize("keep", [0, 100, 512, 4000, -1])
def test_a_truncated_file_is_noticed_and_named(tmp_path, keep):
    path = tmp_path / "cut.h5"
    write_episode(path, make_episode())
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(DamagedFileError, match=r"cut\.h5 is damaged"):
        read_episode(path)


def test_a_file_of_another_kind_is_distinguished_from_a_damaged_one(tmp_path):
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["data"] = np.zeros(3)
    with pytest.raises(DamagedFileError, match=r"other\.h5 .*does not begin as an episode file"):
        read_episode(tmp_path / "other.h5")


@pytest.mark.parametrize(
    ("steps", "message"),
    [
        ({"time": [0.0, 1.0], "qq": np.zeros((2, 7))}, "Did you mean"),
        ({"time": [0.0, 1.0], "q": np.zeros((2, 6))}, "'q' has shape"),
        ({"time": [0.0, 1.0], "q": np.zeros((3, 7))}, "'time' has shape"),
        ({"time": [0.0, 1.0], "gate": np.zeros(2)}, "'gate' is float64"),
        ({"time": [0.0, 0.0]}, "must increase"),
        ({"q": np.zeros((2, 7))}, "need 'time'"),
        ({"time": [0.0], "planner_action": np.zeros((1, 8)), "requested_action": np.zeros((1, 7))}, "expected"),
    ],
)
def test_steps_outside_the_schema_are_refused(steps, message):
    with pytest.raises(ValueError, match=message):
        with_steps(**steps)


def test_free_names_go_under_extra():
    episode = with_steps(**{"time": [0.0], "extra/mine": np.ones((1, 2, 3))})
    assert episode.steps["extra/mine"].shape == (1, 2, 3)


def test_a_generators_name_fits_into_a_files_name():
    with pytest.raises(ValueError, match="'a/b'"):
        replace(with_steps(), generator="a/b")


def test_schema_page_lists_every_name():
    page = schema_markdown()
    assert all(f"`{name}`" in page for name in SCHEMA)


def test_an_episode_is_shown_on_one_line() -> None:
    assert repr(make_episode()) == "Episode(can, planner, success, 20 steps)"
    assert repr(make_episode(success=False, steps=3)) == "Episode(can, planner, failure 'timeout in close', 3 steps)"


def test_the_loads_of_an_attempt_are_kept_in_its_line_and_old_lines_have_none(tmp_path):
    outcome = Outcome(success=True, checkpoint=4)
    old = Attempt(condition=Condition("can", 1, 0.3, {}), generator="planner_only", outcome=outcome, duration=1.0)
    new = replace(old, generator="residual", loads=Loads(peak_force=31.5, force=12.25, strict=0.6125))
    ledger = Ledger(tmp_path / "attempts.jsonl")
    ledger.append(old)
    ledger.append(new)
    assert "loads" not in old.to_dict()
    assert [attempt.loads for attempt in ledger.attempts()] == [None, new.loads]
    for wrong in ({"push": 1.0}, {"force": -1.0}, 3):
        with pytest.raises(ValueError, match="loads"):
            Attempt.from_dict(new.to_dict() | {"loads": wrong})


def test_an_attempt_tells_its_processor_time_only_where_it_is_known() -> None:
    """Lines of ledgers that were written without it stay valid, since a line must be one that is written today."""
    unknown = Attempt.of(make_episode(), wall_seconds=0.5)
    known = replace(unknown, cpu_seconds=0.25)
    assert "cpu_seconds" not in unknown.to_dict()
    assert [Attempt.from_dict(each.to_dict()) for each in (unknown, known)] == [unknown, known]
    with pytest.raises(ValueError, match="cpu_seconds"):
        replace(unknown, cpu_seconds=-1.0)
