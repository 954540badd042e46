"""The commands of `raykiln`, one module a group; importing them stays cheap.

Whatever takes long to import (the renderer, httpx, the service) is imported inside the command
that needs it, so that `raykiln --help` answers at once and a render never loads the service.
"""
