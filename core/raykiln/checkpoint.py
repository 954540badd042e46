"""The state of a render on disk, so that it can go on after any interruption."""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from raykiln import _core
from raykiln.errors import RenderError, shorten
from raykiln.image import write_atomically

FORMAT = 1


def save(path: Path, renderer: _core.Renderer, identity: dict[str, Any], work: dict[str, Any]) -> None:
    """Write the film's sums; `identity` must match to resume, `work` is added to what follows.

    The file appears whole or not at all and is on disk when this returns.  Raises `RenderError`
    where it cannot be written.
    """
    header = json.dumps({"format": FORMAT, "identity": identity, "work": work})
    buffer = io.BytesIO()
    np.savez(buffer, header=np.array(header), **renderer.planes())
    try:
        write_atomically(path, buffer.getbuffer())
    except OSError as error:
        raise RenderError(f"{path}: the checkpoint cannot be written: {error.strerror}") from None


def load(path: Path, renderer: _core.Renderer, identity: dict[str, Any]) -> dict[str, Any]:
    """Fill the film from a checkpoint and return its `work`.

    Raises `RenderError` if the file is damaged or belongs to another scene, setting or version.
    """
    try:
        # Every member of the archive carries a checksum that reading verifies.
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            header = json.loads(str(archive["header"]))
            stored = {name: archive[name] for name in archive.files if name != "header"}
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise RenderError(f"{path}: the checkpoint is damaged: {shorten(str(error))}") from None
    _check_identity(path, header, identity)
    for name, plane in renderer.planes().items():
        if name not in stored or stored[name].shape != plane.shape:
            raise RenderError(f"{path}: the checkpoint has no layer {name!r} of this size")
        plane[...] = stored[name]
    renderer.resume()
    work: dict[str, Any] = header["work"]
    return work


def _check_identity(path: Path, header: Any, identity: dict[str, Any]) -> None:
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise RenderError(f"{path}: not a checkpoint of this version of raykiln")
    found = header.get("identity")
    # Through JSON, as the stored one went.
    wanted = json.loads(json.dumps(identity))
    if found != wanted:
        names = [k for k in wanted if not isinstance(found, dict) or found.get(k) != wanted[k]]
        raise RenderError(f"{path}: the checkpoint belongs to another render ({', '.join(names)})")
