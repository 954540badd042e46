"""The process that looks over a submitted scene: loads it, builds it, renders nothing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from raykiln_service.executors.childside import Channel, be_modest, describe, is_out_of_memory


def check(path: Path, base_dir: Path) -> dict[str, Any]:
    """What is in a scene; raises what `raykiln` raises if it cannot be rendered."""
    import raykiln as rk
    from raykiln.frames import targets_of

    scene = rk.load_scene(path, base_dir=base_dir)
    summary = rk.check(scene).summary()
    return {
        "summary": summary,
        "settings": scene.settings,
        "cameras": [camera.name for camera in scene.cameras],
        "views": [camera.model_dump(mode="json", exclude_none=True) for camera in scene.cameras],
        "targets": targets_of(scene, scene.cameras),
        "time_range_s": scene.time_range_s,
        "warnings": list(scene.warnings),
    }


def answer(message: dict[str, Any]) -> dict[str, Any]:
    """The reply to a request."""
    import raykiln as rk

    base_dir = message["base_dir"]
    try:
        return {"type": "accepted", **check(Path(message["path"]), Path(base_dir))}
    except (rk.RaykilnError, MemoryError) as error:
        if is_out_of_memory(error):
            detail = "the scene needs more memory than a check may use"
            return {"type": "rejected", "error": {"detail": detail}}
        return {"type": "rejected", "error": describe(error, base_dir)}
    except RecursionError:
        return {"type": "rejected", "error": {"detail": "the scene is nested too deeply"}}


def main() -> None:
    """Answer one request: the process has seen the scene, so it is not for another."""
    channel = Channel(listen=False)
    be_modest(5)
    message = channel.first()
    channel.confine(message)
    channel.listen()
    channel.send(**answer(message))


if __name__ == "__main__":
    main()
