"""Whatever lies in a folder of demonstrations, reading it ends at once, in one line that names the file."""

from __future__ import annotations

import io
import json
import os
import socket
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from demo_episodes import make_episode

from dynaforge.cli.main import main
from dynaforge.demos import DamagedFileError, DemonstrationDataset
from dynaforge.demos.episode_file import sealed as with_seal
from dynaforge.demos.observations import ObservationFolder, ObservationSettings, standard_cameras
from dynaforge.demos.untrusted import parse_json
from dynaforge.demos.verification import verify
from dynaforge.tasks import get_task

DEEP = b"[" * 100_000 + b"]" * 100_000


def fifo(path: Path) -> None:
    os.mkfifo(path)


def dangling(path: Path) -> None:
    path.symlink_to("nowhere")


def loop(path: Path) -> None:
    path.symlink_to(path.name)


def folder(path: Path) -> None:
    path.mkdir()


def device(path: Path) -> None:
    path.symlink_to("/dev/zero")


def unix_socket(path: Path) -> None:
    here = Path.cwd()
    os.chdir(path.parent)  # its name may have 108 bytes
    try:
        with socket.socket(socket.AF_UNIX) as end:
            end.bind(path.name)
    finally:
        os.chdir(here)


def empty(path: Path) -> None:
    path.write_bytes(b"")


def huge(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(2**40)  # takes no place


def deep(path: Path) -> None:
    path.write_bytes(DEEP)


def long_number(path: Path) -> None:
    path.write_bytes(b'{"version": %s, "task": "can"}' % (b"9" * 4000))


THINGS = (fifo, dangling, loop, folder, device, unix_socket, empty, huge, deep, long_number)
PLACES = (
    "dataset.json",
    "generators.json",
    "ledger.jsonl",
    "observations/settings.json",
    "episodes/{}.h5",
    "observations/{}.h5",
)


@pytest.fixture
def dataset(tmp_path: Path) -> DemonstrationDataset:
    made = DemonstrationDataset(tmp_path / "data", task="can")
    for seed in range(2):
        made.add(make_episode(seed))
    camera = replace(standard_cameras(get_task("can"))["front"], size=(4, 4))
    ObservationFolder(made.path / "observations", ObservationSettings((camera,)))
    return made


def names(dataset: DemonstrationDataset) -> set[str]:
    return {finding.path.name for findings in verify(dataset) for finding in findings}


def status(*arguments: object) -> int:
    """Run the command; what its arguments are refused with is a status, too."""
    try:
        return main([str(argument) for argument in arguments])
    except SystemExit as end:
        return int(end.code or 0)


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("put", THINGS, ids=lambda put: put.__name__)
def test_anything_in_place_of_a_file_is_a_finding(
    dataset: DemonstrationDataset, place: str, put: Callable[[Path], None], capsys: pytest.CaptureFixture[str]
) -> None:
    path = dataset.path / place.format(dataset.ids()[0])
    path.unlink(missing_ok=True)
    put(path)
    if place == "dataset.json":
        assert status("verify", dataset.path) == 2
        assert len(capsys.readouterr().err.strip().splitlines()) == 1
    elif not (place == "ledger.jsonl" and put is empty):
        assert path.name in names(dataset)


@pytest.mark.parametrize("put", [fifo, dangling, loop, empty], ids=lambda put: put.__name__)
@pytest.mark.parametrize("place", ["episodes", "observations"])
def test_anything_in_place_of_a_folder_is_a_finding(
    dataset: DemonstrationDataset, place: str, put: Callable[[Path], None]
) -> None:
    (dataset.path / place).rename(dataset.path.parent / "aside")
    put(dataset.path / place)
    assert place in names(dataset)


def sealed(fill: Callable[[h5py.File], None]) -> bytes:
    """Return an HDF5 file with an honest header, the rest as `fill` makes it."""
    buffer = io.BytesIO()
    with h5py.File(buffer, "w", libver="latest") as file:
        file.attrs["header"] = json.dumps(make_episode(0).header())
        fill(file)
    return buffer.getvalue()


TABLE = np.zeros(20, [("time", "f8"), ("q", "f8", (7,))])
TABLE["time"] = np.arange(20)
VIRTUAL = h5py.VirtualLayout(shape=(20,), dtype="f8")
VIRTUAL[:] = h5py.VirtualSource("other.h5", "steps", shape=(20,))


def unlike(**columns: np.ndarray) -> np.ndarray:
    table = np.zeros(20, [(name, column.dtype, column.shape[1:]) for name, column in columns.items()])
    for name, column in columns.items():
        table[name] = column
    return table


HOSTILE: dict[str, Callable[[h5py.File], object]] = {
    "claims 1 TiB": lambda f: f.create_dataset("steps", shape=(2**36,), dtype=TABLE.dtype),
    "claims 1 TiB in chunks": lambda f: f.create_dataset("steps", (2**36,), TABLE.dtype, chunks=(64,), compression=1),
    "soft link": lambda f: f.__setitem__("steps", h5py.SoftLink("/steps")),
    "external link": lambda f: f.__setitem__("steps", h5py.ExternalLink("/etc/passwd", "steps")),
    "virtual": lambda f: f.create_virtual_dataset("steps", VIRTUAL),
    "external storage": lambda f: f.create_dataset("steps", (160,), "u1", external=[("/etc/passwd", 0, 160)]),
    "a group": lambda f: f.create_group("steps"),
    "texts": lambda f: f.create_dataset("steps", data=["a", "b"]),
    "a table of texts": lambda f: f.create_dataset("steps", (20,), [("time", h5py.string_dtype())]),
    "a scalar": lambda f: f.create_dataset("steps", data=TABLE[0]),
    "no table": lambda f: f.create_dataset("steps", data=np.arange(20.0)[:, None]),
    "time of another type": lambda f: f.create_dataset("steps", data=unlike(time=np.arange(20) + 0j)),
    "another shape": lambda f: f.create_dataset("steps", data=unlike(time=np.arange(20.0), q=np.zeros((20, 6)))),
    "an unknown name": lambda f: f.create_dataset("steps", data=unlike(time=np.arange(20.0), qq=np.zeros(20))),
    "time that stands still": lambda f: f.create_dataset("steps", data=unlike(time=np.zeros(20))),
    "no header": lambda f: f.attrs.__delitem__("header"),
    "a header of numbers": lambda f: f.attrs.__setitem__("header", np.arange(1000)),
    "a deep header": lambda f: f.attrs.__setitem__("header", DEEP[:30_000].decode()),
    "a list as header": lambda f: f.attrs.__setitem__("header", "[]"),
    "a header with a number too large": lambda f: f.attrs.__setitem__("header", '{"condition": 1e999}'),
}


@pytest.mark.parametrize("what", HOSTILE)
def test_a_sealed_file_with_hostile_content_is_a_finding(dataset: DemonstrationDataset, what: str) -> None:
    path = dataset.file_of(make_episode(0).id)
    path.write_bytes(with_seal(sealed(HOSTILE[what])))
    with pytest.raises(DamagedFileError):
        dataset[path.stem]
    assert path.name in names(dataset)


@pytest.mark.parametrize(
    "change",
    [
        {"success": "yes"},
        {"checkpoint": "4"},
        {"checkpoint": None},
        {"failure": None},
        {"phase": 3},
        {"more": 1},
        {"duration": "long"},
        {"generator": 3},
        {"generator": "../x"},
        {"condition": 3},
        {"condition": {}},
        {"meta": 3},
        {"meta": {"phases": 3}},
        {"meta": {"versions": [1]}},
        {"meta": {"state_digests": 3}},
        {"meta": {"contact_time": "x"}},
    ],
    ids=str,
)
def test_a_header_of_other_types_is_a_finding(dataset: DemonstrationDataset, change: dict[str, object]) -> None:
    path = dataset.file_of(make_episode(0).id)
    header = json.dumps(make_episode(0).header() | change)
    path.write_bytes(with_seal(sealed(lambda file: file.attrs.__setitem__("header", header))))
    with pytest.raises(DamagedFileError):
        dataset[path.stem]
    assert path.name in names(dataset)


ROWS = (20, 4, 4, 3)
BAD_PICTURES: dict[str, Callable[[h5py.File], object]] = {
    "claims 1 TiB": lambda f: f.create_dataset("front/rgb", (2**32, 4, 4, 3), "u1", chunks=(1, 4, 4, 3), compression=1),
    "of another length": lambda f: f.create_dataset("front/rgb", (19, 4, 4, 3), "u1"),
    "of another type": lambda f: f.create_dataset("front/rgb", ROWS, "f8"),
    "virtual": lambda f: f.create_virtual_dataset("front/rgb", h5py.VirtualLayout(ROWS, "u1")),
    "external link": lambda f: f.__setitem__("front/rgb", h5py.ExternalLink("/etc/passwd", "rgb")),
    "soft link": lambda f: f.__setitem__("front/rgb", h5py.SoftLink("/front/rgb")),
    "a group": lambda f: f.create_group("front/rgb"),
}


@pytest.mark.parametrize("what", BAD_PICTURES)
def test_hostile_observations_are_a_finding(dataset: DemonstrationDataset, what: str) -> None:
    observations, episode = ObservationFolder(dataset.path / "observations"), make_episode(0)

    def fill(file: h5py.File) -> None:
        file.attrs["content_hash"], file.attrs["settings"] = episode.content_hash(), observations.digest
        for name, (shape, kind) in observations.settings.layout.items():
            if name != "front/rgb":
                file[name] = np.zeros((20, *shape), kind)
        BAD_PICTURES[what](file)

    observations.file_of(episode.id).write_bytes(with_seal(sealed(fill)))
    with pytest.raises(DamagedFileError, match=r"front/rgb"):
        observations.of(episode)


@pytest.mark.parametrize("arguments", [["info"], ["view"], ["verify"], ["render"], ["export", "--format", "robomimic"]])
@pytest.mark.parametrize(
    ("content", "what"),
    [(b"", "it is empty"), (b"{}", "of format"), (b"[]", "of format"), (DEEP, "nested"), (None, "no dataset.json")],
)
def test_what_is_no_dataset_is_refused_in_one_line(
    tmp_path: Path, arguments: list[str], content: bytes | None, what: str, capsys: pytest.CaptureFixture[str]
) -> None:
    if content is not None:
        (tmp_path / "dataset.json").write_bytes(content)
    assert status(arguments[0], tmp_path, *arguments[1:]) == 2
    message = capsys.readouterr().err.strip()
    assert what in message
    assert "\n" not in message
    assert str(tmp_path) in message


def test_a_future_version_and_a_task_that_is_a_path_are_refused(dataset: DemonstrationDataset) -> None:
    marker = dataset.path / "dataset.json"
    data = json.loads(marker.read_bytes())
    for version in (3, 10**200, [], None):
        marker.write_text(json.dumps(data | {"version": version}))
        with pytest.raises(ValueError, match="has format version"):
            DemonstrationDataset(dataset.path)
    for task in ("../evil.py", "/tmp/evil.py", "evil.py", "", "a b"):
        marker.write_text(json.dumps(data | {"task": task}))
        with pytest.raises(DamagedFileError, match="is no name of a task"):
            DemonstrationDataset(dataset.path)


def test_a_name_that_a_terminal_would_obey_is_escaped(dataset: DemonstrationDataset) -> None:
    evil = dataset.path / "episodes" / os.fsdecode(b"a\x1b[2J\n\xff.h5")
    evil.write_bytes(b"")
    texts = [str(finding) for findings in verify(dataset) for finding in findings if finding.path == evil]
    assert texts
    assert all(text.isprintable() for text in texts)


def test_json_is_of_finite_numbers_and_bounded_depth() -> None:
    assert parse_json('{"a": [1, 2.5, null, "x"]}') == {"a": [1, 2.5, None, "x"]}
    for text in ("NaN", "[-Infinity]", "1e999", "9" * 400, "", "[" * 40 + "]" * 40, DEEP):
        with pytest.raises(ValueError, match=r"no number|too large|digits|empty|levels"):
            parse_json(text)


def test_a_reason_that_a_terminal_would_obey_is_escaped(
    dataset: DemonstrationDataset, capsys: pytest.CaptureFixture[str]
) -> None:
    lost = make_episode(9, success=False)
    lost = replace(lost, outcome=replace(lost.outcome, failure="a\x1b[2Jb"))
    DemonstrationDataset(dataset.path, task="can").add(lost)
    assert main(["info", str(dataset.path)]) == 0
    out = capsys.readouterr().out
    assert r"a\x1b[2Jb" in out
    assert "\x1b" not in out
