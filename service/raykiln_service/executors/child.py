"""The process that renders: takes one task after the other, all of the scene of the first."""

from __future__ import annotations

import os
import resource
import secrets
import time
import traceback
from pathlib import Path
from typing import Any

import raykiln as rk
from raykiln.image import encode_png, to_png_pixels

from raykiln_service.executors.childside import Channel, be_modest, describe, is_out_of_memory
from raykiln_service.executors.limits import OWN_BYTES
from raykiln_service.executors.saving import Saving
from raykiln_service.executors.supervision import out_of_memory

_PROGRESS_S = 0.25
_PREVIEW_S = 0.5
# A preview may take this share of the time at most.
_PREVIEW_SHARE = 0.05
_PREVIEW_PIXELS = 1024
_KEEPS_IMAGE = ("cancel", "timeout")


class Shelf:
    """The scene as it was loaded last: the same file, at one moment of its animation."""

    def __init__(self) -> None:
        self._moment: float | None = None
        self._prepared: rk.PreparedScene | None = None

    def get(self, task: dict[str, Any]) -> tuple[rk.PreparedScene, bool]:
        """The scene of a task, and whether it was here already."""
        warm = self._prepared is not None and self._moment == task["time_s"]
        if not warm:
            # The one before goes first: both at once may be too much.
            self._prepared = None
            self._prepared = self._load(task)
            self._moment = task["time_s"]
        assert self._prepared is not None
        if task["camera"] is None:
            return self._prepared, warm
        camera = rk.PerspectiveCamera.model_validate(task["camera"])
        return self._prepared.with_camera(camera), warm

    @staticmethod
    def _load(task: dict[str, Any]) -> rk.PreparedScene:
        started = time.monotonic()
        scene = rk.load_scene(
            Path(task["scene_path"]), base_dir=task["base_dir"], time_s=task["time_s"]
        )
        read_s = time.monotonic() - started
        prepared = rk.prepare(scene)
        prepared.load_s += read_s
        return prepared


class Rendering:
    """One task: load, render, write the outputs."""

    def __init__(self, message: dict[str, Any], channel: Channel, shelf: Shelf) -> None:
        self._task = message
        self._channel = channel
        self._shelf = shelf
        self._token: str = message["token"]
        self._told_at = 0.0
        self._told_spp = -1
        self._preview_at = 0.0
        self._preview_spp = 0
        self._saved: tuple[int, int] | None = None
        self._denoises = False
        self._stopping = False

    def run(self) -> None:
        """Render, and tell the supervisor how it ended."""
        try:
            kind, result = self._render()
            self._tell(kind, result=result)
        except Exception as error:
            self._tell(*self._failure(error))

    def _failure(self, error: Exception) -> tuple[str, dict[str, Any]]:
        if is_out_of_memory(error):
            return "rejected", out_of_memory(self._task["memory_bytes"])
        if isinstance(error, rk.SceneError | rk.SettingsError):
            return "rejected", self._problem("rejected", "It cannot be rendered", error)
        if isinstance(error, rk.RaykilnError | OSError):
            return "broken", self._problem("render-error", "The render broke", error)
        traceback.print_exc()
        return "broken", self._problem("internal", "The render broke", error)

    def _render(self) -> tuple[str, dict[str, Any] | None]:
        self._tell("progress", progress={"phase": "load", "fraction": 0.0})
        _limit_memory(self._task["memory_bytes"])
        prepared, warm = self._shelf.get(self._task)
        settings = rk.RenderSettings.create(**self._settings())
        reason = self._channel.stop_reason(self._token)
        if reason and not (reason in _KEEPS_IMAGE and self._checkpoint_version()):
            return "stopped", None
        self._denoises = settings.over(prepared.scene.settings).denoise
        result = self._resumed(prepared, settings)
        if not warm:
            result.stats.load_s, result.stats.bvh_s = prepared.load_s, prepared.bvh_s
            result.stats.warm = False
        reason = self._channel.stop_reason(self._token)
        if reason is None:
            return "done", self._write(result)
        # Any other stop needs the checkpoint only.
        return "stopped", self._write(result) if reason in _KEEPS_IMAGE else None

    def _settings(self) -> dict[str, Any]:
        given = dict(self._task["settings"])
        limit = int(self._task["threads"])
        given["threads"] = min(given.get("threads") or limit, limit)
        return given

    def _resumed(self, scene: rk.PreparedScene, settings: rk.RenderSettings) -> rk.RenderResult:
        checkpoint = Path(self._task["checkpoint"])
        options: dict[str, Any] = {
            "checkpoint": checkpoint,
            "checkpoint_interval_s": float(self._task["checkpoint_interval_s"]),
        }
        existed = checkpoint.exists()
        self._saved = self._checkpoint_version()
        try:
            return rk.render(scene, settings, self._on_progress, resume=True, **options)
        except rk.RenderError as error:
            if not existed or is_out_of_memory(error):
                raise
            self._tell("log", line=f"checkpoint not usable, starting over: {error}")
            checkpoint.unlink(missing_ok=True)
            return rk.render(scene, settings, self._on_progress, resume=False, **options)

    def _on_progress(self, progress: rk.Progress) -> bool:
        if self._stops(progress):
            return False
        now = time.monotonic()
        if now - self._told_at >= _PROGRESS_S or progress.spp_done != self._told_spp:
            self._told_at, self._told_spp = now, progress.spp_done
            names = ("fraction", "spp_done", "spp", "elapsed_s", "eta_s", "samples")
            fields = {name: getattr(progress, name) for name in names}
            all_done = self._denoises and progress.spp_done == progress.spp
            phase = "denoise" if all_done else "render"
            self._tell("progress", progress={"phase": phase, **fields})
            self._tell_of_checkpoint()
        if progress.spp_done > self._preview_spp and now >= self._preview_at:
            self._preview_spp = progress.spp_done
            self._write_preview(progress.preview())
            took = time.monotonic() - now
            self._preview_at = now + max(_PREVIEW_S, took / _PREVIEW_SHARE)
        return not self._stops(progress)

    def _stops(self, progress: rk.Progress) -> bool:
        """Whether the end was asked for."""
        reason = self._channel.stop_reason(self._token)
        if reason in _KEEPS_IMAGE and not self._stopping:
            # So that the supervisor knows that this thread has heard it.
            self._stopping = True
            self._tell("progress", progress={"phase": "encode", "fraction": progress.fraction})
        return reason is not None

    def _tell_of_checkpoint(self) -> None:
        version = self._checkpoint_version()
        if version is not None and version != self._saved:
            self._saved = version
            self._tell("checkpoint")

    def _checkpoint_version(self) -> tuple[int, int] | None:
        try:
            found = os.stat(self._task["checkpoint"])
        except OSError:
            return None
        return found.st_ino, found.st_mtime_ns

    def _write_preview(self, image: Any) -> None:
        step = -(-max(image.shape[:2]) // _PREVIEW_PIXELS)
        path = Path(self._task["preview"])
        temporary = path.with_name(f".preview-{secrets.token_hex(4)}.png")
        temporary.write_bytes(encode_png(to_png_pixels(image[::step, ::step])))
        temporary.replace(path)
        self._tell("preview")

    def _write(self, result: rk.RenderResult) -> dict[str, Any]:
        if not self._stopping:
            self._tell("progress", progress={"phase": "encode", "fraction": 1.0})
        started = time.monotonic()

        def tell_partial() -> None:
            # Should the rest take too long after a stop, this is what is kept.
            self._tell("partial", result=_told(result, time.monotonic() - started))

        folder = Path(self._task["work_dir"])
        Saving(result, folder, self._task["outputs"], tell_partial).run(self._is_to_end)
        told = _told(result, time.monotonic() - started)
        if self._preview_spp == 0 or not self._is_to_end():
            self._write_preview(result.image)
        return told

    def _is_to_end(self) -> bool:
        """Whether somebody waits for the image as it is."""
        return self._channel.stop_reason(self._token) in _KEEPS_IMAGE

    def _problem(self, reason: str, title: str, error: BaseException) -> dict[str, Any]:
        return {"reason": reason, "title": title, **describe(error, self._task["base_dir"])}

    def _tell(self, kind: str, problem: dict[str, Any] | None = None, **fields: Any) -> None:
        if problem is not None:
            fields["error"] = problem
        self._channel.send(type=kind, token=self._token, **fields)


def _told(result: rk.RenderResult, encode_s: float) -> dict[str, Any]:
    """What the supervisor is told of a result."""
    height, width = result.image.shape[:2]
    return {
        "complete": bool(result.complete),
        "stats": {**result.stats.as_dict(), "encode_s": encode_s},
        "warnings": list(result.warnings),
        "scene_sha256": result.scene_sha256,
        "settings": result.settings.model_dump(mode="json"),
        "width": width,
        "height": height,
    }


def _limit_memory(task_bytes: int) -> None:
    """Let allocations fail past what this task may take, so that it ends with a clear word."""
    hard = resource.getrlimit(resource.RLIMIT_DATA)[1]
    soft = task_bytes + OWN_BYTES
    if hard != resource.RLIM_INFINITY:
        soft = min(soft, hard)
    resource.setrlimit(resource.RLIMIT_DATA, (soft, hard))


def main() -> None:
    """Render what comes until the supervisor goes away."""
    channel = Channel(listen=False)
    be_modest(5)
    os.umask(0o027)
    message = channel.first()
    channel.confine(message)
    channel.listen()
    shelf = Shelf()
    while True:
        Rendering(message, channel, shelf).run()
        message = channel.inbox.get()


if __name__ == "__main__":
    main()
