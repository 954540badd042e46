"""Writing the files of a render, at once where somebody waits for the end."""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection
from concurrent.futures import Future, wait
from pathlib import Path

import raykiln as rk
from raykiln.image import write_exr

_LOOK_S = 0.02


class Saving:
    """The files of one result.

    Parameters
    ----------
    folder
        Where to; each file appears whole.
    outputs
        What was asked for; `image.exr` is always written, and first.
    on_image
        Called once when `image.exr` is there.
    """

    def __init__(
        self,
        result: rk.RenderResult,
        folder: Path,
        outputs: Collection[str],
        on_image: Callable[[], None],
    ) -> None:
        self._result = result
        self._folder = folder
        self._outputs = outputs
        self._on_image = on_image
        self._hurried = threading.Event()

    def run(self, is_stopped: Callable[[], bool]) -> None:
        """Write all files, compressed; from the moment of a stop on, those that miss as they are.

        To compress a large image takes longer than somebody who cancels is to wait.
        """
        if not is_stopped():
            patient = self._begin()
            while not is_stopped():
                if wait([patient], _LOOK_S).done:
                    patient.result()
                    return
            self._hurried.set()
        self._write(self._missing, compress=False)

    def _begin(self) -> Future[None]:
        future: Future[None] = Future()

        def work() -> None:
            try:
                self._write(lambda _name: not self._hurried.is_set())
                future.set_result(None)
            except BaseException as error:
                future.set_exception(error)

        threading.Thread(target=work, daemon=True).start()
        return future

    def _missing(self, name: str) -> bool:
        return not (self._folder / name).exists()

    def _write(self, is_wanted: Callable[[str], bool], *, compress: bool = True) -> None:
        if is_wanted("image.exr"):
            self._result.save(self._folder / "image.exr", compress=compress)
            self._on_image()
        for name, layer in self._result.aovs.items():
            if is_wanted(f"{name}.exr"):
                write_exr(self._folder / f"{name}.exr", {name: layer}, compress=compress)
        # Last, since it can be made of the others at any time.
        if "png" in self._outputs and is_wanted("image.png"):
            self._result.save(self._folder / "image.png")
