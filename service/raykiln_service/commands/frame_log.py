"""Which frames of a `raykiln render` are finished, so that `--resume` need not render them again.

The file that `--checkpoint` names lists them; beside it lies the checkpoint of the frame under
way, with its number in the name.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from raykiln_service.commands.console import CommandError
from raykiln_service.files import sha256_of, write_json

if TYPE_CHECKING:
    from raykiln import PreparedScene, RenderSettings

_KIND = "raykiln frames 1"
# They change no bit of the image.
_FREE = {"threads"}


class FrameLog:
    """The finished frames in a file.

    Parameters
    ----------
    resume
        Go by what the file says, if it exists; else it is begun anew.

    Raises
    ------
    CommandError
        The file is no such list.
    """

    def __init__(self, path: Path, *, resume: bool) -> None:
        self._path = path
        self._frames: dict[str, Any] = {}
        if resume and path.exists():
            self._frames = _frames_in(path)

    def is_finished(self, name: str, identity: str, files: Sequence[Path]) -> bool:
        """Whether a frame was finished with the same bits, and its files are as they were left."""
        known = self._frames.get(name)
        if known is None or known["identity"] != identity:
            return False
        left: dict[str, str] = known["files"]
        return all(path.is_file() and left.get(str(path)) == sha256_of(path) for path in files)

    def note(self, name: str, identity: str, files: Sequence[Path]) -> None:
        """Note that a frame is finished, for good."""
        written = {str(path): sha256_of(path) for path in files}
        self._frames[name] = {"identity": identity, "files": written}
        try:
            write_json(self._path, {"kind": _KIND, "frames": self._frames})
        except OSError as error:
            raise CommandError(f"{self._path}: cannot write: {error.strerror}") from None


def identity_of(scene: PreparedScene, settings: RenderSettings, writing: Mapping[str, Any]) -> str:
    """Names all that decides the files of a frame."""
    import raykiln
    from raykiln.rendering import isa

    resolved = settings.over(scene.scene.settings).model_dump(mode="json", exclude=_FREE)
    parts = [scene.sha256, resolved, dict(writing), raykiln.__version__, isa()]
    return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def _frames_in(path: Path) -> dict[str, Any]:
    try:
        document = json.loads(path.read_text())
        frames = document["frames"]
        entries = [(entry["identity"], entry["files"]) for entry in frames.values()]
        if document["kind"] == _KIND and all(isinstance(files, dict) for _, files in entries):
            return dict(frames)
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        pass
    raise CommandError(
        f"--checkpoint: {path} is no list of finished frames; accepted: the file of an earlier "
        "render of many pictures, or a new one"
    )
