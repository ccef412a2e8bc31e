from __future__ import annotations

from pathlib import Path

import pytest

from dynaforge.options import paths
from dynaforge.options.paths import OutputPath
from dynaforge.options.refusal import Refused


def test_a_folder_that_may_not_be_written_to_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(paths.os, "access", lambda path, how: how == paths.os.R_OK)  # root may do everything
    for kind in ("file", "folder"):
        with pytest.raises(Refused, match=f"new.*cannot be made: {tmp_path} is not writable"):
            OutputPath(kind)(str(tmp_path / "new"))
