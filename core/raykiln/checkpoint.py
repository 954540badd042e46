"""The state of a render on disk, so that it can go on after any interruption.

A file is `MAGIC`, the SHA-256 of what follows, and a NumPy archive of the film's planes with a
JSON header.
"""

from __future__ import annotations

import hashlib
import io
import json
from pathlib import Path
from typing import Any

import numpy as np

from raykiln import _core
from raykiln.errors import RenderError
from raykiln.image import write_atomically

MAGIC = b"raykiln checkpoint 2\n"


def save(
    path: Path, renderer: _core.Renderer, identity: dict[str, Any], work: dict[str, Any]
) -> None:
    """Write the film's sums; `identity` must match to resume, `work` is added to what follows.

    The file appears whole or not at all and is on disk when this returns.  Raises `RenderError`
    where it cannot be written.
    """
    header = json.dumps({"identity": identity, "work": work})
    buffer = io.BytesIO()
    body = len(MAGIC) + hashlib.sha256().digest_size
    buffer.write(bytes(body))
    planes: dict[str, Any] = renderer.planes()
    np.savez(buffer, header=np.array(header), **planes)
    content = buffer.getbuffer()
    content[:body] = MAGIC + hashlib.sha256(content[body:]).digest()
    try:
        write_atomically(path, content)
    except OSError as error:
        raise RenderError(f"{path}: the checkpoint cannot be written: {error.strerror}") from None


def load(path: Path, renderer: _core.Renderer, identity: dict[str, Any]) -> dict[str, Any]:
    """Fill the film from a checkpoint and return its `work`.

    Raises `RenderError` if the file is damaged or belongs to another scene, setting or version.
    """
    with np.load(io.BytesIO(_body(path)), allow_pickle=False) as archive:
        header = json.loads(str(archive["header"]))
        stored = {name: archive[name] for name in archive.files if name != "header"}
    _check_identity(path, header, identity)
    for name, plane in renderer.planes().items():
        if name not in stored or stored[name].shape != plane.shape:
            raise RenderError(f"{path}: the checkpoint has no layer {name!r} of this size")
        plane[...] = stored[name]
    renderer.resume()
    work: dict[str, Any] = header["work"]
    return work


def _body(path: Path) -> bytes:
    """The archive, as it was written."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise RenderError(f"{path}: the checkpoint cannot be read: {error.strerror}") from None
    if not content.startswith(MAGIC):
        raise RenderError(f"{path}: not a checkpoint of this version of raykiln")
    body = len(MAGIC) + hashlib.sha256().digest_size
    if content[len(MAGIC) : body] != hashlib.sha256(content[body:]).digest():
        raise RenderError(f"{path}: the checkpoint is damaged")
    return content[body:]


def _check_identity(path: Path, header: dict[str, Any], identity: dict[str, Any]) -> None:
    found = header["identity"]
    # Through JSON, as the stored one went.
    wanted = json.loads(json.dumps(identity))
    if found != wanted:
        names = [name for name in wanted if found.get(name) != wanted[name]]
        raise RenderError(f"{path}: the checkpoint belongs to another render ({', '.join(names)})")
