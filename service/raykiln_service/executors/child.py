"""The process that renders: takes one task after the other from its supervisor."""

from __future__ import annotations

import os
import secrets
import time
import traceback
from pathlib import Path
from typing import Any

from raykiln_service.executors.childside import Channel, be_modest, describe

_PROGRESS_S = 0.25
_PREVIEW_S = 0.5
# A preview may take this share of the time at most.
_PREVIEW_SHARE = 0.05
_PREVIEW_PIXELS = 1024


class Rendering:
    """One task: load, render, write the outputs."""

    def __init__(self, message: dict[str, Any], channel: Channel) -> None:
        self._task = message
        self._channel = channel
        self._token: str = message["token"]
        self._told_at = 0.0
        self._told_spp = -1
        self._preview_at = 0.0
        self._preview_spp = 0

    def run(self) -> None:
        """Render, and tell the supervisor how it ended."""
        import raykiln as rk

        try:
            kind, result = self._render()
            self._tell(kind, result=result)
        except (rk.SceneError, rk.SettingsError) as error:
            self._tell("rejected", error=self._problem("rejected", "It cannot be rendered", error))
        except (rk.RaykilnError, MemoryError, OSError) as error:
            self._tell("broken", error=self._problem("render-error", "The render broke", error))
        except Exception as error:
            traceback.print_exc()
            self._tell("broken", error=self._problem("internal", "The render broke", error))

    def _render(self) -> tuple[str, dict[str, Any] | None]:
        import raykiln as rk

        started = time.monotonic()
        self._tell("progress", progress={"phase": "load", "fraction": 0.0})
        scene = self._scene()
        settings = rk.RenderSettings.create(**self._settings())
        loaded_s = time.monotonic() - started
        if self._channel.stop_reason(self._token):
            return "stopped", None
        result = self._resumed(scene, settings)
        reason = self._channel.stop_reason(self._token)
        if reason is None:
            return "done", self._write(result, loaded_s)
        # A cancel keeps the image so far; any other stop needs the checkpoint only.
        return "stopped", self._write(result, loaded_s) if reason == "cancel" else None

    def _scene(self) -> Any:
        import raykiln as rk

        scene = rk.load_scene(
            Path(self._task["scene_path"]),
            base_dir=self._task["base_dir"],
            time_s=self._task["time_s"],
        )
        if self._task["camera"] is not None:
            scene.set_camera(rk.PerspectiveCamera.model_validate(self._task["camera"]))
        return scene

    def _settings(self) -> dict[str, Any]:
        given = dict(self._task["settings"])
        limit = int(self._task["threads"])
        given["threads"] = min(given.get("threads") or limit, limit)
        return given

    def _resumed(self, scene: Any, settings: Any) -> Any:
        import raykiln as rk

        checkpoint = Path(self._task["checkpoint"])
        options: dict[str, Any] = {
            "checkpoint": checkpoint,
            "checkpoint_interval_s": float(self._task["checkpoint_interval_s"]),
        }
        existed = checkpoint.exists()
        try:
            return rk.render(scene, settings, self._on_progress, resume=True, **options)
        except rk.RenderError as error:
            if not existed:
                raise
            self._tell("log", line=f"checkpoint not usable, starting over: {error}")
            checkpoint.unlink(missing_ok=True)
            return rk.render(scene, settings, self._on_progress, resume=False, **options)

    def _on_progress(self, progress: Any) -> bool:
        now = time.monotonic()
        if now - self._told_at >= _PROGRESS_S or progress.spp_done != self._told_spp:
            self._told_at, self._told_spp = now, progress.spp_done
            names = ("fraction", "spp_done", "spp", "elapsed_s", "eta_s", "samples")
            fields = {name: getattr(progress, name) for name in names}
            self._tell("progress", progress={"phase": "render", **fields})
        if progress.spp_done > self._preview_spp and now >= self._preview_at:
            self._preview_spp = progress.spp_done
            self._write_preview(progress.preview())
            took = time.monotonic() - now
            self._preview_at = now + max(_PREVIEW_S, took / _PREVIEW_SHARE)
        return self._channel.stop_reason(self._token) is None

    def _write_preview(self, image: Any) -> None:
        from raykiln.image import encode_png, to_png_pixels

        step = -(-max(image.shape[:2]) // _PREVIEW_PIXELS)
        path = Path(self._task["preview"])
        temporary = path.with_name(f".preview-{secrets.token_hex(4)}.png")
        temporary.write_bytes(encode_png(to_png_pixels(image[::step, ::step])))
        temporary.replace(path)
        self._tell("preview")

    def _write(self, result: Any, loaded_s: float) -> dict[str, Any]:
        from raykiln.image import write_exr

        self._tell("progress", progress={"phase": "encode", "fraction": 1.0})
        started = time.monotonic()
        folder = Path(self._task["work_dir"])
        result.save(folder / "image.exr")
        if "png" in self._task["outputs"]:
            result.save(folder / "image.png")
        for name, layer in result.aovs.items():
            write_exr(folder / f"{name}.exr", {name: layer})
        height, width = result.image.shape[:2]
        stats = result.stats.as_dict()
        stats["load_s"] = loaded_s + float(stats["load_s"])
        stats["encode_s"] = time.monotonic() - started
        self._write_preview(result.image)
        return {
            "complete": bool(result.complete),
            "stats": stats,
            "warnings": list(result.warnings),
            "scene_sha256": result.scene_sha256,
            "settings": result.settings.model_dump(mode="json"),
            "width": width,
            "height": height,
        }

    def _problem(self, reason: str, title: str, error: BaseException) -> dict[str, Any]:
        return {"reason": reason, "title": title, **describe(error, self._task["base_dir"])}

    def _tell(self, kind: str, **fields: Any) -> None:
        self._channel.send(type=kind, token=self._token, **fields)


def main() -> None:
    """Render what comes until the supervisor goes away."""
    channel = Channel()
    be_modest(5)
    os.umask(0o027)
    # Loaded before the first task comes, so that it starts at once.
    import raykiln.image  # noqa: F401

    while True:
        Rendering(channel.inbox.get(), channel).run()


if __name__ == "__main__":
    main()
