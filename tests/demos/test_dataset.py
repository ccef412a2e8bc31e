from __future__ import annotations

import math
import os
import shutil
from pathlib import Path

import pytest
from demo_episodes import make_episode

from dynaforge.demos import Attempt, DamagedFileError, DemonstrationDataset, Ledger
from dynaforge.files import atomic as atomic_module


def attempt(seed: int, *, success: bool = True) -> Attempt:
    return Attempt.of(make_episode(seed, success=success), wall_seconds=0.1, block=seed % 3)


def test_ledger_gives_back_what_was_appended_once_each(tmp_path):
    ledger = Ledger(tmp_path / "ledger.jsonl")
    assert ledger.attempts() == []
    written = [attempt(0), attempt(1, success=False), attempt(0)]
    for one in written:
        ledger.append(one)
    assert ledger.attempts() == written[:2]
    assert ledger.read()[1] == []


@pytest.mark.parametrize("torn", [1, 30, 250])
def test_torn_last_line_costs_only_itself(tmp_path, torn):
    ledger = Ledger(tmp_path / "ledger.jsonl", fsync=False)
    for seed in range(3):
        ledger.append(attempt(seed))
    ledger.path.write_bytes(ledger.path.read_bytes()[:-torn])
    assert ledger.attempts() == [attempt(0), attempt(1)] + ([attempt(2)] if torn == 1 else [])
    ledger.append(attempt(3))
    assert ledger.attempts()[-1] == attempt(3)
    assert ledger.read()[1] == ([] if torn == 1 else [3])


def test_altered_ledger_line_does_not_count(tmp_path):
    ledger = Ledger(tmp_path / "ledger.jsonl")
    ledger.append(attempt(0))
    ledger.append(attempt(1))
    ledger.path.write_bytes(ledger.path.read_bytes().replace(b'"checkpoint": 4', b'"checkpoint": 5', 1))
    assert ledger.attempts() == [attempt(1)]
    assert ledger.read()[1] == [1]


def test_dgr_counts_every_attempt_and_keeps_successes_only(tmp_path):
    data = DemonstrationDataset(tmp_path / "can", task="can")
    assert math.isnan(data.dgr())
    data.add(make_episode(0))
    data.add(make_episode(1, success=False))
    data.record(attempt(2, success=False))
    data.add(make_episode(0))  # a repeat is harmless
    assert (len(data), len(data.attempts()), data.dgr()) == (1, 3, pytest.approx(1 / 3))
    assert [episode.id for episode in data] == [make_episode(0).id]
    assert data[make_episode(0).id].content_hash() == make_episode(0).content_hash()
    with pytest.raises(KeyError, match="nothing"):
        data["nothing"]


def test_failures_are_kept_on_request(tmp_path):
    data = DemonstrationDataset(tmp_path, task="can", keep_failures=True)
    data.add(make_episode(1, success=False))
    assert len(data) == 1


def test_kill_between_file_and_ledger_is_mended_on_reopening(tmp_path):
    data = DemonstrationDataset(tmp_path, task="can")
    data.add(make_episode(0))
    data.ledger.path.unlink()
    assert DemonstrationDataset(tmp_path).attempts() == [Attempt.of(make_episode(0), recorded=True)]
    assert DemonstrationDataset(tmp_path, task="can").ledger.attempts() == [Attempt.of(make_episode(0), recorded=True)]


def test_two_writers_share_a_folder(tmp_path):
    first = DemonstrationDataset(tmp_path, task="can")
    second = DemonstrationDataset(tmp_path, task="can")
    first.add(make_episode(0))
    second.add(make_episode(1))
    assert first.ids() == second.ids()
    assert len(first.attempts()) == 2


def test_folder_of_another_task_is_refused(tmp_path):
    data = DemonstrationDataset(tmp_path, task="can")
    with pytest.raises(ValueError, match="'can', not of 'peg'"):
        DemonstrationDataset(tmp_path, task="peg")
    with pytest.raises(ValueError, match="one at 'peg'"):
        data.add(make_episode(0, task="peg"))
    assert len(data) == 0


def test_folder_with_other_data_is_refused_and_left_alone(tmp_path):
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(FileExistsError, match=r"thesis\.tex"):
        DemonstrationDataset(tmp_path, task="can")
    with pytest.raises(FileExistsError, match="is a file"):
        DemonstrationDataset(tmp_path / "thesis.tex", task="can")
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


def test_reading_needs_an_existing_dataset_and_cannot_add(tmp_path):
    with pytest.raises(FileNotFoundError, match="holds no demonstrations"):
        DemonstrationDataset(tmp_path / "nowhere")
    DemonstrationDataset(tmp_path, task="can")
    with pytest.raises(PermissionError, match="opened for reading"):
        DemonstrationDataset(tmp_path).add(make_episode(0))


def test_folder_that_cannot_be_written_is_refused_at_once(tmp_path, monkeypatch):
    def refuse(*_):
        raise PermissionError(13, "Permission denied")

    with monkeypatch.context() as patch:
        patch.setattr(atomic_module, "_write_bytes", refuse)
        with pytest.raises(PermissionError, match=r"Cannot write to .*Permission denied"):
            DemonstrationDataset(tmp_path, task="can")
    DemonstrationDataset(tmp_path, task="can")
    with monkeypatch.context() as patch:
        patch.setattr(atomic_module, "_write_bytes", refuse)
        DemonstrationDataset(tmp_path)  # reading stays possible
        with pytest.raises(PermissionError, match="Cannot write to"):
            DemonstrationDataset(tmp_path, task="can")
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(PermissionError, match="Cannot create"):
        DemonstrationDataset(tmp_path / "file" / "below", task="can")


def test_full_disk_leaves_earlier_episodes_and_no_half_file(tmp_path, monkeypatch):
    data = DemonstrationDataset(tmp_path, task="can")
    data.add(make_episode(0))

    def full(*_):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "write", full)
        with pytest.raises(OSError, match="No space left"):
            data.add(make_episode(1))
    assert [path.name for path in (tmp_path / "episodes").iterdir()] == [f"{make_episode(0).id}.h5"]
    assert len(data.attempts()) == 1


def test_renamed_copy_is_found_and_named(tmp_path):
    data = DemonstrationDataset(tmp_path, task="can")
    data.add(make_episode(0))
    shutil.copy(data.file_of(make_episode(0).id), data.file_of("copy"))
    with pytest.raises(DamagedFileError, match=r"copy\.h5 is damaged: it holds episode"):
        data["copy"]


def test_foreign_marker_is_named(tmp_path):
    (tmp_path / "dataset.json").write_text("{}")
    with pytest.raises(DamagedFileError, match=r"dataset\.json"):
        DemonstrationDataset(tmp_path, task="can")


def test_a_ledger_that_is_a_link_is_not_written_to(tmp_path: Path) -> None:
    """A folder from a stranger may hold a link to any file of the user's."""
    elsewhere = tmp_path / "elsewhere"
    elsewhere.touch()
    (tmp_path / "ledger.jsonl").symlink_to(elsewhere)
    with pytest.raises(OSError, match="a ledger that is a link is not written to"):
        Ledger(tmp_path / "ledger.jsonl").append(Attempt.of(make_episode(0)))
    assert not elsewhere.read_bytes()


def test_a_dataset_is_shown_on_one_line(tmp_path: Path) -> None:
    dataset = DemonstrationDataset(tmp_path / "data", task="can")
    dataset.add(make_episode())
    assert repr(dataset) == f"DemonstrationDataset('{tmp_path}/data', can, 1 episode)"
    (tmp_path / "data" / "episodes").rename(tmp_path / "gone")
    (tmp_path / "data" / "episodes").write_text("")
    assert repr(dataset) == f"DemonstrationDataset('{tmp_path}/data', can, damaged)"
