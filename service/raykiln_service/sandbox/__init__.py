"""What a process that reads strangers' scenes gives up before it reads the first byte.

Every layer stands alone, so that a kernel without one still has the others.  All of them can only
be narrowed later, and none needs a privilege.
"""

from raykiln_service.sandbox.confine import (
    LAYERS,
    Confinement,
    confine,
    missing_layers,
    system_folders,
)

__all__ = ["LAYERS", "Confinement", "confine", "missing_layers", "system_folders"]
