"""Denoising with Intel Open Image Denoise, the optional extra `raykiln[denoise]`."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from raykiln.errors import SettingsError

Pixels = NDArray[np.float32]


def available() -> bool:
    """Whether the extra is installed."""
    try:
        import pyoidn  # noqa: F401
    except ImportError:
        return False
    return True
