"""Types that the format tests share."""

from __future__ import annotations

from collections.abc import Callable

from raykiln.scene import Scene

LoadText = Callable[..., Scene]
