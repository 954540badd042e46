"""The process that looks over submitted scenes: loads them, builds them, renders nothing."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from raykiln_service.executors.childside import Channel, be_modest, describe, limit_memory


def check(path: Path, base_dir: Path) -> dict[str, Any]:
    """What is in a scene; raises what `raykiln` raises if it cannot be rendered."""
    import raykiln as rk
    from raykiln.frames import center_of

    scene = rk.load_scene(path, base_dir=base_dir)
    summary = rk.check(scene).summary()
    return {
        "summary": summary,
        "settings": scene.settings,
        "cameras": [camera.name for camera in scene.cameras],
        "views": [camera.model_dump(mode="json", exclude_none=True) for camera in scene.cameras],
        "center": center_of(scene),
        "time_range_s": scene.time_range_s,
        "warnings": list(scene.warnings),
    }


def answer(message: dict[str, Any]) -> dict[str, Any]:
    """The reply to one request."""
    import raykiln as rk

    base_dir = message["base_dir"]
    try:
        return {"type": "accepted", **check(Path(message["path"]), Path(base_dir))}
    except rk.RaykilnError as error:
        return {"type": "rejected", "error": describe(error, base_dir)}
    except MemoryError:
        detail = "the scene needs more memory than a check may use"
        return {"type": "rejected", "error": {"detail": detail}}
    except RecursionError:
        return {"type": "rejected", "error": {"detail": "the scene is nested too deeply"}}


def main() -> None:
    """Answer requests until the supervisor goes away."""
    channel = Channel()
    be_modest(5)
    limit_memory(int(sys.argv[2]))
    while True:
        message = channel.inbox.get()
        channel.send(**answer(message))


if __name__ == "__main__":
    main()
