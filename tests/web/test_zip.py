"""The zip that the page makes of several files, read by somebody else."""

from __future__ import annotations

import io
import zipfile
from typing import Any

from .support import Service

MAKE = """async (files) => {
    const { bundleOf } = await import("/web/bundle.js");
    const chosen = files.map(([path, text]) => ({ path, file: new File([text], path.split("/").pop()) }));
    const bundle = bundleOf(chosen);
    const bytes = new Uint8Array(await (await bundle.blob()).arrayBuffer());
    return { name: bundle.name, entries: bundle.entries, bytes: [...bytes] };
}"""  # noqa: E501


def test_the_zip_is_one(tab: Any, service: Service) -> None:
    files = {
        "scene/deep/part.obj": "o part",
        "scene/big.gltf": "x" * 70_000,
        "scene/größe 日本.png": "pixels",
        "scene/empty.bin": "",
        "scene/.git/config": "not for others",
        "__MACOSX/scene/big.gltf": "litter",
    }
    page = tab(f"{service.url}/")
    made = page.evaluate(MAKE, list(files.items()))
    assert made["name"] == "scene.zip"
    assert made["entries"] == ["scene/big.gltf", "scene/deep/part.obj"]
    with zipfile.ZipFile(io.BytesIO(bytes(made["bytes"]))) as archive:
        assert archive.testzip() is None
        found = {name: archive.read(name).decode() for name in archive.namelist()}
    assert found == {
        path: text for path, text in files.items() if "MAC" not in path and ".git" not in path
    }


def test_files_without_a_scene_are_refused(tab: Any, service: Service) -> None:
    page = tab(f"{service.url}/#/new")
    page.set_input_files(
        "[name=file]",
        [{"name": f"{i}.png", "mimeType": "image/png", "buffer": b"x"} for i in range(2)],
    )
    page.wait_for_selector(".picker .bad:has-text('None of these files is a scene')")
